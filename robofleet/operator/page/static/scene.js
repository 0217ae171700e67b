// A run as it lies on the floor: what stands still is drawn once, what moves with each picture.

import { drawGrid, drawObstacles, drawShapes } from "./floor.js";
import { Labels } from "./labels.js";
import { Lens } from "./lens.js";
import { Trails, drawAims, drawPlaces, drawRings } from "./motion.js";
import { PHASES } from "./phases.js";
import { ahead, bodySpeed } from "./prediction.js";
import { FINE, HALTED, LATCHED, LOST, SLOWED } from "./robots.js";
import { arrow, circle } from "./shapes.js";
import { COLOURS, coloursOfTheDay, robotColours } from "./view.js";
import { Warp } from "./warp.js";

const UNSEEN_MS = 1000; // then a robot stands that is not seen

export class Scene {
  #canvas;
  #still = new OffscreenCanvas(1, 1); // the picture without what moves
  #projector;
  #hello;
  #colours;
  #background = null;
  #veil = null; // black, the more opaque the more light other projectors give
  #show = new Set();
  #trails;
  #labels = new Labels(({ id, words }) => `${id}: ${words}`);
  #takenAt = 0; // when the newest tick came
  #measuredAt = []; // when the newest tick came that measured each robot
  #view = null;
  #warp = null;

