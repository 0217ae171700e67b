// The operator's page: takes the server's frames, draws the newest tick once a screen refresh, and says when it is old.

import { Arena } from "./arena.js";
import { Camera } from "./camera.js";
import { Charts } from "./charts.js";
import { Controls } from "./controls.js";
import { Drive } from "./drive.js";
import { Invitations } from "./invite.js";
import { Legend } from "./legend.js";
import { Link } from "./link.js";
import { PHASES } from "./phases.js";
import { Plots } from "./plots.js";
import { Projection } from "./projection.js";
import { LATCHED, robotsOf } from "./robots.js";
import { RobotTables } from "./table.js";

const LOOK_MS = 100;
const FIGURES_MS = 200; // between two writings of what is read, not watched
const EVENTS = 200; // kept in the list
const ENDED = "Ended";
const id = (name) => document.getElementById(name);

/** What the page shows now, for whoever looks at it from outside. */
const state = { hello: null, tick: null, robots: [], phase: null, t_s: null, lost: null, drawn: 0 };
const link = new Link((frame) => frames[frame.type]?.(frame));
const [arena, tables, charts] = [new Arena(), new RobotTables(), new Charts()];
const [legend, plots] = [new Legend(), new Plots()];
const [controls, camera] = [new Controls(link), new Camera(link)];
const [drive, projection] = [new Drive(link), new Projection(link)];
new Invitations();
window.robofleet = { state, place: (x_m, y_m) => arena.place(x_m, y_m) };

let drawing = false;
let writtenAt = -Infinity;

const frames = {
  hello(hello) {
    state.hello = hello;
    for (const part of [arena, tables, charts, legend, plots, camera, drive, projection]) part.begin(hello);
    id("events-list").replaceChildren();
    write("arena-name", hello.arena.name);
    write("config-name", hello.config);
    write("time-whole", hello.duration_s.toFixed(0));
    look();
  },
  tick(tick) {
    state.tick = tick;
    drive.heard(tick);
    camera.tell(tick.health);
    if (!drawing) {
      drawing = true;
      requestAnimationFrame(draw);
    }
    enter(tick);
  },
  shapes({ groups }) {
    groups.forEach((shapes, k) => (state.hello.groups[k].shapes = shapes));
    arena.redraw();
    legend.begin(state.hello);
  },
  hands: (hands) => drive.own(hands),
  event: addEvent,
  showing: (showing) => projection.showing(showing),
  answer: (answer) => (answer.to === "show" ? projection : controls).answered(answer),
  picture: (picture) => camera.draw(picture),
  ended: look,
};

// At once, not with the next drawing: a page in the background draws nothing.
function enter(tick) {
  const phase = tick.phase;
  document.body.dataset.way = tick.way ?? "";
  writePhase(tick);
  if (phase === state.phase) return;
  state.phase = phase;
  if (phase === "estop") performance.mark("estop-shown");
  controls.entered(phase);
  look();
}

/** Of a run that has ended the banner says how. */
function writePhase({ phase, cause, stage, start_share: share, what_next: next }) {
  const over = link.ended !== null;
  document.body.dataset.phase = over ? "ended" : phase;
  write("phase-name", over ? ENDED : (PHASES[phase] ?? phase));
  write("phase-cause", over ? "" : (stage ?? (cause === "nothing" ? "" : (cause ?? ""))));
  write("phase-next", over ? "" : next);
  id("start-progress").hidden = over || share === null;
  id("start-progress").value = share ?? 0;
}

function draw(now) {
  drawing = false;
  const tick = state.tick;
  state.robots = robotsOf(state.hello, tick, link.ended);
  arena.draw(state.robots);
  if (link.ended === null) {
    charts.add(tick.health);
    plots.add(state.robots, now);
  }
  if (now - writtenAt >= FIGURES_MS) {
    writtenAt = now;
    tables.draw(state.robots);
    charts.draw();
    plots.draw(now);
    writeFigures(tick);
  }
  link.send({ ack: tick.seq });
  if (state.drawn++ === 0) performance.mark("first-tick-drawn");
}

const differ = (run, clock) => run !== null && clock !== null && Math.abs(clock - run) >= 0.05; // after a hold

