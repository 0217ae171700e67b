// The robots, a table a group: what every robot has, and the figures of its behaviour. The worst robot is first. A cell
// is touched only when its text changes, a row is moved only when the order does.

import { heading, inWords } from "./figures.js";
import { HALTED, LATCHED } from "./robots.js";

const ON_A_PHONE = 4; // figures that have room beside a robot's name
const LONG_MS = 10_000;
const PARKED = { name: "no group", behaviour: "parked" };

const fixed = (value, digits) => (value === null ? "–" : value.toFixed(digits));
const STATE = { kind: "state", head: "State", of: (robot) => robot.words };
const REST = [
  { kind: "wheels", head: "Wheels", unit: "rad/s", of: (robot) => `${fixed(robot.left_rad_s, 2)} ${fixed(robot.right_rad_s, 2)}` },
  { kind: "battery", head: "Battery", unit: "%", of: ({ battery }) => fixed(battery === null ? null : 100 * battery, 0) },
  { kind: "age", head: "Age", unit: "ms", of: ({ age_ms: age }) => (age >= LONG_MS ? "> 10 s" : fixed(age, 0)) },
]; // prettier-ignore

export class RobotTables {
  #place = document.getElementById("robots-tables");
  #tables = [];

  begin(hello) {
    const parked = hello.robots.filter((robot) => robot.group === null).map(({ id }) => id);
    const groups = [...hello.groups, ...(parked.length ? [{ ...PARKED, robots: parked }] : [])];
    this.#tables = groups.map((group) => new GroupTable(hello, group));
    this.#place.replaceChildren(...this.#tables.map(({ element }) => element));
    document.getElementById("robots-count").textContent = `${hello.robots.length}`;
  }

  draw(robots) {
    const worst = new Map(this.#tables.map((table) => [table, table.draw(robots)]));
    const sorted = [...this.#tables].sort((a, b) => worst.get(b) - worst.get(a));
    if (sorted.some(({ element }, k) => element !== this.#place.children[k])) {
      this.#place.append(...sorted.map(({ element }) => element));
    }
  }
}

class GroupTable {
  #columns;
  #rows = new Map(); // by the robots' rows
  #order = "";
  #body = document.createElement("tbody");
  element = document.createElement("table");

  constructor(hello, { name, behaviour, robots }) {
    const own = [...hello.figures.keys()].filter((k) => robots.some((id) => hello.figures[k].robots.includes(id)));
    const figures = own.map((k, place) => column(hello.figures[k], k, place));
    this.#columns = [STATE, ...figures, ...REST];
    this.element.style.setProperty("--figures", figures.length);
    this.element.style.setProperty("--beside", Math.min(ON_A_PHONE, Math.max(2, figures.length)));
    const [caption, head, line] = ["caption", "thead", "tr"].map((kind) => document.createElement(kind));
    caption.append(Object.assign(document.createElement("b"), { textContent: name }));
    if (behaviour !== name) caption.append(" ", behaviour);
    line.append(...[{ kind: "robot", head: "Robot" }, ...this.#columns].map(th));
    head.append(line);
    for (const robot of hello.robots.filter(({ id }) => robots.includes(id))) this.#add(robot, hello.robots.indexOf(robot));
    this.element.append(caption, head, this.#body);
  }

  #add(robot, at) {
    const row = document.createElement("tr");
    const head = Object.assign(document.createElement("th"), { scope: "row", className: "robot" });
    head.append(chip(robot));
    row.append(head, ...this.#columns.map(({ kind }) => Object.assign(document.createElement("td"), { className: kind })));
    for (const cell of row.cells) if (cell !== head) cell.append("–");
    this.#rows.set(at, { row, texts: [...row.cells].slice(1).map((cell) => cell.firstChild) });
    this.#body.append(row);
  }

  /** Write what the tick says of the group's robots; return how bad the worst is. */
  draw(robots) {
    const own = robots.filter(({ row }) => this.#rows.has(row));
    for (const robot of own) this.#write(robot);
    const sorted = [...own].sort((a, b) => rank(b) - rank(a) || a.row - b.row);
    const order = sorted.map(({ row }) => row).join();
    if (order !== this.#order) {
      this.#order = order;
      this.#body.append(...sorted.map((robot) => this.#rows.get(robot.row).row));
    }
    return rank(sorted[0]);
  }

  #write(robot) {
    const { row, texts } = this.#rows.get(robot.row);
    this.#columns.forEach(({ of }, k) => {
      const text = of(robot);
      if (texts[k].data !== text) texts[k].data = text;
    });
    const kind = robot.trouble === LATCHED ? "danger" : robot.trouble >= HALTED ? "warning" : "";
    if (row.className !== kind) row.className = kind;
  }
}

function column(figure, k, place) {
  return {
    kind: place < ON_A_PHONE ? "figure" : "figure more",
    head: heading(figure),
    unit: figure.unit,
    meaning: figure.meaning,
    of: ({ figures }) => (figures[k] === null ? "–" : inWords(figure, figures[k])),
  };
}

function th({ head, kind, unit = "", meaning = "" }) {
  const cell = Object.assign(document.createElement("th"), { scope: "col", className: kind, title: meaning });
  cell.append(head);
  if (unit) cell.append(" ", Object.assign(document.createElement("i"), { textContent: unit }));
  return cell;
}

/** A robot's name beside a dot of its colour. */
export function chip({ id, colour }) {
  const [name, dot] = [document.createElement("span"), document.createElement("i")];
  name.className = "chip";
  dot.style.setProperty("--robot", colour);
  name.append(dot, id);
  return name;
}

// What comes and goes within a few ticks does not move rows.
function rank(robot) {
  return robot.trouble >= HALTED ? robot.trouble : 0;
}