  constructor(canvas, projector, hello, link) {
    [this.#canvas, this.#projector, this.#hello] = [canvas, projector, hello];
    this.lens = new Lens(projector);
    this.delay_s = projector.optics.delay_s;
    this.#colours = robotColours(hello, true);
    this.#trails = new Trails(hello.drawn);
    canvas.style.opacity = projector.brightness;
    if (hello.background) this.#load(link, "background", (image) => (this.#background = image));
    if (hello.projectors.filter(({ optics }) => optics !== null).length > 1) {
      this.#load(link, `veil/${encodeURIComponent(projector.name)}`, (image) => (this.#veil = image));
    }
  }

  /** Show these things. */
  choose(show) {
    this.#show = new Set(show);
    const [[length, depth], drawn] = [this.#hello.arena.size_m, this.#hello.drawn];
    const scale = drawn[this.#show.has("large") ? "large_units" : "units"] / length; // [units/m]
    this.#view = {
      scale,
      drawn,
      width: length * scale,
      height: depth * scale,
      colour: coloursOfTheDay(COLOURS),
      dark: true,
      x: (x_m) => (x_m + length / 2) * scale,
      y: (y_m) => (depth / 2 - y_m) * scale,
      radius: (robot) => robot.disc_m * scale + drawn.bold_halo + drawn.arrow,
    };
    this.redraw();
  }

  redraw() {
    const { width, height } = this.#canvas;
    [this.#still.width, this.#still.height] = [width, height];
    const [g, view, hello] = [this.#on(this.#still), this.#view, this.#hello];
    if (view === null) return;
    if (this.#show.has("background") && this.#background !== null) {
      g.drawImage(this.#background, 0, 0, view.width, view.height);
    }
    if (this.#show.has("grid")) drawGrid(g, view, hello.arena.size_m);
    if (this.#show.has("floor")) {
      g.strokeStyle = view.colour.muted;
      g.lineWidth = view.drawn.edge;
      g.strokeRect(0, 0, view.width, view.height);
      drawObstacles(g, view, hello.arena);
    }
    if (this.#show.has("paths")) drawShapes(g, view, hello);
    this.#warp = this.#on(this.#canvas);
    const all = this.#canvas.getContext("2d", { alpha: false });
    all.drawImage(this.#still, 0, 0);
    if (this.#veil !== null) all.drawImage(this.#veil, 0, 0);
  }

  /** Take a tick's robots. */
  take(robots) {
    this.#takenAt = performance.now();
    this.#trails.take(robots);
    for (const { row, measured } of robots) if (measured !== 0) this.#measuredAt[row] = this.#takenAt;
  }

  /** Draw a tick, its robots as they will be in some time; returns these. */
  draw({ tick, robots, rates }, aheadMs) {
    const [g, view, show] = [this.#warp, this.#view, this.#show];
    if (g === null) return [];
    g.clear(this.#still);
    if (tick === null) return [];
    const seen = robots.filter((robot) => robot.x_m !== null).map((robot) => this.#then(robot, rates[robot.row] ?? [0, 0], aheadMs));
    if (show.has("trails")) this.#trails.draw(g, view, this.#colours);
    if (show.has("references")) {
      drawPlaces(g, view, seen, this.#colours);
      drawAims(g, view, seen);
    }
    if (show.has("barrier")) {
      g.strokeStyle = view.colour.muted;
      drawRings(g, view, seen, FINE);
    }
    if (show.has("halos")) this.#drawHalos(seen);
    const clock = show.has("countdown") ? [this.#countDown(tick)] : [];
    if (show.has("names")) this.#labels.draw(g, view, seen, clock);
    const gray = Math.round(255 * Math.min(1, this.#projector.disc_gray / this.#projector.brightness));
    g.fillStyle = `rgb(${gray},${gray},${gray})`;
    for (const robot of seen) {
      g.fillCylinder(view.x(robot.x_m), view.y(robot.y_m), robot.disc_m * view.scale, robot.tag_height_m);
    }
    if (this.#veil !== null) g.cover(this.#veil);
    return seen;
  }

  #on(canvas) {
    const { scale, width, height } = this.#view ?? { scale: 1, width: 0, height: 0 };
    const pixel = (u, v, z_m = 0) => this.lens.pixel((u - width / 2) / scale, (height / 2 - v) / scale, z_m);
    const [[x, y], [x1, y1]] = [this.lens.pixel(0, 0), this.lens.pixel(1 / scale, 0)];
    return new Warp(canvas.getContext("2d", { alpha: false }), pixel, Math.hypot(x1 - x, y1 - y));
  }

  /** A robot in some time. One that was not seen of late may have gone anywhere meanwhile: its disc is larger. */
  #then(robot, rate, ms) {
    const lit = this.#hello.lit[robot.row];
    const [x_m, y_m, psi_rad] = ahead([robot.x_m, robot.y_m, robot.psi_rad], bodySpeed(robot, lit), ms / 1000);
    const turn = psi_rad - robot.psi_rad;
    const [px, py] = [robot.point_x_m - robot.x_m, robot.point_y_m - robot.y_m];
    const unseenMs = Math.min(UNSEEN_MS, this.#takenAt - (this.#measuredAt[robot.row] ?? this.#takenAt));
    const moved = (value, change) => (value === null ? null : value + change);
    return {
      ...robot,
      x_m,
      y_m,
      psi_rad,
      point_x_m: robot.point_x_m === null ? null : x_m + px * Math.cos(turn) - py * Math.sin(turn),
      point_y_m: robot.point_y_m === null ? null : y_m + px * Math.sin(turn) + py * Math.cos(turn),
      reference_x_m: moved(robot.reference_x_m, rate[0] * ms),
      reference_y_m: moved(robot.reference_y_m, rate[1] * ms),
      disc_m: lit.disc_radius_m + (robot.driven ? (lit.max_speed_m_s * unseenMs) / 1000 : 0),
      tag_height_m: lit.tag_height_m,
    };
  }

  // A ring, and where it heads. What is wrong with a robot has a bolder ring; beside it stands what it is. A whole ring is
  // what is left of a filled circle around the disc, which is drawn on it.
  #drawHalos(robots) {
    const [g, view] = [this.#warp, this.#view];
    const { accent, amber, red } = view.colour;
    const drawn = view.drawn;
    const colours = { [SLOWED]: accent, [HALTED]: amber, [LOST]: amber, [LATCHED]: red };
    for (const robot of robots) {
      const bold = robot.trouble >= HALTED ? drawn.bold_halo : drawn.halo;
      const [x, y, psi] = [view.x(robot.x_m), view.y(robot.y_m), robot.psi_rad];
      const r = robot.disc_m * view.scale + bold / 2;
      g.strokeStyle = g.fillStyle = colours[robot.trouble] ?? this.#colours[robot.row];
      g.lineWidth = bold;
      g.beginPath();
      if (robot.trouble === LOST) {
        g.setLineDash([8, 8]);
        circle(g, x, y, r);
        g.stroke();
        g.setLineDash([]);
      } else {
        circle(g, x, y, r + bold / 2);
        g.fill();
      }
      g.beginPath();
      arrow(g, x + (r + drawn.arrow) * Math.cos(psi), y - (r + drawn.arrow) * Math.sin(psi), psi, drawn.arrow);
      g.fill();
    }
  }

  // Returns the box around it: middle, half of its width, half of its height.
  #countDown({ phase, t_s: t }) {
    const [g, { colour }] = [this.#warp, this.#view];
    const left = Math.max(0, Math.ceil(this.#hello.duration_s - (t ?? 0)));
    const clock = `${Math.floor(left / 60)}:${`${left % 60}`.padStart(2, "0")} left`;
    g.font = "600 26px system-ui, sans-serif";
    g.textAlign = "left";
    g.textBaseline = "top";
    g.strokeStyle = colour.floor;
    g.fillStyle = colour.ink;
    g.lineWidth = 4;
    const words = phase === "running" ? clock : (PHASES[phase] ?? phase);
    g.strokeText(words, 12, 10);
    g.fillText(words, 12, 10);
    const half = g.measureText(words).width / 2;
    return [12 + half, 23, half, 13];
  }

  async #load(link, path, take) {
    const image = new Image();
    image.src = link.address(`projector/${path}`);
    try {
      await image.decode();
    } catch {
      return; // `robofleet project` has said that it is no image
    }
    take(image);
    this.redraw();
  }
}
