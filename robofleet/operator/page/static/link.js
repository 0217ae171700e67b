// The link to the run: one WebSocket that opens itself again, and what is known about its age.

const SILENT_MS = 1000; // of any side: then the page shows the past
const AGAIN_MS = [250, 500, 1000, 2000]; // between two attempts
const ESTOP_PATIENCE_MS = 300; // then it is asked for in the second way too
const NEVER_OPEN = "No answer yet. The address is of one run only: take the one that the newest run prints.";

export class Link {
  #socket = null;
  #attempts = 0;
  #heardAt = performance.now();
  #everOpen = false;
  #ages = {}; // of the supervisor's and the controller's newest word, as the server said [ms]
  #answered = true; // the newest request for the emergency stop
  #token = new URLSearchParams(location.search).get("token") ?? ""; // none beyond this computer: there is a cookie
  ended = null; // how the run ended: the server's frame

  /** `onFrame` takes every frame of the server's but its beats. */
  constructor(onFrame) {
    this.onFrame = onFrame;
    this.#open();
    addEventListener("online", () => this.#socket.readyState === WebSocket.CLOSED && this.#open());
  }

  get isOpen() {
    return this.#socket.readyState === WebSocket.OPEN;
  }

  /** Why nothing here can be believed, and for how long [ms]; null while the link is well. */
  lost(now) {
    if (this.ended !== null) return null;
    const silentMs = now - this.#heardAt;
    const closed = this.#everOpen && !this.isOpen;
    if (closed || silentMs > SILENT_MS) return { why: this.#silence(), ms: silentMs };
    for (const [process, ms] of Object.entries(this.#ages)) {
      if (ms > SILENT_MS) return { why: `The ${process} is silent.`, ms: ms + silentMs };
    }
    return null;
  }

  #silence() {
    if (!this.#everOpen) return NEVER_OPEN;
    return this.isOpen ? "The page's server is silent." : "The page's server cannot be reached.";
  }

  /** The address of something that the server has, for the page alone. */
  address(path) {
    return `${path}?token=${encodeURIComponent(this.#token)}`;
  }

  send(message) {
    if (this.isOpen) this.#socket.send(JSON.stringify(message));
  }

  /** Ask for the emergency stop in every way there is; `onFailure` is called when the second way fails too. */
  emergencyStop(onFailure) {
    this.#answered = false;
    this.send({ do: "estop" });
    const post = () => this.#answered || this.#post(onFailure);
    if (this.isOpen) setTimeout(post, ESTOP_PATIENCE_MS);
    else post();
  }

  async #post(onFailure) {
    try {
      const response = await fetch("estop", { method: "POST", headers: { "X-Token": this.#token } });
      if (!response.ok) throw new Error(`${response.status}`);
      this.#take({ type: "answer", to: "estop", ...(await response.json()) });
    } catch {
      onFailure();
    }
  }

  #open() {
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = new WebSocket(`${scheme}://${location.host}/live?token=${encodeURIComponent(this.#token)}`);
    this.#socket = socket;
    socket.onopen = () => {
      this.#everOpen = true;
      this.#attempts = 0;
      this.#ages = {};
    };
    socket.onmessage = ({ data }) => this.#take(JSON.parse(data));
    socket.onclose = () => {
      if (this.ended !== null) return;
      const waitMs = AGAIN_MS[Math.min(this.#attempts++, AGAIN_MS.length - 1)];
      setTimeout(() => socket === this.#socket && this.#open(), waitMs);
    };
  }

  #take(frame) {
    this.#heardAt = performance.now();
    if (frame.type === "beat") {
      this.#ages = { supervisor: frame.supervisor, controller: frame.controller };
      return;
    }
    if (frame.type === "ended") this.ended = frame;
    if (frame.type === "answer" && frame.to === "estop") this.#answered = true;
    this.onFrame(frame);
  }
}
