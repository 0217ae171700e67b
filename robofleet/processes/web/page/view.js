// From the floor to the screen, and the colours of the day.

const MARGIN_PX = { left: 32, right: 14, top: 12, bottom: 24 }; // for the scale
const LEAST_RADIUS_PX = 4;
const COLOURS = ["floor", "grid", "ink", "muted", "accent", "on-accent", "amber", "red", "path"];

export class View {
  #x;
  #y;

  /** A floor of a size [m] in the middle of a canvas [CSS px]. */
  constructor([length, depth], width, height) {
    const { left, right, top, bottom } = MARGIN_PX;
    this.scale = Math.min((width - left - right) / length, (height - top - bottom) / depth); // [px/m]
    this.#x = (width + left - right) / 2;
    this.#y = (height + top - bottom) / 2;
    [this.width, this.height] = [width, height];
    const style = getComputedStyle(document.documentElement);
    this.colour = Object.fromEntries(COLOURS.map((name) => [name, style.getPropertyValue(`--${name}`)]));
  }

  x(x_m) {
    return this.#x + x_m * this.scale;
  }

  y(y_m) {
    return this.#y - y_m * this.scale;
  }

  /** A robot's radius on the screen; also in a large arena it is seen [px]. */
  radius(robot) {
    return Math.max(robot.body_radius_m * this.scale, LEAST_RADIUS_PX);
  }
}
