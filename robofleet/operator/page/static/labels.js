// The robots' names in the arena.

import { FINE, HALTED, LATCHED, LOST } from "./robots.js";

const WORDS = { [HALTED]: "halted", [LOST]: "lost", [LATCHED]: "latched" };

export class Labels {
  #widths = new Map(); // half of each [px]; to measure is dear
  #troubleWords;

  /** `troubleWords` returns what is written of a robot in trouble. */
  constructor(troubleWords = (robot) => `${robot.id} ${WORDS[robot.trouble]}`) {
    this.#troubleWords = troubleWords;
  }

  /** The worst first, each where nothing is yet; one without a place is left out, but for a robot in trouble. `boxes`:
   *  where there is something: middle, half of a width, half of a height. */
  draw(g, view, robots, boxes = []) {
    g.textAlign = "center";
    g.textBaseline = "middle";
    g.lineWidth = 3;
    const bodies = robots.map((robot) => {
      const r = drawnRadius(view, robot);
      return [view.x(robot.x_m), view.y(robot.y_m), r, r];
    });
    const taken = [...boxes, ...bodies];
    for (const robot of [...robots].sort((a, b) => b.trouble - a.trouble || a.row - b.row)) {
      const bad = robot.trouble >= HALTED;
      const words = bad ? this.#troubleWords(robot) : robot.id;
      g.font = `${bad ? 700 : 600} 12px system-ui, sans-serif`;
      const half = this.#halfWidth(g, words);
      const around = places(view, robot, half);
      const isFree = ([x, y]) => taken.every(([u, v, w, h]) => apart(x - u, half + w, y - v, 7 + h));
      const place = around.find((at) => at[0] > half && at[0] < view.width - half && isFree(at));
      if (!place && !bad) continue;
      const [x, y] = place ?? around[0];
      taken.push([x, y, half, 7]);
      g.strokeStyle = view.colour.floor;
      g.strokeText(words, x, y);
      g.fillStyle = view.colour.ink;
      g.fillText(words, x, y);
    }
  }

  #halfWidth(g, words) {
    if (!this.#widths.has(words)) this.#widths.set(words, g.measureText(words).width / 2 + 2);
    return this.#widths.get(words);
  }
}

// Where a label may stand: above, below, right, left of what is drawn of the robot.
function places(view, robot, half) {
  const [x, y] = [view.x(robot.x_m), view.y(robot.y_m)];
  const off = drawnRadius(view, robot) + 3;
  return [
    [x, y - off - 6],
    [x, y + off + 7],
    [x + off + half, y],
    [x - off - half, y],
  ];
}

// The ring of a robot in trouble is as bold as its body.
function drawnRadius(view, robot) {
  const ring = robot.trouble === FINE ? 0 : robot.safety_radius_m * view.scale;
  return Math.max(view.radius(robot), ring);
}

function apart(dx, width, dy, height) {
  return Math.abs(dx) >= width || Math.abs(dy) >= height;
}
