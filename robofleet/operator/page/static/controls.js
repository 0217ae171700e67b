// What the operator asks for. The emergency stop acts when it is pressed, not when it is let go.

const FAILED = "The emergency stop did not get through: use the terminal (robofleet stop) or the switch.";
const HINT = matchMedia("(pointer: coarse)").matches ? "" : "Space or E";
const LET_GO_MS = 1000; // a click so soon after a press is the same press

export class Controls {
  #link;
  #buttons = [...document.querySelectorAll("#run-controls button")];
  #reset = document.getElementById("ended-reset"); // beside the words that name the latches
  #estop = document.getElementById("estop-button");
  #label = document.getElementById("estop-label");
  #note = document.getElementById("estop-note");
  #answer = document.getElementById("run-answer");
  #notice = document.getElementById("notice");
  #pressedAt = -Infinity;
  #said = HINT; // under the button while it works
  #inert = "";

  constructor(link) {
    this.#link = link;
    for (const button of this.#buttons) button.addEventListener("click", () => this.#ask(button.dataset.do));
    this.#reset.addEventListener("click", () => this.#ask("reset"));
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
    if (this.#link.ended !== null) return; // nothing is left that could be asked
    this.#pressedAt = performance.now();
    performance.mark("estop-pressed");
    this.#say("sent, waiting for the robots");
    this.#link.emergencyStop(() => this.#alarm(FAILED));
  }

  #say(words) {
    this.#said = words;
    this.#note.textContent = this.#inert || words;
  }

  #alarm(words) {
    this.#say("NOT confirmed");
    this.#notice.textContent = words;
    this.#notice.hidden = false;
  }

  /** Show what was answered. */
  answered({ to, ok, text }) {
    this.#answer.textContent = `${to}: ${text}`;
    this.#answer.className = ok ? "" : "refused";
    if (to !== "estop") return;
    if (ok) {
      this.#say(text);
      this.#notice.hidden = true;
    } else {
      this.#alarm(text);
    }
  }

  /** Permit what the phase permits; nothing where `inert` says in words why not. */
  permit(phase, latched, inert) {
    this.#enable((what, phases) => !inert && phases.includes(phase) && (what !== "reset" || phase !== "idle" || latched));
    this.#sayInert(inert, "CANNOT STOP");
  }

  /** The run has ended: nothing is left to be stopped; `resets`: its latches can be cleared here. */
  end(resets) {
    this.#reset.hidden = !resets;
    this.#enable((what) => what === "reset" && resets);
    this.#sayInert("nothing is left to stop", "The run has ended");
    this.#notice.hidden = true;
  }

  #enable(permits) {
    for (const button of this.#buttons) {
      const permitted = permits(button.dataset.do, button.dataset.in.split(" "));
      if (button.disabled === permitted) button.disabled = !permitted;
    }
  }

  #sayInert(inert, label) {
    if (this.#inert === inert) return;
    this.#inert = inert;
    this.#estop.setAttribute("aria-disabled", `${Boolean(inert)}`); // not `disabled`: pressed all the same, it tries
    this.#label.textContent = inert ? label : "EMERGENCY STOP";
    this.#note.textContent = inert || this.#said;
  }

  /** Another phase: what was said about the stop before is over once the fleet is reset. */
  entered(phase) {
    if (phase === "idle" || phase === "armed") {
      this.#say(HINT);
      this.#notice.hidden = true;
    }
  }
}

// Wherever the focus is: the page has no field to type into.
function isEstop({ key, code, ctrlKey, metaKey, altKey }) {
  return !ctrlKey && !metaKey && !altKey && (code === "Space" || key.toLowerCase() === "e");
}
