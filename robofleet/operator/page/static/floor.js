// What does not move: drawn once, on a canvas of its own.

import { groupColours } from "./figures.js";
import { arrow, circle, line } from "./shapes.js";
import { robotColours } from "./view.js";

const GRID_STEPS_M = [0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20];
const GRID_PX = 56; // at least, between two lines

/** Draw the floor with its grid and scale, and what is drawn on it for each group. */
export function drawFloor(g, view, hello) {
  const [w, h] = hello.arena.size_m;
  const { scale, width, height } = view;
  g.clearRect(0, 0, width, height);
  g.fillStyle = view.colour.floor;
  g.fillRect(view.x(-w / 2), view.y(h / 2), w * scale, h * scale);
  const grid = drawGrid(g, view, hello.arena.size_m);
  g.strokeStyle = view.colour.muted;
  g.lineWidth = view.drawn.edge;
  g.strokeRect(view.x(-w / 2), view.y(h / 2), w * scale, h * scale);
  drawObstacles(g, view, hello.arena);
  drawShapes(g, view, hello);
  drawScale(g, view, w, h, grid);
}

/** Draw a grid; returns its step [m], and what draws at each of its lines. */
export function drawGrid(g, view, [w, h]) {
  const step = GRID_STEPS_M.find((m) => m * view.scale >= GRID_PX) ?? GRID_STEPS_M.at(-1);
  g.strokeStyle = view.colour.grid;
  g.lineWidth = 1;
  g.beginPath();
  const lines = (half, draw) => {
    for (let k = -Math.floor(half / step + 1e-9); k * step <= half + 1e-9; k++) draw(k * step);
  };
  lines(w / 2, (x) => line(g, view.x(x), view.y(-h / 2), view.x(x), view.y(h / 2)));
  lines(h / 2, (y) => line(g, view.x(-w / 2), view.y(y), view.x(w / 2), view.y(y)));
  g.stroke();
  return { step, lines };
}

// The scale stands at the floor's edge, or at the canvas's where the floor's is out of sight.
function drawScale(g, view, w, h, { step, lines }) {
  const words = (m) => (Math.abs(m) < 1e-9 ? "0" : m.toFixed(step < 0.1 ? 2 : step < 1 ? 1 : 0));
  g.font = "11px system-ui, sans-serif";
  g.fillStyle = view.colour.muted;
  g.strokeStyle = view.colour.floor;
  g.lineWidth = 4;
  const write = (text, x, y) => {
    g.strokeText(text, x, y);
    g.fillText(text, x, y);
  };
  const [bottom, left] = [Math.min(view.y(-h / 2) + 6, view.height - 16), Math.max(view.x(-w / 2) - 6, 26)];
  g.textAlign = "center";
  g.textBaseline = "top";
  lines(w / 2, (x) => {
    const last = x + step > w / 2 || view.x(x + step) > view.width - 14;
    if (view.x(x) > left && view.x(x) < view.width - 14) write(words(x) + (last ? " m" : ""), view.x(x), bottom);
  });
  g.textAlign = "right";
  g.textBaseline = "middle";
  lines(h / 2, (y) => {
    if (view.y(y) > 6 && view.y(y) < bottom) write(words(y), left, view.y(y));
  });
}

/** Draw what stands on the floor, and the floor's own edge where it is no rectangle. */
export function drawObstacles(g, view, { floor_m, obstacles }) {
  g.strokeStyle = view.colour.muted;
  g.lineWidth = view.drawn.edge;
  if (floor_m) {
    outline(g, view, floor_m);
    g.stroke();
  }
  g.font = "11px system-ui, sans-serif";
  g.textAlign = "center";
  g.textBaseline = "middle";
  for (const { name, points } of obstacles) {
    outline(g, view, points);
    g.fillStyle = view.colour.grid;
    g.fill();
    g.stroke();
    const [x, y] = [0, 1].map((axis) => points.reduce((sum, at) => sum + at[axis], 0) / points.length);
    g.fillStyle = view.colour.ink;
    g.fillText(name, view.x(x), view.y(y));
  }
}

function outline(g, view, points) {
  g.beginPath();
  for (const [x, y] of points) g.lineTo(view.x(x), view.y(y));
  g.closePath();
}

/** Draw what is drawn on the floor for each group. */
export function drawShapes(g, view, hello) {
  const own = robotColours(hello, view.dark);
  const colours = groupColours(hello, own, view.colour.path);
  hello.groups.forEach(({ robots, shapes }, k) => {
    for (const shape of shapes) {
      if (shape.points.length === 0) continue;
      const robot = hello.robots.findIndex(({ id }) => id === shape.name); // its own way has its colour
      g.strokeStyle = g.fillStyle = own[robot] ?? colours[k];
      if (shape.kind === "line") drawLine(g, view, shape);
      else {
        const each = robots.map((id) => own[hello.robots.findIndex((robot) => robot.id === id)]);
        drawDots(g, view, shape.points, shape.points.length === robots.length ? each : []);
      }
    }
  });
}

function drawLine(g, view, { points, closed, directed }) {
  g.lineWidth = view.drawn.line;
  g.beginPath();
  for (const [x, y] of points) g.lineTo(view.x(x), view.y(y));
  if (closed) g.closePath();
  g.stroke();
  if (!directed || points.length < 2) return;
  g.beginPath();
  const { direction, directions } = view.drawn;
  for (let n = 0; n < Math.min(directions, points.length - 1); n++) {
    const k = Math.floor((n * (points.length - 1)) / directions);
    const [[x0, y0], [x1, y1]] = [points[k], points[k + 1]];
    arrow(g, view.x(x0), view.y(y0), Math.atan2(y1 - y0, x1 - x0), direction);
  }
  g.fill();
}

// One of each robot has its colour.
function drawDots(g, view, points, colours) {
  points.forEach(([x, y], k) => {
    g.strokeStyle = colours[k] ?? g.strokeStyle;
    g.lineWidth = view.drawn.line;
    g.beginPath();
    circle(g, view.x(x), view.y(y), view.drawn.dot);
    g.stroke();
  });
}
