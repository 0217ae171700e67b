// A canvas of a projector, drawn on as if it were the floor: what a 2D context has, in units of the floor.
//
// Points go through the projector's lens one by one, and lines in short pieces: so they fall where they belong, and are
// as sharp as the projector's pixels. What is drawn is remembered by tiles, so that only these are cleared. Without a
// GPU a whole small image is drawn six times as fast as a part of a large one, and a polygon as a stroked line.

const STEP_PX = 40; // of a line: its chords are 0.1 px off at most
const ROUND = 48; // chords of a circle
const TILE_PX = 128;
const TURNS = 128; // steps of a unit in which letters turn, shear and grow: else none is as the one that the browser has
const SAME = ["strokeStyle", "fillStyle", "globalAlpha", "font", "textAlign", "textBaseline"];

export class Warp {
  #g;
  #pixel;
  #px; // of a unit
  #columns;
  #touched; // tiles that have been drawn on
  #cleared; // and those before them
  #boxes = new Map(); // around words
  #pieces = new Map(); // of images: tiles
  #parts = []; // of the path: each one's points
  #begin = null; // of the part of the path that is drawn now [units]
  #last = null;

  /** `pixel` returns where a place on the floor (and its height) is in the picture; `px`: pixels of a unit. */
  constructor(g, pixel, px) {
    [this.#g, this.#pixel, this.#px] = [g, pixel, px];
    const { width, height } = g.canvas;
    this.#columns = Math.ceil(width / TILE_PX);
    this.#touched = new Uint8Array(this.#columns * Math.ceil(height / TILE_PX));
    this.#cleared = this.#touched.slice();
    g.lineCap = "round";
    g.miterLimit = 2; // beyond, corners are cut: round ones are dear
    for (const name of SAME) {
      Object.defineProperty(this, name, { get: () => g[name], set: (value) => (g[name] = value) });
    }
  }

  get lineWidth() {
    return this.#g.lineWidth / this.#px;
  }

  set lineWidth(units) {
    this.#g.lineWidth = units * this.#px;
  }

  setLineDash(units) {
    this.#g.setLineDash(units.map((length) => length * this.#px));
  }

  measureText(words) {
    return this.#g.measureText(words);
  }

  beginPath() {
    this.#g.beginPath();
    this.#parts = [];
    this.#last = null;
  }

  moveTo(u, v) {
    this.#begin = this.#last = [u, v];
    const point = this.#pixel(u, v);
    this.#parts.push([point]);
    this.#g.moveTo(point[0], point[1]);
  }

  lineTo(u, v) {
    if (this.#last === null) return this.moveTo(u, v);
    const [u0, v0] = this.#last;
    const pieces = Math.max(1, Math.ceil((Math.hypot(u - u0, v - v0) * this.#px) / STEP_PX));
    const part = this.#parts.at(-1);
    for (let k = 1; k <= pieces; k++) {
      const share = k / pieces;
      const point = this.#pixel(u0 + share * (u - u0), v0 + share * (v - v0));
      part.push(point);
      this.#g.lineTo(point[0], point[1]);
    }
    this.#last = [u, v];
  }

  closePath() {
    if (this.#last === null) return;
    this.lineTo(...this.#begin);
    this.#g.closePath();
  }

  arc(u, v, r, from, to) {
    const chords = Math.max(4, Math.ceil((ROUND * Math.abs(to - from)) / (2 * Math.PI)));
    for (let k = 0; k <= chords; k++) {
      const angle = from + (k / chords) * (to - from);
      this.lineTo(u + r * Math.cos(angle), v + r * Math.sin(angle));
    }
  }

  stroke() {
    this.#g.stroke();
    const reach = this.#g.lineWidth / 2 + STEP_PX / 2 + 1;
    for (const part of this.#parts) for (const [x, y] of part) this.#touch(x - reach, y - reach, x + reach, y + reach);
  }

  fill() {
    this.#g.fill();
    for (const part of this.#parts) this.#touchAround(part);
  }

  strokeRect(u, v, w, h) {
    this.beginPath();
    for (const corner of [[u, v], [u + w, v], [u + w, v + h], [u, v + h]]) this.lineTo(...corner);
    this.closePath();
    this.stroke();
  }

  fillText(words, u, v) {
    this.#write("fillText", words, u, v);
  }

  strokeText(words, u, v) {
    this.#write("strokeText", words, u, v);
  }

  // Words lie on the floor as it is at their place: they turn, shear and grow with it.
  #write(how, words, u, v) {
    const g = this.#g;
    const [[x0, y0], [xu, yu], [xv, yv]] = [this.#pixel(u, v), this.#pixel(u + 1, v), this.#pixel(u, v + 1)];
    const turned = [xu - x0, yu - y0, xv - x0, yv - y0].map((px) => Math.round(px * TURNS) / TURNS);
    const [x, y] = [Math.round(x0), Math.round(y0)];
    g.save();
    g.setTransform(...turned, x, y);
    g.lineJoin = "round";
    g.lineWidth = this.lineWidth;
    g[how](words, 0, 0);
    g.restore();
    const at = ([du, dv]) => [x + turned[0] * du + turned[2] * dv, y + turned[1] * du + turned[3] * dv];
    this.#touchAround(this.#box(words).map(at));
  }

  // The corners around words [units]; to measure is dear.
  #box(words) {
    const g = this.#g;
    const key = [words, g.font, this.lineWidth, g.textAlign, g.textBaseline].join();
    if (!this.#boxes.has(key)) {
      const measured = g.measureText(words);
      const [left, top, right, bottom] = ["Left", "Ascent", "Right", "Descent"].map(
        (side) => measured[`actualBoundingBox${side}`] + this.lineWidth,
      );
      this.#boxes.set(key, [[-left, -top], [right, -top], [right, bottom], [-left, bottom]]);
    }
    return this.#boxes.get(key);
  }

  /** Fill what an upright cylinder on the floor hides from the projector: no ray to it has another colour. */
  fillCylinder(u, v, r, height_m) {
    const points = [];
    for (let k = 0; k < ROUND; k++) {
      const angle = (k / ROUND) * 2 * Math.PI;
      const at = [u + r * Math.cos(angle), v + r * Math.sin(angle)];
      points.push(this.#pixel(...at), this.#pixel(...at, height_m));
    }
    this.#g.beginPath();
    for (const point of hull(points)) this.#g.lineTo(...point);
    this.#g.fill();
    this.#touchAround(points);
  }

  /** Draw an image into a rectangle of the floor. */
  drawImage(image, u, v, w, h, cells = 24) {
    const [sw, sh] = [image.width / cells, image.height / cells];
    for (let i = 0; i < cells; i++) {
      for (let k = 0; k < cells; k++) {
        const at = (du, dv) => this.#pixel(u + (w * (i + du)) / cells, v + (h * (k + dv)) / cells);
        const [[x, y], [xu, yu], [xv, yv]] = [at(0, 0), at(1, 0), at(0, 1)];
        const lap = 1 + 1 / Math.max(1, Math.min(Math.hypot(xu - x, yu - y), Math.hypot(xv - x, yv - y))); // no seams
        this.#g.setTransform(xu - x, yu - y, xv - x, yv - y, x, y);
        this.#g.drawImage(image, i * sw, k * sh, sw * lap, sh * lap, 0, 0, lap, lap);
      }
    }
    this.#g.resetTransform();
  }

  /** Put another canvas's picture where this one was drawn on; all of it is clean then. */
  clear(still) {
    this.#tile(still, this.#touched, { alpha: false });
    [this.#cleared, this.#touched] = [this.#touched, this.#cleared.fill(0)];
  }

  /** Lay an image over what was cleared, and over what was drawn since then. */
  cover(image) {
    this.#tile(image, this.#touched.map((touched, k) => touched | this.#cleared[k]), { alpha: true });
  }

  #tile(image, tiles, how) {
    if (!this.#pieces.has(image)) this.#pieces.set(image, []);
    const pieces = this.#pieces.get(image);
    for (let k = tiles.indexOf(1); k >= 0; k = tiles.indexOf(1, k + 1)) {
      const [x, y] = [(k % this.#columns) * TILE_PX, Math.floor(k / this.#columns) * TILE_PX];
      this.#g.drawImage((pieces[k] ??= piece(image, x, y, how)), x, y);
    }
  }

  #touchAround(points) {
    let [left, top, right, bottom] = [Infinity, Infinity, -Infinity, -Infinity];
    for (const [x, y] of points) {
      [left, top, right, bottom] = [Math.min(left, x), Math.min(top, y), Math.max(right, x), Math.max(bottom, y)];
    }
    this.#touch(left - 1, top - 1, right + 1, bottom + 1);
  }

  #touch(left, top, right, bottom) {
    const columns = this.#columns;
    const [first, last] = [Math.max(0, Math.floor(left / TILE_PX)), Math.min(columns - 1, Math.floor(right / TILE_PX))];
    const end = Math.min(this.#touched.length, (Math.floor(bottom / TILE_PX) + 1) * columns);
    for (let row = Math.max(0, Math.floor(top / TILE_PX)) * columns; row < end; row += columns) {
      for (let k = first; k <= last; k++) this.#touched[row + k] = 1;
    }
  }
}

function piece(image, x, y, how) {
  const canvas = new OffscreenCanvas(TILE_PX, TILE_PX);
  canvas.getContext("2d", how).drawImage(image, -x, -y);
  return canvas.transferToImageBitmap();
}

/** The convex hull of points (Andrew's monotone chain). */
function hull(points) {
  const sorted = points.toSorted((p, q) => p[0] - q[0] || p[1] - q[1]);
  const chain = [];
  const go = (point, first) => {
    while (chain.length > first && !turnsLeft(chain.at(-2), chain.at(-1), point)) chain.pop();
    chain.push(point);
  };
  for (const point of sorted) go(point, 1);
  const first = chain.length;
  for (let k = sorted.length - 2; k >= 0; k--) go(sorted[k], first);
  return chain;
}

function turnsLeft(a, b, c) {
  return (b[0] - a[0]) * (c[1] - a[1]) > (b[1] - a[1]) * (c[0] - a[0]);
}
