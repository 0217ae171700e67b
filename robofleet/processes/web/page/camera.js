// The camera's picture with the tags that were found in it; the server is asked for it only while it is shown.

export class Camera {
  #panel = document.getElementById("camera-panel");
  #button = document.getElementById("camera-toggle");
  #canvas = document.getElementById("camera-view");
  #size = { width: 16, height: 9 };
  #link;

  constructor(link) {
    this.#link = link;
    this.#button.addEventListener("click", () => this.#show(this.#canvas.hidden));
  }

  begin(hello) {
    this.#panel.hidden = hello.camera === null;
    if (hello.camera) this.#size = hello.camera;
    if (!this.#canvas.hidden) this.#link.send({ picture: true });
  }

  #show(shown) {
    this.#canvas.hidden = !shown;
    this.#button.textContent = shown ? "Hide" : "Show";
    this.#button.setAttribute("aria-expanded", `${shown}`);
    this.#canvas.width = this.#size.width;
    this.#canvas.height = this.#size.height;
    const g = this.#canvas.getContext("2d");
    g.font = `${this.#size.height / 16}px system-ui, sans-serif`;
    g.fillStyle = "#808080";
    g.textAlign = "center";
    g.fillText("waiting for a picture", this.#size.width / 2, this.#size.height / 2);
    this.#link.send({ picture: shown });
  }

  async draw({ width, height, jpeg, tags }) {
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
