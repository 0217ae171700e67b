// What projectors show on the floor, and who shows it; an operator switches it.

export class Projection {
  #panel = document.getElementById("projection-panel");
  #pages = document.getElementById("projection-pages");
  #buttons = [...document.querySelectorAll("#projection-show button")];
  #answer = document.getElementById("projection-answer");
  #projectors = [];
  #show = [];
  #link;

  constructor(link) {
    this.#link = link;
    for (const button of this.#buttons) button.addEventListener("click", () => this.#press(button.dataset));
  }

  begin({ projectors }) {
    this.#projectors = projectors;
    this.#panel.hidden = projectors.length === 0;
  }

  /** Take what is shown, and whose pages are open. */
  showing({ show, pages }) {
    this.#show = show;
    this.#answer.textContent = "";
    for (const button of this.#buttons) button.setAttribute("aria-pressed", `${this.#isOn(button.dataset)}`);
    this.#pages.replaceChildren(...this.#projectors.map((projector) => this.#item(projector, pages)));
  }

  answered({ ok, text }) {
    this.#answer.textContent = ok ? "" : text;
  }

  #isOn({ show, only }) {
    return only ? [...this.#show].sort().join(" ") === only.split(" ").sort().join(" ") : this.#show.includes(show);
  }

  #press({ show, only }) {
    const rest = this.#show.filter((one) => one !== show);
    this.#link.send({ show: only ? only.split(" ") : rest.length < this.#show.length ? rest : [...rest, show] });
  }

  #item({ name, width, height, optics }, pages) {
    const [item, open] = [document.createElement("li"), pages.filter((page) => page.name === name)];
    const fits = ({ size_px: [w, h] }) => w === width && h === height;
    const words =
      optics === null
        ? "not calibrated: robofleet calibrate projector"
        : open.length === 0
          ? "no browser has it open"
          : open.every(fits)
            ? "is shown"
            : `its browser shows ${open.find((page) => !fits(page)).size_px.join(" x ")} px: make it full-screen`;
    item.append(`${name}: ${words}`);
    if (optics !== null) {
      const link = Object.assign(document.createElement("a"), { textContent: "its page", target: "_blank", rel: "noopener" });
      link.href = `${this.#link.address("projector")}&name=${encodeURIComponent(name)}`;
      item.append(" (", link, ")");
    }
    return item;
  }
}