function writeFigures({ t_s: t, clock_s: clock, health }) {
  if (t !== null) write("time-clock", differ(t, clock) ? `${clock.toFixed(1)} s clock time` : "");
  if (t !== null || state.phase !== "idle") state.t_s = t; // what a run reached stays in sight when it is over
  const reached = state.t_s === null ? null : Math.min(state.t_s, state.hello.duration_s);
  write("time-now", reached === null ? "–" : reached.toFixed(1));
  id("time-progress").value = (reached ?? 0) / state.hello.duration_s;
  write("health-overruns", `${health.overruns ?? "–"}`);
  write("health-tracker", health.tracker_hz === null ? "–" : `${health.tracker_hz.toFixed(1)} Hz`);
  write("health-seen", health.seen_pct === null ? "–" : `${health.seen_pct.toFixed(1)} %`);
}

function addEvent({ at, clock_s: clock, level, text }) {
  const item = document.createElement("li");
  const [time, words] = [document.createElement("time"), document.createElement("span")];
  time.textContent = at === null ? "–" : `${at.toFixed(1)} s`;
  time.title = "run time";
  words.textContent = differ(at, clock) ? `${text} (${clock.toFixed(1)} s clock time)` : text;
  item.className = level;
  item.append(time, words);
  const list = id("events-list");
  list.prepend(item);
  if (list.childElementCount > EVENTS) list.lastChild.remove();
}

/** Whether what is shown can still be believed. */
function look() {
  const lost = link.lost(performance.now());
  state.lost = lost;
  id("lost-banner").hidden = lost === null;
  id("ended-banner").hidden = link.ended === null;
  document.body.classList.toggle("lost", lost !== null);
  document.body.classList.toggle("ended", link.ended !== null);
  if (lost) {
    write("lost-why", lost.why);
    write("lost-since", `For ${(lost.ms / 1000).toFixed(lost.ms < 10_000 ? 1 : 0)} s.`);
  }
  if (link.ended !== null) writeEnd(link.ended);
  const title = `${lost ? "LINK LOST" : link.ended !== null ? ENDED : (PHASES[state.phase] ?? "robofleet")} – ${state.hello?.arena.name ?? ""}`;
  if (document.title !== title) document.title = title;
  if (link.ended !== null) {
    controls.end(link.ended.resets && link.isOpen);
  } else {
    const inert = lost || !state.tick ? "no link to the robots" : "";
    controls.permit(state.phase, state.robots.some((robot) => robot.trouble === LATCHED), inert);
  }
}

/** How the run ended, and its report: by a link while this page is served, and by its place in any case. */
function writeEnd(ended) {
  const { text, lines, good, report, report_due: due, folder, stays_min: stays } = ended;
  const { latched: robots, latched_words: latched } = ended;
  if (state.tick) writePhase(state.tick);
  write("ended-text", text);
  id("ended-banner").dataset.good = `${good}`;
  id("ended-lines").hidden = lines.length === 0;
  if (id("ended-lines").childElementCount !== lines.length) {
    const items = lines.map((line) => Object.assign(document.createElement("li"), { textContent: line }));
    id("ended-lines").replaceChildren(...items);
  }
  const isServed = report !== null && link.isOpen;
  id("ended-report").hidden = !isServed;
  if (isServed) id("ended-report").href = link.address("report");
  id("ended-report-due").hidden = !due;
  const place = report === null ? `The run is kept in ${folder}.` : `The report is ${report}.`;
  write("ended-place", isServed ? `This page shows it for ${stays} minutes.` : place);
  id("ended-latched").hidden = latched === "";
  id("ended-latched").className = robots?.length ? "alarm" : "";
  write("ended-latched-words", latched);
}

function write(name, text) {
  const element = id(name);
  if (element.textContent !== text) element.textContent = text;
}

// What has the focus does not hide under the head, which is higher when it has something to say.
const head = document.querySelector(".head");
new ResizeObserver(() => {
  document.documentElement.style.setProperty("--head", `${head.offsetHeight}px`);
}).observe(head);
setInterval(look, LOOK_MS);
document.addEventListener("visibilitychange", look);
look();
