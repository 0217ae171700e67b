// The stick on the page: a finger, a mouse or its pen holds it, or arrow keys and W, A, S, D while it has the focus.
//
// Whatever may hide that it is let go lets it go: a lost focus or pointer, another key, another button of the mouse.

const DEAD = 0.08; // around its middle
const WAYS = {
  ArrowUp: [1, 0], KeyW: [1, 0],
  ArrowDown: [-1, 0], KeyS: [-1, 0],
  ArrowLeft: [0, 1], KeyA: [0, 1],
  ArrowRight: [0, -1], KeyD: [0, -1],
}; // forward, and to the left
const REST = { held: false, forward: 0, turn: 0 };

export class Stick {
  #ring = document.getElementById("drive-stick");
  #changed;
  #finger = null; // the pointer that holds it
  #keys = new Set(); // that hold it
  #now = REST;

  /** `changed` is called when it is held and when it is let go. */
  constructor(changed) {
    this.#changed = changed;
    const ring = this.#ring;
    ring.addEventListener("pointerdown", (event) => this.#press(event));
    ring.addEventListener("pointermove", (event) => this.#move(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      ring.addEventListener(end, ({ pointerId }) => pointerId === this.#finger && this.letGo());
    }
    ring.addEventListener("contextmenu", (event) => event.preventDefault()); // of a finger that rests
    ring.addEventListener("keydown", (event) => this.#keyDown(event));
    ring.addEventListener("keyup", ({ code }) => this.#keys.delete(code) && this.#turn());
    ring.addEventListener("blur", () => this.letGo());
    addEventListener("blur", () => this.letGo());
  }

  read() {
    return this.#now;
  }

  letGo() {
    this.#finger = null;
    this.#keys.clear();
    this.#set(REST);
  }

  #press(event) {
    if (event.button !== 0 || event.ctrlKey || this.#finger !== null) return;
    event.preventDefault();
    this.#ring.focus({ preventScroll: true, focusVisible: false });
    this.#keys.clear();
    this.#finger = event.pointerId;
    this.#ring.setPointerCapture(event.pointerId);
    this.#move(event);
  }

  #move({ pointerId, buttons, clientX, clientY }) {
    if (pointerId !== this.#finger) return;
    if (!(buttons & 1)) {
      this.letGo(); // another button of the mouse is still down
      return;
    }
    const { left, top, width, height } = this.#ring.getBoundingClientRect();
    const [x, y] = [(clientX - left - width / 2) / (width / 2), (clientY - top - height / 2) / (height / 2)];
    const far = Math.hypot(x, y);
    const part = far < DEAD ? 0 : 1 / Math.max(1, far);
    this.#set({ held: true, forward: -y * part, turn: -x * part });
  }

  #keyDown(event) {
    const { code, repeat, ctrlKey, metaKey, altKey } = event;
    if (!(code in WAYS) || ctrlKey || metaKey || altKey) {
      this.letGo(); // as Space and E, the emergency stop
      return;
    }
    event.preventDefault(); // arrows scroll
    if (repeat || this.#finger !== null) return;
    this.#keys.add(code);
    this.#turn();
  }

  #turn() {
    const sum = (axis) => Math.sign([...this.#keys].reduce((total, code) => total + WAYS[code][axis], 0));
    this.#set({ held: this.#keys.size > 0, forward: sum(0), turn: sum(1) });
  }

  #set(now) {
    const before = this.#now;
    this.#now = now;
    const far = Math.max(1, Math.hypot(now.forward, now.turn)); // of two keys
    this.#ring.style.setProperty("--x", -now.turn / far);
    this.#ring.style.setProperty("--y", -now.forward / far);
    if (now.held !== before.held) this.#changed();
  }
}
