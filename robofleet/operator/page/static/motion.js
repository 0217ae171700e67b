// What moves with the robots and is no robot: trails, where each goes, how far it is from its reference.

import { FINE } from "./robots.js";
import { arrow, circle, line } from "./shapes.js";

const TRAIL_BANDS = 4; // of one opacity each
const FEW = 20; // robots whose trails have their own colours; more share one stroke a band

/** Where each robot was in the last seconds. */
export class Trails {
  #trails = [];
  #taken = 0;
  #drawn;

  /** `drawn`: how long a trail is, and of which ticks. */
  constructor(drawn) {
    this.#drawn = drawn;
  }

  /** Take a tick's robots. */
  take(robots) {
    if (this.#taken++ % this.#drawn.trail_ticks !== 0) return;
    const now = performance.now();
    for (const { row, x_m, y_m } of robots) {
      const trail = (this.#trails[row] ??= []);
      if (x_m !== null) trail.push([x_m, y_m, now]);
      while (trail.length > 0 && trail[0][2] < now - 1000 * this.#drawn.trail_s) trail.shift();
    }
  }

  draw(g, view, colours) {
    g.lineWidth = view.drawn.line;
    if (this.#trails.length > FEW) drawBands(g, view, this.#trails, view.colour.accent);
    else this.#trails.forEach((trail, row) => drawBands(g, view, [trail], colours[row]));
    g.globalAlpha = 1;
  }
}

function drawBands(g, view, trails, colour) {
  g.strokeStyle = colour;
  for (let band = 0; band < TRAIL_BANDS; band++) {
    g.globalAlpha = 0.5 * (1 - band / TRAIL_BANDS);
    g.beginPath();
    for (const trail of trails) {
      const points = Math.ceil(trail.length / TRAIL_BANDS);
      const end = trail.length - 1 - band * points;
      for (let k = end, first = true; k >= 0 && k >= end - points; k--, first = false) {
        const [x, y] = trail[k];
        if (first) g.moveTo(view.x(x), view.y(y));
        else g.lineTo(view.x(x), view.y(y));
      }
    }
    g.stroke();
  }
}

// Where each robot goes by itself that is not there yet: a dashed ring with a heading, and a straight line to it.
export function drawPlaces(g, view, robots, colours) {
  g.lineWidth = 1.5;
  for (const robot of robots) {
    if (robot.place === null || robot.to_go_m === 0) continue;
    const [x, y, psi] = [view.x(robot.place[0]), view.y(robot.place[1]), robot.place[2]];
    const [u, v, r] = [view.x(robot.x_m), view.y(robot.y_m), view.radius(robot)];
    g.strokeStyle = g.fillStyle = colours[robot.row];
    g.setLineDash([3, 3]);
    g.beginPath();
    circle(g, x, y, r);
    g.stroke();
    g.globalAlpha = 0.4;
    g.beginPath();
    line(g, u, v, x, y);
    g.stroke();
    g.globalAlpha = 1;
    g.setLineDash([]);
    g.beginPath();
    arrow(g, x, y, psi, 0.5 * r);
    g.fill();
  }
}

// From point p (a dot) to its reference (a cross).
export function drawAims(g, view, robots) {
  g.strokeStyle = g.fillStyle = view.colour.ink;
  g.lineWidth = view.drawn.thin;
  g.beginPath();
  const dots = [];
  for (const robot of robots) {
    const { point_x_m, point_y_m, reference_x_m, reference_y_m } = robot;
    if (point_x_m === null || reference_x_m === null) continue;
    const [px, py, rx, ry] = [view.x(point_x_m), view.y(point_y_m), view.x(reference_x_m), view.y(reference_y_m)];
    const size = Math.min(view.drawn.cross, view.radius(robot) / 2);
    line(g, px, py, rx, ry);
    line(g, rx - size, ry - size, rx + size, ry + size);
    line(g, rx - size, ry + size, rx + size, ry - size);
    dots.push([px, py, size * 0.6]);
  }
  g.stroke();
  g.beginPath();
  for (const dot of dots) circle(g, ...dot);
  g.fill();
}

// The discs that the barrier keeps apart.
export function drawRings(g, view, robots, trouble) {
  g.globalAlpha = trouble === FINE ? 0.6 : 1;
  g.lineWidth = trouble === FINE ? view.drawn.thin : 2.5;
  g.beginPath();
  for (const robot of robots) {
    circle(g, view.x(robot.x_m), view.y(robot.y_m), robot.safety_radius_m * view.scale);
  }
  g.stroke();
  g.globalAlpha = 1;
}
