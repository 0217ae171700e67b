// From the floor to the screen, and the colours of the day.

const MARGIN_PX = { left: 32, right: 14, top: 12, bottom: 24 }; // for the scale
const LEAST_RADIUS_PX = 4;
export const COLOURS = ["floor", "grid", "ink", "muted", "accent", "on-accent", "amber", "red", "path"];

export class View {
  #x;
  #y;

  /** A floor of a size [m] in a canvas [CSS px]; `look`: how much larger than whole, and what is in the middle [m];
   *  `drawn`: sizes of what is drawn [CSS px]. */
  constructor([length, depth], width, height, look, drawn) {
    const { left, right, top, bottom } = MARGIN_PX;
    const whole = Math.min((width - left - right) / length, (height - top - bottom) / depth);
    this.scale = whole * look.factor; // [px/m]
    this.#x = (width + left - right) / 2 - look.x_m * this.scale;
    this.#y = (height + top - bottom) / 2 + look.y_m * this.scale;
    [this.width, this.height, this.drawn] = [width, height, drawn];
    this.colour = coloursOfTheDay(COLOURS);
    this.dark = dark.matches;
  }

  x(x_m) {
    return this.#x + x_m * this.scale;
  }

  y(y_m) {
    return this.#y - y_m * this.scale;
  }

  /** The place on the floor [m] under a place on the canvas [CSS px]. */
  floor(x, y) {
    return [(x - this.#x) / this.scale, (this.#y - y) / this.scale];
  }

  /** A robot's radius on the screen; also in a large arena it is seen [px]. */
  radius(robot) {
    return Math.max(robot.body_radius_m * this.scale, LEAST_RADIUS_PX);
  }
}

export const dark = matchMedia("(prefers-color-scheme: dark)");

/** The style sheet's colours by their names. */
export function coloursOfTheDay(names) {
  const style = getComputedStyle(document.documentElement);
  return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
}

const LIGHTER = 0.35; // on a dark ground: of the way to white

/** Each robot's own colour, as the report has it; lighter where the ground is dark. */
export function robotColours(hello, onDark = dark.matches) {
  return hello.robots.map(({ colour }) => {
    if (!onDark) return colour;
    const parts = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
    return `rgb(${parts.map((part) => Math.round(part + LIGHTER * (255 - part))).join()})`;
  });
}
