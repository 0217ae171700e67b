// What does not move: drawn once, on a canvas of its own.

import { arrow } from "./shapes.js";

const GRID_STEPS_M = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20];
const GRID_PX = 56; // at least, between two lines
const ARROWS = 8;

/** Draw the floor with its grid and scale, and the path with its direction. */
export function drawFloor(g, view, hello) {
  const [w, h] = hello.arena.size_m;
  const { scale, width, height } = view;
  g.clearRect(0, 0, width, height);
  g.fillStyle = view.colour.floor;
  g.fillRect(view.x(-w / 2), view.y(h / 2), w * scale, h * scale);
  drawGrid(g, view, w, h);
  g.strokeStyle = view.colour.muted;
  g.lineWidth = 1.5;
  g.strokeRect(view.x(-w / 2), view.y(h / 2), w * scale, h * scale);
  drawPath(g, view, hello.path);
}

function drawGrid(g, view, w, h) {
  const step = GRID_STEPS_M.find((m) => m * view.scale >= GRID_PX) ?? GRID_STEPS_M.at(-1);
  g.font = "11px system-ui, sans-serif";
  g.fillStyle = view.colour.muted;
  g.strokeStyle = view.colour.grid;
  g.lineWidth = 1;
  g.beginPath();
  const lines = (half, draw) => {
    for (let k = -Math.floor(half / step + 1e-9); k * step <= half + 1e-9; k++) draw(k * step);
  };
  const words = (m) => (Math.abs(m) < 1e-9 ? "0" : m.toFixed(step < 1 ? 1 : 0));
  g.textAlign = "center";
  g.textBaseline = "top";
  lines(w / 2, (x) => {
    g.moveTo(view.x(x), view.y(-h / 2));
    g.lineTo(view.x(x), view.y(h / 2));
    g.fillText(words(x) + (x + step > w / 2 ? " m" : ""), view.x(x), view.y(-h / 2) + 6);
  });
  g.textAlign = "right";
  g.textBaseline = "middle";
  lines(h / 2, (y) => {
    g.moveTo(view.x(-w / 2), view.y(y));
    g.lineTo(view.x(w / 2), view.y(y));
    g.fillText(words(y), view.x(-w / 2) - 6, view.y(y));
  });
  g.stroke();
}

function drawPath(g, view, path) {
  g.strokeStyle = g.fillStyle = view.colour.path;
  g.lineWidth = 2;
  g.beginPath();
  for (const [x, y] of path) g.lineTo(view.x(x), view.y(y));
  g.closePath();
  g.stroke();
  const arrowheads = new Path2D();
  for (let n = 0; n < ARROWS; n++) {
    const k = Math.floor((n * (path.length - 1)) / ARROWS);
    const [[x0, y0], [x1, y1]] = [path[k], path[k + 1]];
    arrow(arrowheads, view.x(x0), view.y(y0), Math.atan2(y1 - y0, x1 - x0), 6);
  }
  g.fill(arrowheads);
}
