// A gamepad drives the first robot of a group whose behaviour is teleop, while its dead-man's button is held.
//
// Each command names the newest tick that came here, so that the controller knows how old it is. Nothing is sent without
// the button but its release, once, and once on each new link that it is up. A page in the background reads no gamepad:
// then the robots stand, too. A button that is held when its gamepad comes counts for nothing until it is let go.
//
// While the run is held, it drives one robot of the group out, at a crawl: the one that is chosen here. A button that was
// held when the run was held, or when it goes on, counts for nothing until it is let go: the server sees to that.

const HOLD = [4, 5]; // the shoulder buttons, of the standard mapping
const [SIDEWAYS, FORWARD] = [0, 1]; // axes of the left stick: to the right and to the person are positive
const DEAD = 0.08; // of a stick that is let go
const WORDS = {
  none: () => "Press a button of a gamepad: then the page sees it.",
  ready: (robot) => `Hold a shoulder button (L1 or R1) and drive ${robot} with the left stick. Let it go: ${robot} stands.`,
  driving: (robot) => `${robot} is driven.`,
  held: (robot) => `The run is held. Hold a shoulder button (L1 or R1) to drive ${robot} out, at a crawl; all others stand.`,
  out: (robot) => `${robot} is driven out, at a crawl.`,
};

export class Gamepads {
  #link;
  #panel = document.getElementById("gamepad-panel");
  #words = document.getElementById("gamepad-words");
  #chosen = document.getElementById("gamepad-group");
  #out = document.getElementById("gamepad-out");
  #held = false; // the run
  #groups = []; // that a person can drive
  #tick = 0; // the newest one that came
  #driven = ""; // group
  #up = new Set(); // gamepads whose buttons were seen up since they came
  #told = false; // on this link, that the button is up
  #watching = false;

  constructor(link) {
    this.#link = link;
  }

  begin({ groups }) {
    const isViewer = document.body.dataset.role === "viewer";
    this.#groups = isViewer ? [] : groups.filter((group) => group.by_hand);
    this.#panel.hidden = this.#groups.length === 0;
    this.#chosen.replaceChildren(...this.#groups.map(({ name }) => new Option(name)));
    this.#chosen.hidden = this.#groups.length < 2;
    this.#offer();
    this.#chosen.onchange = () => {
      this.#up.clear();
      this.#offer();
    };
    this.#told = false;
    if (this.#watching || !this.#groups.length) return;
    this.#watching = true;
    this.#watch();
  }

  heard({ tick, phase }) {
    this.#tick = tick;
    this.#held = phase === "hold";
    this.#out.hidden = !this.#held;
  }

  get #group() {
    return this.#groups.find(({ name }) => name === this.#chosen.value) ?? this.#groups[0];
  }

  #offer() {
    this.#out.replaceChildren(...(this.#group?.robots ?? []).map((robot) => new Option(robot)));
  }

  #watch() {
    requestAnimationFrame(() => this.#watch());
    const group = this.#group;
    if (!group) return;
    const pads = [...navigator.getGamepads()].filter((pad) => pad?.connected);
    const isUp = (pad) => !isHeld(pad) || this.#up.has(pad.index);
    this.#up = new Set(pads.filter(isUp).map(({ index }) => index));
    const pad = pads.find((one) => isHeld(one) && this.#up.has(one.index));
    const driven = pad ? group.name : "";
    const out = this.#held ? { out: this.#out.value } : {};
    if (!this.#told && !pad && this.#up.size) {
      this.#told = true;
      for (const { name } of this.#groups) this.#send(name, [0, 0, false], {});
    }
    if (this.#driven && this.#driven !== driven) this.#send(this.#driven, [0, 0, false], out);
    if (pad) this.#send(driven, [-beyond(pad.axes[FORWARD]), -beyond(pad.axes[SIDEWAYS]), true], out);
    this.#driven = driven;
    const [ready, driving] = this.#held ? ["held", "out"] : ["ready", "driving"];
    const words = WORDS[pad ? driving : pads.length ? ready : "none"](this.#held ? this.#out.value : group.robots[0]);
    if (this.#words.textContent !== words) this.#words.textContent = words;
  }

  #send(group, stick, out) {
    this.#link.send({ drive: group, stick, tick: this.#tick, ...out });
  }
}

const isHeld = (pad) => HOLD.some((button) => pad.buttons[button]?.pressed);
const beyond = (value) => (Math.abs(value ?? 0) < DEAD ? 0 : value);
