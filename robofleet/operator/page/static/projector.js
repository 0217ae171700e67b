// A projector's page: what is known of a run drawn on the floor, each thing where it will be when its light falls.

import { Scene } from "./scene.js";
import { Link } from "./link.js";
import { HALTED, robotsOf } from "./robots.js";

const STOPPED = ["hold", "fault", "estop"]; // phases
const LONGEST_MS = 500; // beyond, nobody knows where a robot is
const JUMP_M = 0.05; // of a reference between two ticks: it does not move, it is another
const SHOWN_PICTURES = 1.5; // from a picture's drawing to the one that `delay_s` counts from, and half as long as it stays
const ACK_TICKS = 2; // of the four that the server lets be on their way: each word costs the run's computer something
const name = new URLSearchParams(location.search).get("name");
const canvas = document.getElementById("light");

/** What the page shows now, for whoever looks at it from outside. */
const state = { hello: null, tick: null, robots: [], rates: [], show: [], words: "", pictures: 0, light_in_s: 0, seen: [] };
const link = new Link((frame) => frames[frame.type]?.(frame));
window.robofleet = { state, pixel: (x_m, y_m, z_m) => scene?.lens.pixel(x_m, y_m, z_m) };

let scene = null; // null: nothing can be drawn
let [tickAt, drawnSeq, lastPicture, periodMs] = [0, 0, 0, 1000 / 60];

const frames = {
  hello(hello) {
    state.hello = hello;
    begin();
  },
  tick(tick) {
    const before = state.tick;
    [state.tick, tickAt] = [tick, performance.now()];
    state.robots = robotsOf(state.hello, tick, link.ended).map((robot) => blamed(robot, tick));
    const ticks = tick.tick - (before?.tick ?? tick.tick);
    if (ticks !== 0) state.rates = rates(before, tick.phase === "running" ? ticks * state.hello.tick_ms : 0);
    scene?.take(state.robots);
  },
  shapes({ groups }) {
    groups.forEach((shapes, k) => (state.hello.groups[k].shapes = shapes));
    scene?.redraw();
  },
  showing({ show }) {
    state.show = show;
    scene?.choose(show);
  },
};

/** A robot by which all of the run is stopped: it says so, though it is not halted alone. */
function blamed(robot, { phase, cause }) {
  const [start, stops] = [`${robot.id}: `, STOPPED.includes(phase) && cause !== null];
  if (!stops || !cause.startsWith(start) || robot.trouble >= HALTED) return robot;
  return { ...robot, trouble: HALTED, words: `stopped: ${cause.slice(start.length)}` };
}

/** How fast each reference moves [m/ms]. */
function rates(before, ms) {
  const columns = ["reference_x_m", "reference_y_m"].map((column) => state.hello.columns.indexOf(column));
  return state.tick.robots.map((values, row) => {
    const step = columns.map((k) => values[k] - before.robots[row][k]);
    return ms > 0 && Math.hypot(...step) < JUMP_M ? step.map((length) => length / ms) : [0, 0];
  });
}

/** Take the run, or another size of the window. */
function begin() {
  if (state.hello === null) return;
  const seen = [Math.min(innerWidth, screen.width), Math.min(innerHeight, screen.height)];
  const size = seen.map((side) => Math.round(side * devicePixelRatio));
  const own = state.hello.projectors.find((projector) => projector.name === name);
  [canvas.width, canvas.height] = size;
  [canvas.style.width, canvas.style.height] = seen.map((side) => `${side}px`);
  scene = null;
  state.fault = fault(own, size);
  if (own?.optics) link.send({ projector: name, size_px: size });
  if (state.fault !== "") return;
  scene = new Scene(canvas, own, state.hello, link);
  scene.choose(state.show);
}

/** Why nothing can be drawn; empty where it can. */
function fault(own, size) {
  if (own === undefined) return `This run has no projector ${name}: ${state.hello.projectors.map((one) => one.name).join(", ")}`;
  if (own.optics === null) return `The projector ${name} is not calibrated: run robofleet calibrate projector`;
  if (size[0] === own.width && size[1] === own.height) return "";
  const [seen, meant] = [size, [own.width, own.height]].map((sides) => sides.join(" x "));
  return `This page has ${seen} pixels, the projector ${name} has ${meant}: click to make it full-screen, without zoom`;
}

function words(now) {
  if (link.ended !== null) return "The run has ended.";
  const lost = link.lost(now);
  if (lost !== null) return `No link to the run. ${lost.why}`;
  return state.hello === null ? "" : state.fault;
}

function draw(now) {
  requestAnimationFrame(draw);
  periodMs += 0.1 * (Math.min(100, now - lastPicture) - periodMs);
  lastPicture = now;
  const text = words(performance.now());
  if (text !== state.words) document.getElementById("words").textContent = state.words = text;
  canvas.hidden = text !== "";
  if (state.tick !== null && Math.abs(state.tick.seq - drawnSeq) >= ACK_TICKS) link.send({ ack: (drawnSeq = state.tick.seq) });
  if (text !== "" || scene === null) return;
  const { tick } = state;
  const lateMs = tick === null ? 0 : (tick.age_ms ?? 0) + performance.now() - tickAt + SHOWN_PICTURES * periodMs;
  const aheadMs = Math.min(LONGEST_MS, lateMs + 1000 * scene.delay_s);
  state.light_in_s = aheadMs / 1000;
  state.seen = scene.draw(state, aheadMs).map(({ x_m, y_m, psi_rad }) => [x_m, y_m, psi_rad]);
  state.pictures++;
}

addEventListener("resize", begin);
document.addEventListener("click", () => document.documentElement.requestFullscreen());
requestAnimationFrame(draw);
