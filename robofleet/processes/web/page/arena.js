// The arena from above. What the newest tick says is drawn as it is: nothing is made up between two ticks.

import { FINE, HALTED, LATCHED, LOST, SLOWED } from "./robots.js";

const MARGIN_PX = { left: 32, right: 14, top: 12, bottom: 24 }; // for the scale
const GRID_STEPS_M = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20];
const GRID_PX = 56; // at least, between two lines
const TRAIL_EVERY = 3; // ticks
const TRAIL_POINTS = 40; // 4 s
const TRAIL_BANDS = 4; // of one opacity each: one stroke a band, however many robots
const TAU = 2 * Math.PI;
const COLOURS = ["floor", "grid", "ink", "muted", "accent", "on-accent", "amber", "red", "path"];
const WORDS = { [HALTED]: "halted", [LOST]: "lost", [LATCHED]: "latched" };

export class Arena {
  #floor = document.getElementById("arena-floor");
  #top = document.getElementById("arena-robots");
  #stage = document.getElementById("arena-stage");
  #hello = null;
  #tick = null;
  #trails = [];
  #taken = 0;
  #view = { scale: 1, x: 0, y: 0 };
  #colour = {};

  constructor() {
    new ResizeObserver(() => this.#resize()).observe(this.#stage);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.#resize());
    matchMedia("(resolution: 1dppx)").addEventListener("change", () => this.#resize());
  }

  /** Take what does not change in a run. */
  begin(hello) {
    this.#hello = hello;
    this.#trails = hello.robots.map(() => []);
    const [width, height] = hello.arena.size_m;
    this.#stage.style.aspectRatio = `${width} / ${height}`;
    this.#resize();
  }

  draw(robots) {
    this.#tick = robots;
    if (this.#taken++ % TRAIL_EVERY === 0) this.#remember(robots);
    this.#drawRobots();
  }

  #remember(robots) {
    for (const { row, x_m, y_m } of robots) {
      if (x_m === null) continue;
      const trail = this.#trails[row];
      trail.push([x_m, y_m]);
      if (trail.length > TRAIL_POINTS) trail.shift();
    }
  }

  #resize() {
    if (this.#hello === null) return;
    const { clientWidth: width, clientHeight: height } = this.#stage;
    for (const canvas of [this.#floor, this.#top]) {
      canvas.width = Math.round(width * devicePixelRatio);
      canvas.height = Math.round(height * devicePixelRatio);
      canvas.getContext("2d").setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    }
    const style = getComputedStyle(document.documentElement);
    for (const name of COLOURS) this.#colour[name] = style.getPropertyValue(`--${name}`);
    const [w, h] = this.#hello.arena.size_m;
    const { left, right, top, bottom } = MARGIN_PX;
    const scale = Math.min((width - left - right) / w, (height - top - bottom) / h);
    this.#view = { scale, x: (width + left - right) / 2, y: (height + top - bottom) / 2, width, height };
    this.#drawFloor();
    if (this.#tick) this.#drawRobots();
  }

  #x(x_m) {
    return this.#view.x + x_m * this.#view.scale;
  }

  #y(y_m) {
    return this.#view.y - y_m * this.#view.scale;
  }

  #drawFloor() {
    const g = this.#floor.getContext("2d");
    const [w, h] = this.#hello.arena.size_m;
    const { scale, width, height } = this.#view;
    g.clearRect(0, 0, width, height);
    g.fillStyle = this.#colour.floor;
    g.fillRect(this.#x(-w / 2), this.#y(h / 2), w * scale, h * scale);
    this.#drawGrid(g, w, h);
    g.strokeStyle = this.#colour.muted;
    g.lineWidth = 1.5;
    g.strokeRect(this.#x(-w / 2), this.#y(h / 2), w * scale, h * scale);
    this.#drawPath(g);
  }

  #drawGrid(g, w, h) {
    const step = GRID_STEPS_M.find((m) => m * this.#view.scale >= GRID_PX) ?? GRID_STEPS_M.at(-1);
    g.font = "11px system-ui, sans-serif";
    g.fillStyle = this.#colour.muted;
    g.strokeStyle = this.#colour.grid;
    g.lineWidth = 1;
    g.beginPath();
    const lines = (half, draw) => {
      for (let k = -Math.floor(half / step + 1e-9); k * step <= half + 1e-9; k++) draw(k * step);
    };
    const words = (m) => (Math.abs(m) < 1e-9 ? "0" : m.toFixed(step < 1 ? 1 : 0));
    g.textAlign = "center";
    g.textBaseline = "top";
    lines(w / 2, (x) => {
      g.moveTo(this.#x(x), this.#y(-h / 2));
      g.lineTo(this.#x(x), this.#y(h / 2));
      g.fillText(words(x) + (x + step > w / 2 ? " m" : ""), this.#x(x), this.#y(-h / 2) + 6);
    });
    g.textAlign = "right";
    g.textBaseline = "middle";
    lines(h / 2, (y) => {
      g.moveTo(this.#x(-w / 2), this.#y(y));
      g.lineTo(this.#x(w / 2), this.#y(y));
      g.fillText(words(y), this.#x(-w / 2) - 6, this.#y(y));
    });
    g.stroke();
  }

  #drawPath(g) {
    const path = this.#hello.path;
    g.strokeStyle = g.fillStyle = this.#colour.path;
    g.lineWidth = 2;
    g.beginPath();
    for (const [x, y] of path) g.lineTo(this.#x(x), this.#y(y));
    g.closePath();
    g.stroke();
    for (let arrows = 0; arrows < 8; arrows++) {
      const k = Math.floor((arrows * (path.length - 1)) / 8);
      const [[x0, y0], [x1, y1]] = [path[k], path[k + 1]];
      arrow(g, this.#x(x0), this.#y(y0), Math.atan2(y1 - y0, x1 - x0), 6);
    }
  }

  #drawRobots() {
    const g = this.#top.getContext("2d");
    const seen = this.#tick.filter((robot) => robot.x_m !== null);
    g.clearRect(0, 0, this.#view.width, this.#view.height);
    this.#drawTrails(g);
    this.#drawAims(g, seen);
    this.#drawBodies(g, seen);
    this.#drawLabels(g, seen);
  }

  #drawTrails(g) {
    g.strokeStyle = this.#colour.accent;
    g.lineWidth = 2;
    const points = TRAIL_POINTS / TRAIL_BANDS;
    for (let band = 0; band < TRAIL_BANDS; band++) {
      g.globalAlpha = 0.45 * (1 - band / TRAIL_BANDS);
      g.beginPath();
      for (const trail of this.#trails) {
        const end = trail.length - 1 - band * points;
        for (let k = end, first = true; k >= 0 && k >= end - points; k--, first = false) {
          const [x, y] = trail[k];
          if (first) g.moveTo(this.#x(x), this.#y(y));
          else g.lineTo(this.#x(x), this.#y(y));
        }
      }
      g.stroke();
    }
    g.globalAlpha = 1;
  }

  // From point p (a dot) to its reference (a cross).
  #drawAims(g, robots) {
    g.strokeStyle = g.fillStyle = this.#colour.ink;
    g.lineWidth = 1;
    g.beginPath();
    const dots = new Path2D();
    for (const { point_x_m, point_y_m, reference_x_m, reference_y_m } of robots) {
      if (point_x_m === null || reference_x_m === null) continue;
      const [px, py, rx, ry] = [this.#x(point_x_m), this.#y(point_y_m), this.#x(reference_x_m), this.#y(reference_y_m)];
      g.moveTo(px, py);
      g.lineTo(rx, ry);
      g.moveTo(rx - 4, ry - 4);
      g.lineTo(rx + 4, ry + 4);
      g.moveTo(rx - 4, ry + 4);
      g.lineTo(rx + 4, ry - 4);
      dots.moveTo(px + 2.5, py);
      dots.arc(px, py, 2.5, 0, TAU);
    }
    g.stroke();
    g.fill(dots);
  }

  // Each kind of trouble has a shape of its own: colour alone tells nothing.
  #drawBodies(g, robots) {
    const { accent, amber, red } = this.#colour;
    const colours = { [FINE]: accent, [SLOWED]: accent, [HALTED]: amber, [LOST]: amber, [LATCHED]: red };
    for (const trouble of [FINE, SLOWED, HALTED, LOST, LATCHED]) {
      const some = robots.filter((robot) => robot.trouble === trouble);
      if (some.length === 0) continue;
      g.strokeStyle = g.fillStyle = colours[trouble];
      this.#rings(g, some, trouble);
      const bodies = new Path2D();
      for (const robot of some) circle(bodies, this.#x(robot.x_m), this.#y(robot.y_m), this.#radius(robot));
      g.lineWidth = trouble === FINE ? 1 : 2.5;
      g.setLineDash(trouble === LOST ? [5, 4] : []);
      if (trouble === LOST) g.fillStyle = this.#colour.floor;
      g.fill(bodies);
      g.stroke(bodies);
      g.setLineDash([]);
      g.strokeStyle = g.fillStyle = trouble === LOST ? amber : this.#colour["on-accent"];
      for (const robot of some) this.#mark(g, robot);
    }
  }

  #radius(robot) {
    return Math.max(robot.body_radius_m * this.#view.scale, 4);
  }

  #rings(g, robots, trouble) {
    g.globalAlpha = trouble === FINE ? 0.4 : 1;
    g.lineWidth = trouble === FINE ? 1 : 2.5;
    g.setLineDash(trouble === FINE ? [2, 3] : []);
    g.beginPath();
    for (const robot of robots) {
      circle(g, this.#x(robot.x_m), this.#y(robot.y_m), robot.safety_radius_m * this.#view.scale);
    }
    g.stroke();
    g.setLineDash([]);
    g.globalAlpha = 1;
  }

  #mark(g, robot) {
    const [x, y, r] = [this.#x(robot.x_m), this.#y(robot.y_m), this.#radius(robot)];
    g.lineWidth = Math.max(2, r / 5);
    g.beginPath();
    if (robot.trouble === LATCHED) {
      const a = r * 0.5;
      g.moveTo(x - a, y - a);
      g.lineTo(x + a, y + a);
      g.moveTo(x - a, y + a);
      g.lineTo(x + a, y - a);
      g.stroke();
    } else if (robot.trouble === HALTED) {
      g.moveTo(x - r / 3, y - r / 2);
      g.lineTo(x - r / 3, y + r / 2);
      g.moveTo(x + r / 3, y - r / 2);
      g.lineTo(x + r / 3, y + r / 2);
      g.stroke();
    } else {
      arrow(g, x + 0.15 * r * Math.cos(robot.psi_rad), y - 0.15 * r * Math.sin(robot.psi_rad), robot.psi_rad, r * 0.6);
    }
  }

  // The worst first, each where nothing is yet; a label without a place is left out, but for a robot in trouble.
  #drawLabels(g, robots) {
    g.textAlign = "center";
    g.textBaseline = "middle";
    g.lineWidth = 3;
    const taken = robots.map((robot) => {
      const r = this.#radius(robot);
      return [this.#x(robot.x_m), this.#y(robot.y_m), r, r];
    });
    for (const robot of [...robots].sort((a, b) => b.trouble - a.trouble || a.row - b.row)) {
      const bad = robot.trouble >= HALTED;
      const words = bad ? `${robot.id} ${WORDS[robot.trouble]}` : robot.id;
      g.font = `${bad ? 700 : 600} 12px system-ui, sans-serif`;
      const half = g.measureText(words).width / 2 + 2;
      const places = this.#places(robot, half);
      const place = places.find(([x, y]) => taken.every(([u, v, w, h]) => apart(x - u, half + w, y - v, 7 + h)));
      if (!place && !bad) continue;
      const [x, y] = place ?? places[0];
      taken.push([x, y, half, 7]);
      g.strokeStyle = this.#colour.floor;
      g.strokeText(words, x, y);
      g.fillStyle = this.#colour.ink;
      g.fillText(words, x, y);
    }
  }

  // Where a label may stand: above, below, right, left of what is drawn of the robot.
  #places(robot, half) {
    const [x, y] = [this.#x(robot.x_m), this.#y(robot.y_m)];
    const ring = robot.trouble === FINE ? 0 : robot.safety_radius_m * this.#view.scale;
    const off = Math.max(this.#radius(robot), ring) + 3;
    return [
      [x, y - off - 6],
      [x, y + off + 7],
      [x + off + half, y],
      [x - off - half, y],
    ];
  }
}

function apart(dx, width, dy, height) {
  return Math.abs(dx) >= width || Math.abs(dy) >= height;
}

function circle(path, x, y, r) {
  path.moveTo(x + r, y);
  path.arc(x, y, r, 0, TAU);
}

// A triangle that points along psi (counter-clockwise, as in the world; the screen's y points down).
function arrow(g, x, y, psi, size) {
  const at = (angle, r) => [x + r * Math.cos(psi + angle), y - r * Math.sin(psi + angle)];
  g.beginPath();
  g.moveTo(...at(0, size));
  g.lineTo(...at(2.4, size));
  g.lineTo(...at(-2.4, size));
  g.closePath();
  g.fill();
}
