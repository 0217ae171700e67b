// Sparklines of the last ten seconds: each with its newest value and its largest one.

const HEIGHT_PX = 28;
const CHARTS = [
  { name: "Tick computes", of: (health) => milli(health.compute_us), unit: "ms", digits: 2, least: 1 },
  { name: "Tick is late", of: (health) => milli(health.late_us), unit: "ms", digits: 2, least: 1 },
  { name: "Image to wheel", of: (health) => health.latency_ms, unit: "ms", digits: 0, least: 50 },
];

export class Charts {
  #charts = [];
  #samples = 300;
  #panel = document.getElementById("charts");
  #width = 0;
  #colour = "";

  constructor() {
    new ResizeObserver(() => this.#resize()).observe(this.#panel);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.#resize());
  }

  begin(hello) {
    this.#samples = Math.round(10_000 / hello.tick_ms);
    this.#charts = CHARTS.map((chart) => ({ ...chart, values: [], ...parts(chart) }));
    this.#panel.replaceChildren(...this.#charts.map((chart) => chart.row));
    this.#resize();
  }

  #resize() {
    this.#width = this.#panel.clientWidth;
    this.#colour = getComputedStyle(document.documentElement).getPropertyValue("--accent");
    for (const { canvas } of this.#charts) {
      canvas.width = this.#width * devicePixelRatio;
      canvas.height = HEIGHT_PX * devicePixelRatio;
      canvas.getContext("2d").scale(devicePixelRatio, devicePixelRatio);
    }
    this.draw();
  }

  /** Take one tick's figures. */
  add(health) {
    for (const chart of this.#charts) {
      chart.values.push(chart.of(health));
      if (chart.values.length > this.#samples) chart.values.shift();
    }
  }

  draw() {
    for (const chart of this.#charts) this.#drawChart(chart);
  }

  #drawChart({ canvas, output, values, unit, digits, least }) {
    const known = values.filter((value) => value !== null);
    const most = Math.max(...known, 0);
    const words = (value) => (value === undefined ? "–" : value.toFixed(digits));
    output.textContent = `${words(known.at(-1))} ${unit}, max ${known.length ? words(most) : "–"}`;
    const [width, height] = [this.#width, HEIGHT_PX];
    const g = canvas.getContext("2d");
    g.clearRect(0, 0, width, height);
    g.strokeStyle = this.#colour;
    g.lineWidth = 1.25;
    g.beginPath();
    const top = Math.max(most, least);
    let pen = false;
    values.forEach((value, k) => {
      if (value === null) {
        pen = false;
        return;
      }
      const x = width - ((values.length - 1 - k) / (this.#samples - 1)) * width;
      const y = height - 2 - (value / top) * (height - 4);
      if (pen) g.lineTo(x, y);
      else g.moveTo(x, y);
      pen = true;
    });
    g.stroke();
  }
}

function milli(micro) {
  return micro === null ? null : micro / 1000;
}

function parts({ name }) {
  const row = document.createElement("div");
  const [title, output, canvas] = ["span", "output", "canvas"].map((tag) => document.createElement(tag));
  row.className = "chart";
  title.textContent = name;
  canvas.setAttribute("aria-hidden", "true");
  row.append(title, output, canvas);
  return { row, canvas, output };
}
