// What part of the arena is in sight: the wheel, two fingers, a drag, the keys and three buttons change it.

const MOST = 20; // times larger than whole
const STEP = 1.4; // of a key or a button
const WHEEL = 0.0015; // of a wheel's pixel
const LINE_PX = 16; // of a wheel that counts lines
const KEY_PX = 60;
const WHOLE = { factor: 1, x_m: 0, y_m: 0 };

export class Look {
  #stage = document.getElementById("arena-stage");
  #reset = document.getElementById("look-reset");
  #fingers = new Map(); // where each pointer was last [CSS px of the stage]
  #size = [1, 1];
  #view = () => null;
  #changed;
  now = WHOLE;

  /** `view` returns the View of now, or null; `changed` is called when another part is in sight. */
  constructor(view, changed) {
    this.#view = view;
    this.#changed = changed;
    const stage = this.#stage;
    stage.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    stage.addEventListener("pointerdown", (event) => this.#press(event));
    stage.addEventListener("pointermove", (event) => this.#move(event));
    for (const end of ["pointerup", "pointercancel"]) stage.addEventListener(end, (event) => this.#letGo(event));
    stage.addEventListener("dblclick", () => this.reset());
    stage.addEventListener("keydown", (event) => this.#key(event));
    for (const [name, factor] of [["in", STEP], ["out", 1 / STEP]]) {
      document.getElementById(`look-${name}`).addEventListener("click", () => this.#zoom(factor));
    }
    this.#reset.addEventListener("click", () => this.reset());
  }

  /** Take the arena's size [m]. */
  begin(size) {
    this.#size = size;
    this.reset();
  }

  reset() {
    this.#set(WHOLE);
  }

  // The place under (x, y) stays there; without one the middle of the stage does.
  #zoom(factor, x = null, y = null) {
    const view = this.#view();
    if (view === null) return;
    const wanted = Math.min(MOST, Math.max(1, this.now.factor * factor));
    const [x_m, y_m] = x === null ? [this.now.x_m, this.now.y_m] : view.floor(x, y);
    const kept = this.now.factor / wanted; // of the way from that place to the middle
    const toward = (at, middle) => at + (middle - at) * kept;
    this.#set({ factor: wanted, x_m: toward(x_m, this.now.x_m), y_m: toward(y_m, this.now.y_m) });
  }

  #shift(dx, dy) {
    const view = this.#view();
    if (view === null) return;
    const { factor, x_m, y_m } = this.now;
    this.#set({ factor, x_m: x_m - dx / view.scale, y_m: y_m + dy / view.scale });
  }

  // The middle of the sight stays on the floor; all of the floor has one middle.
  #set({ factor, x_m, y_m }) {
    const [w, h] = this.#size.map((length) => (length / 2) * (1 - 1 / factor));
    const within = (value, most) => Math.min(most, Math.max(-most, value));
    this.now = { factor, x_m: within(x_m, w), y_m: within(y_m, h) };
    const zoomed = factor > 1;
    this.#stage.classList.toggle("zoomed", zoomed);
    this.#reset.disabled = !zoomed;
    this.#changed();
  }

  #wheel(event) {
    const pixels = event.deltaY * (event.deltaMode === WheelEvent.DOM_DELTA_LINE ? LINE_PX : 1);
    if (pixels >= 0 && this.now.factor === 1) return; // nothing is left to make smaller: the page scrolls
    event.preventDefault();
    this.#zoom(Math.exp(-pixels * WHEEL), ...this.#place(event));
  }

  #place({ clientX, clientY }) {
    const { left, top } = this.#stage.getBoundingClientRect();
    return [clientX - left, clientY - top];
  }

  #press(event) {
    if (event.button !== 0 || event.target.closest("button")) return;
    this.#fingers.set(event.pointerId, this.#place(event));
    this.#stage.setPointerCapture(event.pointerId);
  }

  #move(event) {
    const before = this.#fingers.get(event.pointerId);
    if (before === undefined) return;
    const [x, y] = this.#place(event);
    this.#fingers.set(event.pointerId, [x, y]);
    const other = [...this.#fingers].find(([id]) => id !== event.pointerId)?.[1];
    if (other === undefined) {
      if (this.now.factor > 1) this.#shift(x - before[0], y - before[1]);
      return;
    }
    const middle = (one, two) => (one + two) / 2;
    const apart = ([u, v]) => Math.max(1, Math.hypot(u - other[0], v - other[1]));
    this.#shift(middle(x, other[0]) - middle(before[0], other[0]), middle(y, other[1]) - middle(before[1], other[1]));
    this.#zoom(apart([x, y]) / apart(before), middle(x, other[0]), middle(y, other[1]));
  }

  #letGo({ pointerId }) {
    this.#fingers.delete(pointerId);
  }

  // Space and E are not here: they are the emergency stop wherever the focus is.
  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const acts = {
      "+": () => this.#zoom(STEP),
      "=": () => this.#zoom(STEP),
      "-": () => this.#zoom(1 / STEP),
      0: () => this.reset(),
      ArrowLeft: () => this.#shift(KEY_PX, 0),
      ArrowRight: () => this.#shift(-KEY_PX, 0),
      ArrowUp: () => this.#shift(0, KEY_PX),
      ArrowDown: () => this.#shift(0, -KEY_PX),
    };
    const act = acts[event.key];
    if (act === undefined || (event.key.startsWith("Arrow") && this.now.factor === 1)) return;
    event.preventDefault();
    act();
  }
}
