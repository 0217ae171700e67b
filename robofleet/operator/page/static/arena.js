// The arena from above. What the newest tick says is drawn as it is: nothing is made up between two ticks.

import { drawFloor } from "./floor.js";
import { Labels } from "./labels.js";
import { Look } from "./look.js";
import { Trails, drawAims, drawPlaces, drawRings } from "./motion.js";
import { FINE, HALTED, LATCHED, LOST, SLOWED } from "./robots.js";
import { arrow, circle, line } from "./shapes.js";
import { View, dark, robotColours } from "./view.js";

export class Arena {
  #floor = document.getElementById("arena-floor");
  #top = document.getElementById("arena-robots");
  #stage = document.getElementById("arena-stage");
  #hello = null;
  #tick = null;
  #trails = null;
  #labels = new Labels();
  #view = null;
  #colours = [];
  #turning = false; // a picture of another part of the arena is to be drawn
  #look = new Look(() => this.#view, () => this.#turn());

  constructor() {
    new ResizeObserver(() => this.#resize()).observe(this.#stage);
    dark.addEventListener("change", () => this.#resize());
    matchMedia("(resolution: 1dppx)").addEventListener("change", () => this.#resize());
  }

  /** Take what does not change in a run. */
  begin(hello) {
    this.#hello = hello;
    document.body.classList.remove("aims");
    this.#trails = new Trails(hello.drawn);
    const [width, height] = hello.arena.size_m;
    this.#stage.style.aspectRatio = `${width} / ${height}`;
    this.#look.begin(hello.arena.size_m);
    this.#resize();
  }

  /** Draw again what is on the floor. */
  redraw() {
    this.#see();
  }

  /** Draw a tick; while nobody tells any robot's place the last ones stay. */
  draw(robots) {
    if (this.#tick && robots.every((robot) => robot.x_m === null)) return;
    this.#tick = robots;
    if (robots.some((robot) => robot.reference_x_m !== null)) document.body.classList.add("aims");
    this.#trails.take(robots);
    this.#drawRobots();
  }

  /** Where a place [m] is on the stage [CSS px]. */
  place(x_m, y_m) {
    return [this.#view.x(x_m), this.#view.y(y_m)];
  }

  // However many events of a wheel or a finger come: one picture a refresh of the screen.
  #turn() {
    if (this.#turning) return;
    this.#turning = true;
    requestAnimationFrame(() => {
      this.#turning = false;
      this.#see();
    });
  }

  #resize() {
    if (this.#hello === null) return;
    const { clientWidth: width, clientHeight: height } = this.#stage;
    for (const canvas of [this.#floor, this.#top]) {
      canvas.width = Math.round(width * devicePixelRatio);
      canvas.height = Math.round(height * devicePixelRatio);
      canvas.getContext("2d").setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    }
    this.#colours = robotColours(this.#hello);
    this.#see();
  }

  #see() {
    if (this.#hello === null) return;
    const { clientWidth: width, clientHeight: height } = this.#stage;
    this.#view = new View(this.#hello.arena.size_m, width, height, this.#look.now, this.#hello.drawn);
    drawFloor(this.#floor.getContext("2d"), this.#view, this.#hello);
    if (this.#tick) this.#drawRobots();
  }

  #drawRobots() {
    const [g, view] = [this.#top.getContext("2d"), this.#view];
    const seen = this.#tick.filter((robot) => robot.x_m !== null);
    g.clearRect(0, 0, view.width, view.height);
    this.#trails.draw(g, view, this.#colours);
    drawPlaces(g, view, seen, this.#colours);
    drawAims(g, view, seen);
    drawBodies(g, view, seen, this.#colours);
    this.#labels.draw(g, view, seen);
  }
}

// Each kind of trouble has a shape of its own: colour alone tells nothing. A robot without trouble has its own colour.
function drawBodies(g, view, robots, own) {
  const { accent, muted, amber, red } = view.colour;
  const colours = { [FINE]: muted, [SLOWED]: accent, [HALTED]: amber, [LOST]: amber, [LATCHED]: red };
  for (const trouble of [FINE, SLOWED, HALTED, LOST, LATCHED]) {
    const some = robots.filter((robot) => robot.trouble === trouble);
    if (some.length === 0) continue;
    g.strokeStyle = g.fillStyle = colours[trouble];
    drawRings(g, view, some, trouble);
    if (trouble <= SLOWED) drawOwn(g, view, some, own);
    const bodies = new Path2D();
    for (const robot of some) circle(bodies, view.x(robot.x_m), view.y(robot.y_m), view.radius(robot));
    g.lineWidth = trouble === FINE ? 1 : 2.5;
    g.setLineDash(trouble === LOST ? [5, 4] : []);
    if (trouble === LOST) g.fillStyle = view.colour.floor;
    if (trouble > SLOWED) g.fill(bodies);
    if (trouble > FINE) g.stroke(bodies);
    g.setLineDash([]);
    g.strokeStyle = g.fillStyle = trouble === LOST ? amber : view.colour["on-accent"];
    drawMarks(g, view, some, trouble);
  }
}

function drawOwn(g, view, robots, own) {
  for (const robot of robots) {
    g.fillStyle = own[robot.row];
    g.beginPath();
    circle(g, view.x(robot.x_m), view.y(robot.y_m), view.radius(robot));
    g.fill();
  }
}

// Heading, or what stopped it: a cross for a latch, two bars for a halt.
function drawMarks(g, view, robots, trouble) {
  const [arrows, bars] = [new Path2D(), new Path2D()];
  for (const robot of robots) {
    const [x, y, r, psi] = [view.x(robot.x_m), view.y(robot.y_m), view.radius(robot), robot.psi_rad];
    if (trouble === LATCHED) {
      line(bars, x - r / 2, y - r / 2, x + r / 2, y + r / 2);
      line(bars, x - r / 2, y + r / 2, x + r / 2, y - r / 2);
    } else if (trouble === HALTED) {
      line(bars, x - r / 3, y - r / 2, x - r / 3, y + r / 2);
      line(bars, x + r / 3, y - r / 2, x + r / 3, y + r / 2);
    } else {
      arrow(arrows, x + 0.15 * r * Math.cos(psi), y - 0.15 * r * Math.sin(psi), psi, 0.6 * r);
    }
  }
  g.lineWidth = Math.max(2, view.radius(robots[0]) / 5);
  g.fill(arrows);
  g.stroke(bars);
}
