// Shapes that many robots share: each is added to one path, and drawn with it.

const TAU = 2 * Math.PI;

export function circle(path, x, y, r) {
  path.moveTo(x + r, y);
  path.arc(x, y, r, 0, TAU);
}

export function line(path, x0, y0, x1, y1) {
  path.moveTo(x0, y0);
  path.lineTo(x1, y1);
}

// A triangle that points along psi (counter-clockwise, as in the world; the screen's y points down).
export function arrow(path, x, y, psi, size) {
  const at = (angle) => [x + size * Math.cos(psi + angle), y - size * Math.sin(psi + angle)];
  path.moveTo(...at(0));
  path.lineTo(...at(2.4));
  path.lineTo(...at(-2.4));
  path.closePath();
}
