// What the operator asks for. The emergency stop acts when it is pressed, not when it is let go.

const FAILED = "The emergency stop did not get through: use the terminal (robofleet stop) or the switch.";
const LET_GO_MS = 1000; // a click so soon after a press is the same press

export class Controls {
  #link;
  #buttons = [...document.querySelectorAll("#run-controls button")];
  #estop = document.getElementById("estop-button");
  #label = document.getElementById("estop-label");
  #note = document.getElementById("estop-note");
  #answer = document.getElementById("run-answer");
  #notice = document.getElementById("notice");
  #pressedAt = -Infinity;
  #said = "Space or E"; // under the button while the link is well

  constructor(link) {
    this.#link = link;
    for (const button of this.#buttons) button.addEventListener("click", () => this.#ask(button.dataset.do));
    this.#estop.addEventListener("pointerdown", (event) => event.button === 0 && this.#emergency());
    this.#estop.addEventListener("click", () => this.#sincePressed() > LET_GO_MS && this.#emergency());
    addEventListener("keydown", (event) => this.#key(event), { capture: true });
    addEventListener("keyup", (event) => isEstop(event) && event.preventDefault(), { capture: true });
  }

  #ask(what) {
    this.#answer.textContent = `${what}: asked`;
    this.#link.send({ do: what });
  }

  #sincePressed() {
    return performance.now() - this.#pressedAt;
  }

  #key(event) {
    if (!isEstop(event)) return;
    event.preventDefault(); // space must not press the button that happens to have the focus
    if (!event.repeat) this.#emergency();
  }

  #emergency() {
    this.#pressedAt = performance.now();
    performance.mark("estop-pressed");
    this.#say("sent, waiting for the robots");
    this.#link.emergencyStop(() => this.#alarm(FAILED));
  }

  #say(words) {
    this.#said = this.#note.textContent = words;
  }

  #alarm(words) {
    this.#say("NOT confirmed");
    this.#notice.textContent = words;
    this.#notice.hidden = false;
  }

  /** Show what was answered. */
  answered({ to, ok, text }) {
    if (to !== "estop") {
      this.#answer.textContent = `${to}: ${text}`;
      this.#answer.className = ok ? "" : "refused";
    } else if (ok) {
      this.#say(text);
      this.#notice.hidden = true;
    } else {
      this.#alarm(text);
    }
  }

  /** Permit what the phase permits; nothing where the link is lost or the run has ended. */
  permit(phase, alive) {
    for (const button of this.#buttons) {
      const permitted = alive && button.dataset.in.split(" ").includes(phase);
      if (button.disabled === permitted) button.disabled = !permitted;
    }
    if (this.#estop.dataset.alive === `${alive}`) return;
    this.#estop.dataset.alive = alive;
    this.#estop.setAttribute("aria-disabled", `${!alive}`); // not `disabled`: whoever presses it all the same is tried for
    this.#label.textContent = alive ? "EMERGENCY STOP" : "CANNOT STOP";
    this.#note.textContent = alive ? this.#said : "no link to the robots";
  }

  /** Another phase: what was said about the stop before is over once the fleet is reset. */
  entered(phase) {
    if (phase === "idle" || phase === "armed") {
      this.#say("Space or E");
      this.#notice.hidden = true;
    }
  }
}

function isEstop({ key, code, target, ctrlKey, metaKey, altKey }) {
  const typing = target instanceof Element && target.matches("input, textarea, select, [contenteditable]");
  return !typing && !ctrlKey && !metaKey && !altKey && (code === "Space" || key.toLowerCase() === "e");
}
