// A camera's picture with the tags that were found in it; the server is asked for it only while it is shown.

const LATE_MS = 500; // without an image

export class Camera {
  #panel = document.getElementById("camera-panel");
  #button = document.getElementById("camera-toggle");
  #canvas = document.getElementById("camera-view");
  #chooser = document.getElementById("camera-choice");
  #cameras = [];
  #link;

  constructor(link) {
    this.#link = link;
    this.#button.addEventListener("click", () => this.#show(this.#canvas.hidden));
    this.#chooser.addEventListener("change", () => this.#show(true));
  }

  begin({ cameras }) {
    this.#panel.hidden = cameras.length === 0;
    this.#cameras = cameras;
    this.#chooser.hidden = cameras.length < 2;
    const names = cameras.map(({ name }) => name);
    if ([...this.#chooser.options].map((option) => option.value).join() !== names.join())
      this.#chooser.replaceChildren(...names.map((name) => new Option(name, name)));
    if (!this.#canvas.hidden) this.#link.send({ picture: this.#chooser.value });
  }

  // Says of each of several cameras how it does.
  tell(health) {
    for (const { name, hz, age_ms } of health.cameras ?? []) {
      const option = [...this.#chooser.options].find((its) => its.value === name);
      const silent = age_ms === null || age_ms > LATE_MS;
      const words = silent ? `${name}: no image` : `${name}: ${hz ?? "?"} Hz`;
      if (option && option.textContent !== words) option.textContent = words;
    }
  }

  #show(shown) {
    const { width, height } = this.#cameras.find(({ name }) => name === this.#chooser.value) ?? { width: 16, height: 9 };
    this.#canvas.hidden = !shown;
    this.#button.textContent = shown ? "Hide" : "Show";
    this.#button.setAttribute("aria-expanded", `${shown}`);
    this.#canvas.width = width;
    this.#canvas.height = height;
    const g = this.#canvas.getContext("2d");
    g.font = `${height / 16}px system-ui, sans-serif`;
    g.fillStyle = "#808080";
    g.textAlign = "center";
    g.fillText("waiting for a picture", width / 2, height / 2);
    this.#link.send({ picture: shown && this.#chooser.value });
  }

  async draw({ camera, width, height, jpeg, tags }) {
    if (camera !== this.#chooser.value) return; // of the camera that was shown before
    const image = new Image();
    image.src = `data:image/jpeg;base64,${jpeg}`;
    await image.decode();
    this.#canvas.width = width;
    this.#canvas.height = height;
    const g = this.#canvas.getContext("2d");
    g.drawImage(image, 0, 0, width, height);
    const px = width / Math.max(1, this.#canvas.clientWidth); // of the screen
    for (const tag of tags) drawTag(g, tag, px);
  }
}

function drawTag(g, { id, robot, corners }, px) {
  g.beginPath();
  corners.forEach(([u, v], k) => (k ? g.lineTo(u, v) : g.moveTo(u, v)));
  g.closePath();
  g.lineJoin = "round";
  for (const [colour, width] of [["black", 2.5 * px], ["white", px]]) {
    g.strokeStyle = colour;
    g.lineWidth = width;
    g.stroke();
  }
  const [u, v] = [Math.max(...corners.map((corner) => corner[0])), Math.min(...corners.map((corner) => corner[1]))];
  g.font = `600 ${11 * px}px system-ui, sans-serif`;
  g.lineWidth = 2 * px;
  g.strokeStyle = "black";
  g.fillStyle = "white";
  g.strokeText(robot ?? `tag ${id}`, u + 2 * px, v);
  g.fillText(robot ?? `tag ${id}`, u + 2 * px, v);
}
