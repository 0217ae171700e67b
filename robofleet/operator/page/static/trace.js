// One plot over time: lines of robots, or an area of many, between a scale on the left and seconds below.

const HEIGHT_PX = 132;
const MARGIN_PX = { left: 40, right: 8, top: 8, bottom: 18 };
const GAP_MS = 1500; // without a sample: the line breaks
const COMMON = 0.95; // of the samples are inside the scale; what is outside is cut off and marked
const ROOM = 0.1; // of what is shown, above and below
const FROM_0 = 0.5; // values whose least is less than this part of the most are shown from 0
const SECONDS = [60, 40, 20, 0];
const LINES = 4; // of a scale, about

export class Trace {
  #g;
  #width = 0;

  constructor(canvas) {
    this.canvas = canvas;
    this.#g = this.canvas.getContext("2d");
  }

  resize() {
    this.#width = this.canvas.clientWidth;
    this.canvas.width = Math.round(this.#width * devicePixelRatio);
    this.canvas.height = Math.round(HEIGHT_PX * devicePixelRatio);
    this.#g.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
  }

  /** Draw samples' values `of` a figure; `lines`: bounds; `finest`: the smallest difference that is worth a scale. */
  draw({ samples, of, from_ms, to_ms, finest, lines, colours, few }) {
    const [g, width] = [this.#g, this.#width];
    g.clearRect(0, 0, width, HEIGHT_PX);
    if (width === 0) return;
    const [left, right, top, bottom] = [
      MARGIN_PX.left, width - MARGIN_PX.right, MARGIN_PX.top, HEIGHT_PX - MARGIN_PX.bottom,
    ]; // prettier-ignore
    const known = samples.some(({ [of]: values }) => values.some((value) => !Number.isNaN(value)));
    if (!known) return drawNothing({ g, left, right, top, bottom }, colours);
    const [low, high] = range(samples, of, lines, finest);
    const x = (at_ms) => left + ((at_ms - from_ms) / (to_ms - from_ms)) * (right - left);
    const y = (value) => bottom - ((value - low) / (high - low)) * (bottom - top);
    const place = { g, x, y, left, right, top, bottom, low, high };
    drawScale(place, to_ms, colours);
    for (const line of lines) drawLine(place, line, colours);
    g.save();
    g.beginPath();
    g.rect(left, top - 1, right - left, bottom - top + 2);
    g.clip();
    if (few) drawRobots(place, samples, of, colours);
    else drawMany(place, samples, of, colours);
    g.restore();
    drawCut(place, samples, of, colours);
  }
}

function drawNothing({ g, left, right, top, bottom }, { muted, grid }) {
  g.font = "12px system-ui, sans-serif";
  g.fillStyle = muted;
  g.strokeStyle = grid;
  g.lineWidth = 1;
  g.strokeRect(left, top, right - left, bottom - top);
  g.textAlign = "center";
  g.textBaseline = "middle";
  g.fillText("no value in the last minute", (left + right) / 2, (top + bottom) / 2);
}

// What is shown: most samples and every bound, from 0 where that is near.
function range(samples, of, lines, finest) {
  const extents = samples.map((sample) => extent(sample[of])).filter(({ count }) => count > 0);
  const [leasts, mosts] = [extents.map(({ least }) => least), extents.map(({ most }) => most)];
  for (const values of [leasts, mosts]) values.sort((a, b) => a - b);
  const bounds = lines.map(({ at }) => at);
  let low = Math.min(leasts[Math.ceil((1 - COMMON) * (leasts.length - 1))] ?? 0, ...bounds);
  let high = Math.max(mosts[Math.floor(COMMON * (mosts.length - 1))] ?? 0, ...bounds);
  if (low > 0 && low < FROM_0 * high) low = 0;
  if (high < 0 && high > FROM_0 * low) high = 0;
  const room = Math.max(ROOM * (high - low), finest);
  return [low === 0 ? 0 : low - room, high === 0 && low < 0 ? 0 : high + room];
}

function step(range) {
  const rough = range / LINES;
  const power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map((k) => k * power).find((size) => size >= rough);
}

function drawScale({ g, x, y, left, right, bottom, low, high }, to_ms, { muted, grid }) {
  const size = step(high - low);
  const digits = Math.max(0, -Math.floor(Math.log10(size) + 1e-9));
  g.font = "11px system-ui, sans-serif";
  g.fillStyle = muted;
  g.strokeStyle = grid;
  g.lineWidth = 1;
  g.beginPath();
  g.textAlign = "right";
  g.textBaseline = "middle";
  for (let value = Math.ceil(low / size - 1e-9) * size; value <= high + 1e-9; value += size) {
    g.moveTo(left, y(value));
    g.lineTo(right, y(value));
    g.fillText(value.toFixed(digits), left - 6, y(value));
  }
  g.textBaseline = "top";
  for (const seconds of SECONDS) {
    g.textAlign = seconds === 0 ? "right" : seconds === SECONDS[0] ? "left" : "center";
    g.fillText(seconds === 0 ? "now" : `-${seconds} s`, x(to_ms - seconds * 1000), bottom + 5);
  }
  g.stroke();
}

function drawLine({ g, y, left, right, low, high }, { at, words }, { ink, panel }) {
  if (at < low || at > high) return;
  g.strokeStyle = g.fillStyle = ink;
  g.globalAlpha = 0.75;
  g.lineWidth = 1;
  g.setLineDash([4, 4]);
  g.beginPath();
  g.moveTo(left, y(at));
  g.lineTo(right, y(at));
  g.stroke();
  g.setLineDash([]);
  g.globalAlpha = 1;
  g.textAlign = "left";
  g.textBaseline = "bottom";
  g.strokeStyle = panel;
  g.lineWidth = 3;
  g.strokeText(words, left + 4, y(at) - 1);
  g.fillText(words, left + 4, y(at) - 1);
}

function drawRobots({ g, x, y }, samples, of, { robots }) {
  g.lineWidth = 1.5;
  g.lineJoin = "round";
  for (let row = 0; row < robots.length; row++) {
    g.strokeStyle = robots[row];
    g.beginPath();
    let last_ms = -Infinity;
    for (const { at_ms, [of]: values } of samples) {
      const value = values[row];
      if (Number.isNaN(value)) {
        last_ms = -Infinity;
      } else {
        if (at_ms - last_ms > GAP_MS) g.moveTo(x(at_ms), y(value));
        else g.lineTo(x(at_ms), y(value));
        last_ms = at_ms;
      }
    }
    g.stroke();
  }
}

function drawMany({ g, x, y }, samples, of, { accent }) {
  const extents = samples.map(({ at_ms, [of]: values }) => ({ at_ms, ...extent(values) }));
  g.fillStyle = g.strokeStyle = accent;
  g.lineWidth = 1.5;
  for (let k = 1; k < extents.length; k++) {
    const [a, b] = [extents[k - 1], extents[k]];
    if (a.count === 0 || b.count === 0 || b.at_ms - a.at_ms > GAP_MS) continue;
    g.globalAlpha = 0.3;
    g.beginPath();
    g.moveTo(x(a.at_ms), y(a.least));
    g.lineTo(x(a.at_ms), y(a.most));
    g.lineTo(x(b.at_ms), y(b.most));
    g.lineTo(x(b.at_ms), y(b.least));
    g.fill();
    g.globalAlpha = 1;
    g.beginPath();
    g.moveTo(x(a.at_ms), y(a.mean));
    g.lineTo(x(b.at_ms), y(b.mean));
    g.stroke();
  }
}

function extent(values) {
  let [least, most, sum, count] = [Infinity, -Infinity, 0, 0];
  for (const value of values) {
    if (Number.isNaN(value)) continue;
    least = Math.min(least, value);
    most = Math.max(most, value);
    sum += value;
    count++;
  }
  return { least, most, count, mean: sum / count };
}

// A mark at the edge, where a value lies beyond it.
function drawCut({ g, x, top, bottom, low, high }, samples, of, { amber }) {
  g.fillStyle = amber;
  g.beginPath();
  for (const { at_ms, [of]: values } of samples) {
    if (values.some((value) => value > high)) g.rect(x(at_ms) - 1, top - 4, 2, 4);
    if (values.some((value) => value < low)) g.rect(x(at_ms) - 1, bottom, 2, 4);
  }
  g.fill();
}
