// Sparklines of the last ten seconds: each with its newest value and its largest one.

const HEIGHT_PX = 34;
const EVERY_MS = 100;
const CHARTS = [
  { name: "Tick computes", of: (health) => health.compute_us / 1000, unit: "ms", digits: 2, least: 1 },
  { name: "Tick is late", of: (health) => health.late_us / 1000, unit: "ms", digits: 2, least: 1 },
  { name: "Image to wheel", of: (health) => health.latency_ms, unit: "ms", digits: 0, least: 50 },
];

export class Charts {
  #charts = [];
  #drawnAt = 0;
  #samples = 300;

  begin(hello) {
    this.#samples = Math.round(10_000 / hello.tick_ms);
    this.#charts = CHARTS.map((chart) => ({ ...chart, values: [], ...parts(chart) }));
    document.getElementById("charts").replaceChildren(...this.#charts.map((chart) => chart.row));
  }

  draw(health, now) {
    for (const chart of this.#charts) {
      const value = chart.of(health);
      chart.values.push(Number.isFinite(value) ? value : null);
      if (chart.values.length > this.#samples) chart.values.shift();
    }
    if (now - this.#drawnAt < EVERY_MS) return;
    this.#drawnAt = now;
    for (const chart of this.#charts) this.#drawChart(chart);
  }

  #drawChart({ canvas, output, values, unit, digits, least }) {
    const known = values.filter((value) => value !== null);
    const most = Math.max(...known, 0);
    const words = (value) => (value === undefined ? "–" : value.toFixed(digits));
    output.textContent = `${words(known.at(-1))} ${unit}, max ${known.length ? words(most) : "–"}`;
    const [width, height] = [canvas.clientWidth, HEIGHT_PX];
    canvas.width = width * devicePixelRatio;
    canvas.height = height * devicePixelRatio;
    const g = canvas.getContext("2d");
    g.scale(devicePixelRatio, devicePixelRatio);
    g.strokeStyle = getComputedStyle(canvas).color;
    g.lineWidth = 1.25;
    g.beginPath();
    const top = Math.max(most, least);
    let pen = false;
    values.forEach((value, k) => {
      if (value === null) return void (pen = false);
      const x = width - ((values.length - 1 - k) / (this.#samples - 1)) * width;
      const y = height - 2 - (value / top) * (height - 4);
      if (pen) g.lineTo(x, y);
      else g.moveTo(x, y);
      pen = true;
    });
    g.stroke();
  }
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
