// A gamepad as a stick: its left stick, held while a shoulder button is.
//
// A button that is held when its gamepad comes counts for nothing until it is let go.

const HOLD = [4, 5]; // the shoulder buttons, of the standard mapping
const [SIDEWAYS, FORWARD] = [0, 1]; // axes of the left stick: to the right and to the person are positive
const DEAD = 0.08; // of a stick that is let go

export class Gamepads {
  #up = new Set(); // gamepads whose buttons were seen up since they came
  seen = false; // a browser shows a gamepad once a button of it was pressed

  read() {
    const pads = [...navigator.getGamepads()].filter((pad) => pad?.connected);
    this.seen = pads.length > 0;
    this.#up = new Set(pads.filter((pad) => !isHeld(pad) || this.#up.has(pad.index)).map(({ index }) => index));
    const pad = pads.find((one) => isHeld(one) && this.#up.has(one.index));
    return pad ? { held: true, forward: -beyond(pad.axes[FORWARD]), turn: -beyond(pad.axes[SIDEWAYS]) } : { held: false };
  }
}

const isHeld = (pad) => HOLD.some((button) => pad.buttons[button]?.pressed);
const beyond = (value) => (Math.abs(value ?? 0) < DEAD ? 0 : Math.min(1, Math.max(-1, value)));
