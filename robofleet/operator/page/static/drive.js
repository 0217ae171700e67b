// A person drives the first robot of a group whose behaviour is teleop: by the stick on the page or by a gamepad.
//
// It is driven only while the stick is held, the page is visible and has the focus, and the link is well. Each command
// names the newest tick that came here, so that the controller knows how old it is. Nothing else is sent but that the
// stick is let go, at once; and that it was, before the first command on each new link.
//
// While the run is held, the stick drives one robot out, at a crawl. A stick that was held before (for another robot, in
// another phase, when the link began, while another person drove) counts for nothing until it is let go.

import { Gamepads } from "./gamepads.js";
import { Stick } from "./stick.js";

const LEAST_GAP_MS = 12; // between two commands that differ in nothing but their age
const RESCUE = "hold"; // the phase in which one robot is driven out
const PHASES = ["running", RESCUE];
const WORDS = {
  off: (robot) => `When the run drives, you drive ${robot} here.`,
  ready: (robot) => `Hold the stick to drive ${robot}. Let it go: ${robot} stands.`,
  driving: (robot) => `You drive ${robot}.`,
  again: () => "Let go, then press again.",
  taken: (robot) => `Another person drives ${robot}. Wait until that person lets go.`,
};
const WORDS_OUT = {
  ready: (robot) => `Hold the stick to drive ${robot} out at a crawl. All others stand.`,
  driving: (robot) => `You drive ${robot} out at a crawl.`,
};
const PAD_WORDS = {
  false: "Gamepad: press any button of it, then the page sees it.",
  true: "Gamepad: left stick, while you hold L1 or R1.",
};

export class Drive {
  #link;
  #panel = document.getElementById("drive-panel");
  #choice = document.getElementById("drive-robot");
  #words = document.getElementById("drive-words");
  #padWords = document.getElementById("drive-gamepad");
  #pads = new Gamepads();
  #stick = new Stick(() => this.#watch());
  #groups = []; // that a person can drive
  #tick = { tick: 0, phase: null, drivers: {} }; // the newest one that came
  #own = {}; // by which numbers `drivers` names this page
  #target = null; // what the stick drives: group, robot, and whether it is driven out
  #sentTo = null; // the group of the newest command; null: it was let go
  #sentAt = -Infinity;
  #spent = true; // held for something else, and not let go since
  #told = new Set(); // the groups to which this link said that the stick is let go

  constructor(link) {
    this.#link = link;
    for (const event of ["blur", "focus"]) addEventListener(event, () => this.#watch());
    document.addEventListener("visibilitychange", () => this.#watch());
    const everyPicture = () => {
      requestAnimationFrame(everyPicture);
      this.#watch();
    };
    everyPicture();
  }

  begin({ groups }) {
    this.#groups = document.body.dataset.role === "viewer" ? [] : groups.filter((group) => group.by_hand);
    this.#panel.hidden = this.#groups.length === 0;
    this.#told.clear();
    this.#spent = true;
    this.#offer();
  }

  /** `epochs`: of this page's hands. */
  own({ epochs }) {
    this.#own = epochs;
  }

  heard(tick) {
    const before = this.#tick.phase;
    this.#tick = tick;
    if (tick.phase !== before) this.#offer();
  }

  /** Offer who can be driven now: the first robot of each group, and of a held run any. */
  #offer() {
    const isHeld = this.#tick.phase === RESCUE;
    const robots = this.#groups.flatMap((group) => (isHeld ? group.robots : group.robots.slice(0, 1)));
    const group = this.#groupOf(this.#choice.value);
    this.#choice.replaceChildren(...robots.map((robot) => new Option(robot)));
    this.#choice.hidden = robots.length < 2;
    if (group) this.#choice.value = group.robots[0];
    this.#watch();
  }

  #groupOf(robot) {
    return this.#groups.find(({ robots }) => robots.includes(robot));
  }

  #watch() {
    const { phase, drivers } = this.#tick;
    const [robot, out] = [this.#choice.value, phase === RESCUE];
    const group = this.#groupOf(robot)?.name;
    if (group === undefined) return;
    const read = [this.#stick.read(), this.#pads.read()].find(({ held }) => held);
    const isOff = !PHASES.includes(phase) || this.#link.lost(performance.now()) !== null || this.#link.ended !== null;
    const isTaken = group in drivers && drivers[group] !== this.#own[group];
    const target = `${robot} ${out}`;
    if (!read) this.#spent = false;
    else if (isOff || isTaken || document.hidden || !document.hasFocus() || target !== this.#target) this.#spent = true;
    this.#target = target;
    const isDriving = read && !this.#spent;
    if (isDriving) this.#command(group, read, out ? robot : undefined);
    else this.#letGo();
    const how = isOff ? "off" : isTaken ? "taken" : isDriving ? "driving" : read ? "again" : "ready";
    this.#panel.dataset.how = how;
    write(this.#words, ((out && WORDS_OUT[how]) || WORDS[how])(robot));
    write(this.#padWords, PAD_WORDS[this.#pads.seen]);
  }

  #command(group, { forward, turn }, out) {
    const now = performance.now();
    if (this.#sentTo !== null && now - this.#sentAt < LEAST_GAP_MS) return;
    [this.#sentTo, this.#sentAt] = [group, now];
    if (!this.#told.has(group)) this.#send(group, [0, 0, false]);
    this.#told.add(group);
    this.#send(group, [forward, turn, true], out);
  }

  #letGo() {
    if (this.#sentTo !== null) this.#send(this.#sentTo, [0, 0, false]);
    this.#sentTo = null;
  }

  #send(group, stick, out) {
    this.#link.send({ drive: group, stick, tick: this.#tick.tick, out });
  }
}

function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}
