// The behaviours' figures of each robot over the last minute. Of many robots: what lies between the least and the most.

import { heading, inWords } from "./figures.js";
import { chip } from "./table.js";
import { Trace } from "./trace.js";
import { coloursOfTheDay, dark, robotColours } from "./view.js";

const EVERY_MS = 200; // a sample: of its ticks the one that differs most from the sample before
const WINDOW_MS = 60_000;
const SAMPLES = WINDOW_MS / EVERY_MS;
const FEW = 12; // robots that have lines of their own
const BOUNDS = { mean: "bound of the mean", max: "bound" };

export class Plots {
  #panel = document.getElementById("plots-panel");
  #place = document.getElementById("plots");
  #legend = document.getElementById("plots-legend");
  #samples = []; // { at_ms, 0, 1, ... }: of each figure an array with a value a robot
  #hello = null;
  #plots = []; // { figure, trace, now, lines, few }
  #colours = null;
  #resizes = new ResizeObserver(() => this.#resize());

  constructor() {
    dark.addEventListener("change", () => this.#resize());
  }

  begin(hello) {
    this.#hello = hello;
    this.#samples = [];
    this.#panel.hidden = hello.figures.length === 0;
    const shown = hello.robots.filter(({ id }) => hello.figures.some(({ robots }) => robots.includes(id)));
    const few = shown.length <= FEW;
    const common = few && hello.groups.length < 2; // several groups have headings with their own
    this.#legend.replaceChildren(...(common ? shown.map(chip) : []));
    if (!few) this.#legend.textContent = `${shown.length} robots: the area from the least to the most, and the mean`;
    this.#resizes.disconnect();
    this.#plots = hello.figures.map((figure) => ({ figure, few, lines: boundsOf(figure), ...parts(figure) }));
    this.#place.replaceChildren(...this.#plots.flatMap(({ figure, part }, k) => [...this.#heading(figure, k), part]));
    for (const { trace } of this.#plots) this.#resizes.observe(trace.canvas);
    this.#resize();
  }

  /** Take a tick's robots; null is no value. */
  add(robots, now_ms) {
    let last = this.#samples.at(-1);
    if (last === undefined || now_ms - last.at_ms >= EVERY_MS) {
      last = { at_ms: now_ms };
      for (const k of this.#plots.keys()) last[k] = new Float32Array(robots.length).fill(NaN);
      this.#samples.push(last);
      while (this.#samples.length > SAMPLES || this.#samples[0].at_ms < now_ms - WINDOW_MS) this.#samples.shift();
    }
    const before = this.#samples.at(-2);
    for (const { row, figures } of robots) {
      for (const k of this.#plots.keys()) keep(last[k], row, figures[k], before?.[k][row] ?? NaN);
    }
  }

  draw(now_ms) {
    if (this.#hello === null || this.#colours === null) return;
    const common = { samples: this.#samples, colours: this.#colours, from_ms: now_ms - WINDOW_MS, to_ms: now_ms };
    this.#plots.forEach(({ figure, trace, now, lines, few }, k) => {
      trace.draw({ ...common, of: k, lines, few, finest: 10 ** -figure.digits });
      const text = this.#words(figure, k);
      if (now.textContent !== text) now.textContent = text;
    });
  }

  // Above the first plot of other robots than the one before: their groups, and their colours.
  #heading({ robots: own }, k) {
    const { groups, robots, figures } = this.#hello;
    if (groups.length < 2 || (k > 0 && figures[k - 1].robots.join() === own.join())) return [];
    const names = groups.filter((group) => group.robots.some((id) => own.includes(id))).map(({ name }) => name);
    const heading = Object.assign(document.createElement("h3"), { className: "chips", textContent: names.join(", ") });
    if (this.#plots[k].few) heading.append(...robots.filter(({ id }) => own.includes(id)).map(chip));
    return [heading];
  }

  #words(figure, k) {
    const known = [...(this.#samples.at(-1)?.[k] ?? [])].filter((value) => !Number.isNaN(value));
    if (known.length === 0) return "–";
    const [least, most] = [Math.min(...known), Math.max(...known)].map((value) => inWords(figure, value));
    return `${least === most ? most : `${least} to ${most}`} ${figure.unit}`.trim();
  }

  #resize() {
    if (this.#hello === null) return;
    const named = coloursOfTheDay(["ink", "muted", "grid", "line", "accent", "amber", "panel"]);
    this.#colours = { ...named, robots: robotColours(this.#hello) };
    for (const { trace } of this.#plots) trace.resize();
    this.draw(performance.now());
  }
}

function boundsOf({ bounds }) {
  const known = Object.entries(bounds).filter(([, at]) => at !== null);
  return known.map(([of, at]) => ({ at, words: BOUNDS[of] }));
}

function parts(figure) {
  const [part, words, canvas] = ["div", "p", "canvas"].map((kind) => document.createElement(kind));
  const [name, now] = [document.createElement("b"), document.createElement("span")];
  part.className = "plot";
  name.textContent = heading(figure);
  name.title = figure.meaning;
  words.append(name, " ", now);
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${heading(figure)} of each robot over the last minute; the table has the newest`);
  part.append(words, canvas);
  return { part, now, trace: new Trace(canvas) };
}

// A spike in either direction is kept: how a figure is read, only its behaviour knows.
function keep(values, row, value, before) {
  if (value === null) return;
  const from = Number.isNaN(before) ? 0 : before;
  if (Number.isNaN(values[row]) || Math.abs(value - from) > Math.abs(values[row] - from)) values[row] = value;
}
