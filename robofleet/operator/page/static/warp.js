// A canvas of a projector, drawn on as if it were the floor: what a 2D context has, in units of the floor.
//
// Points go through the projector's lens one by one, and lines in short pieces: so they fall where they belong, and are
// as sharp as the projector's pixels. What is drawn is remembered by tiles, so that only these are cleared.

const STEP_PX = 40; // of a line: its chords are 0.1 px off at most
const ROUND = 48; // chords of a circle
const TILE_PX = 64;
const MOST_LETTERED = 300;
const SAME = ["strokeStyle", "fillStyle", "globalAlpha", "font", "textAlign", "textBaseline"];

export class Warp {
  #g;
  #pixel;
  #px; // of a unit
  #columns;
  #touched; // tiles that have been drawn on
  #cleared; // and those before them
  #letters = new Map(); // pictures of words
  #points = []; // of the path
  #begin = null; // of the part of the path that is drawn now [units]
  #last = null;

  /** `pixel` returns where a place on the floor (and its height) is in the picture; `px`: pixels of a unit. */
  constructor(g, pixel, px) {
    [this.#g, this.#pixel, this.#px] = [g, pixel, px];
    const { width, height } = g.canvas;
    this.#columns = Math.ceil(width / TILE_PX);
    this.#touched = new Uint8Array(this.#columns * Math.ceil(height / TILE_PX));
    this.#cleared = this.#touched.slice();
    g.lineJoin = g.lineCap = "round";
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
    this.#points = [];
    this.#last = null;
  }

  moveTo(u, v) {
    this.#begin = this.#last = [u, v];
    this.#g.moveTo(...this.#kept(this.#pixel(u, v)));
  }

  lineTo(u, v) {
    if (this.#last === null) return this.moveTo(u, v);
    const [u0, v0] = this.#last;
    const pieces = Math.max(1, Math.ceil((Math.hypot(u - u0, v - v0) * this.#px) / STEP_PX));
    for (let k = 1; k <= pieces; k++) {
      const share = k / pieces;
      this.#g.lineTo(...this.#kept(this.#pixel(u0 + share * (u - u0), v0 + share * (v - v0))));
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
    for (const [x, y] of this.#points) this.#touch(x - reach, y - reach, x + reach, y + reach);
  }

  fill() {
    this.#g.fill();
    this.#touchAround(this.#points);
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
    const [g, px, [x, y]] = [this.#g, this.#px, this.#pixel(u, v)];
    const [[xu, yu], [xv, yv]] = [this.#pixel(u + 1, v), this.#pixel(u, v + 1)];
    const { image, left, top } = this.#lettered(how, words);
    g.setTransform((xu - x) / px, (yu - y) / px, (xv - x) / px, (yv - y) / px, x, y);
    g.drawImage(image, -left, -top);
    g.resetTransform();
    const at = ([du, dv]) => this.#pixel(u + du / px, v + dv / px);
    const [right, bottom] = [image.width - left, image.height - top];
    this.#touchAround([[-left, -top], [right, -top], [right, bottom], [-left, bottom]].map(at));
  }

  // Letters as large as these are dear to draw: each line of words is drawn once, and its picture kept.
  #lettered(how, words) {
    const g = this.#g;
    const style = how === "fillText" ? g.fillStyle : g.strokeStyle;
    const key = [how, words, g.font, style, g.lineWidth, g.textAlign, g.textBaseline].join();
    if (!this.#letters.has(key)) {
      if (this.#letters.size >= MOST_LETTERED) this.#letters.clear();
      const box = g.measureText(words);
      const margin = g.lineWidth / 2 + 1;
      const sides = ["Left", "Ascent", "Right", "Descent"].map((side) => box[`actualBoundingBox${side}`] * this.#px + margin);
      const [left, top, right, bottom] = sides.map(Math.ceil);
      const canvas = new OffscreenCanvas(left + right, top + bottom);
      const own = canvas.getContext("2d");
      for (const name of SAME) own[name] = g[name];
      own.lineJoin = "round";
      own.lineWidth = g.lineWidth / this.#px;
      own.setTransform(this.#px, 0, 0, this.#px, left, top);
      own[how](words, 0, 0);
      this.#letters.set(key, { image: canvas.transferToImageBitmap(), left, top });
    }
    return this.#letters.get(key);
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
    this.#tile(still, this.#touched);
    [this.#cleared, this.#touched] = [this.#touched, this.#cleared.fill(0)];
  }

  /** Lay an image over what was cleared, and over what was drawn since then. */
  cover(image) {
    this.#tile(image, this.#touched.map((touched, k) => touched | this.#cleared[k]));
  }

  #tile(image, tiles) {
    const columns = this.#columns;
    for (let k = tiles.indexOf(1); k >= 0; k = tiles.indexOf(1, k)) {
      const [row, first] = [Math.floor(k / columns), k];
      while (k < (row + 1) * columns && tiles[k]) k++;
      const [x, y, w] = [(first - row * columns) * TILE_PX, row * TILE_PX, (k - first) * TILE_PX];
      this.#g.drawImage(image, x, y, w, TILE_PX, x, y, w, TILE_PX);
    }
  }

  #kept(point) {
    this.#points.push(point);
    return point;
  }

  #touchAround(points) {
    const [xs, ys] = [0, 1].map((axis) => points.map((point) => point[axis]));
    this.#touch(Math.min(...xs) - 1, Math.min(...ys) - 1, Math.max(...xs) + 1, Math.max(...ys) + 1);
  }

  #touch(left, top, right, bottom) {
    const rows = this.#touched.length / this.#columns;
    const tile = (px, most) => Math.min(most, Math.max(0, Math.floor(px / TILE_PX)));
    const [first, last] = [tile(left, this.#columns), tile(right, this.#columns - 1)];
    for (let row = tile(top, rows); row <= tile(bottom, rows - 1); row++) {
      if (first <= last) this.#touched.fill(1, row * this.#columns + first, row * this.#columns + last + 1);
    }
  }
}

/** The convex hull of points (Andrew's monotone chain). */
function hull(points) {
  const sorted = [...points].sort(([x, y], [u, v]) => x - u || y - v);
  const half = (some) => {
    const chain = [];
    for (const [x, y] of some) {
      while (chain.length > 1) {
        const [[a, b], [c, d]] = chain.slice(-2);
        if ((c - a) * (y - b) > (d - b) * (x - a)) break;
        chain.pop();
      }
      chain.push([x, y]);
    }
    return chain.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}
