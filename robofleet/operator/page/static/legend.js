// What is drawn on the floor for each group.

import { groupColours } from "./figures.js";
import { coloursOfTheDay, dark, robotColours } from "./view.js";

export class Legend {
  #list = document.getElementById("shapes-legend");
  #hello = null;

  constructor() {
    dark.addEventListener("change", () => this.#draw());
  }

  begin(hello) {
    this.#hello = hello;
    this.#draw();
  }

  #draw() {
    if (this.#hello === null) return;
    const { groups, robots } = this.#hello;
    const colours = groupColours(this.#hello, robotColours(this.#hello), coloursOfTheDay(["path"]).path);
    const items = groups.flatMap(({ name: group, shapes }, k) => {
      const common = shapes.filter(({ name }) => !robots.some(({ id }) => id === name)); // the others have their colours
      const kinds = new Map(common.map(({ name, kind }) => [name, kind])); // shapes of one name are one entry
      return [...kinds].map(([name, kind]) => item(groups.length > 1 ? `${group}: ${name}` : name, kind, colours[k]));
    });
    this.#list.replaceChildren(...items);
  }
}

function item(words, kind, colour) {
  const [entry, sign] = [document.createElement("li"), document.createElement("i")];
  sign.className = kind;
  sign.style.setProperty("--shape", colour);
  entry.append(sign, words);
  return entry;
}
