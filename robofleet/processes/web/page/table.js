// The robots, the worst first. A cell is touched only when its text changes, a row is moved only when the order does.

import { HALTED, LATCHED } from "./robots.js";

const fixed = (digits) => (value) => (value === null || value === undefined ? "–" : value.toFixed(digits));
const CELLS = [
  (robot) => robot.words,
  (robot) => robot.gate ?? "silent",
  (robot) => fixed(2)(robot.control_mm),
  (robot) => fixed(1)(robot.spacing_mm),
  (robot) => fixed(2)(robot.left_rad_s),
  (robot) => fixed(2)(robot.right_rad_s),
  (robot) => fixed(0)(robot.battery === null ? null : 100 * robot.battery),
  (robot) => fixed(0)(robot.age_ms),
];

export class RobotTable {
  #body = document.querySelector("#robots-table tbody");
  #rows = [];
  #order = "";

  begin(hello) {
    this.#order = "";
    this.#rows = hello.robots.map(({ id }) => {
      const row = document.createElement("tr");
      const head = document.createElement("th");
      head.scope = "row";
      head.textContent = id;
      row.append(head, ...CELLS.map(() => document.createElement("td")));
      for (const cell of row.cells) cell.append(cell === head ? "" : "–");
      return { row, texts: [...row.cells].slice(1).map((cell) => cell.firstChild) };
    });
    this.#body.replaceChildren(...this.#rows.map(({ row }) => row));
    document.getElementById("robots-count").textContent = `${hello.robots.length}`;
  }

  draw(robots) {
    for (const robot of robots) this.#write(robot);
    const sorted = [...robots].sort((a, b) => rank(b) - rank(a) || a.row - b.row);
    const order = sorted.map((robot) => robot.row).join();
    if (order !== this.#order) {
      this.#order = order;
      this.#body.append(...sorted.map((robot) => this.#rows[robot.row].row));
    }
  }

  #write(robot) {
    const { row, texts } = this.#rows[robot.row];
    CELLS.forEach((cell, k) => {
      const text = cell(robot);
      if (texts[k].data !== text) texts[k].data = text;
    });
    const kind = robot.trouble === LATCHED ? "danger" : robot.trouble >= HALTED ? "warning" : "";
    if (row.className !== kind) row.className = kind;
  }
}

// What comes and goes within a few ticks does not move rows.
function rank(robot) {
  return robot.trouble >= HALTED ? robot.trouble : 0;
}
