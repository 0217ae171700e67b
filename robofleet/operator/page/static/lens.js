// Where a projector's light falls: the camera model of OpenCV, as robofleet/projection/model.py has it.

const NEAR_M = 1e-3;

export class Lens {
  #optics;
  #size;

  constructor({ optics, width, height }) {
    this.#optics = optics;
    this.#size = [width, height];
  }

  /** The place in the picture [px; the first pixel's corner is 0] whose light falls on a point [m; world]. */
  pixel(x, y, z = 0) {
    const { T_projector_world: rows, focal_px: focal, centre_px: centre, distortion } = this.#optics;
    const [X, Y, Z] = rows.map(([a, b, c, t]) => a * x + b * y + c * z + t);
    const [a, b] = [X / Math.max(Z, NEAR_M), Y / Math.max(Z, NEAR_M)];
    const bent = this.#isNear(focal[0] * a + centre[0], focal[1] * b + centre[1]) ? bend(a, b, distortion) : [a, b];
    return [focal[0] * bent[0] + centre[0] + 0.5, focal[1] * bent[1] + centre[1] + 0.5];
  }

  // Far outside the picture a lens's coefficients mean nothing, and may bring a pixel back into it.
  #isNear(u, v) {
    return Math.abs(u / this.#size[0] - 0.5) < 1 && Math.abs(v / this.#size[1] - 0.5) < 1;
  }
}

function bend(a, b, [k1, k2, p1, p2]) {
  const r2 = a * a + b * b;
  const radial = 1 + k1 * r2 + k2 * r2 * r2;
  return [a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a), b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b];
}
