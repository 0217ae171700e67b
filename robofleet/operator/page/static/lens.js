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
    const { T_projector_world: rows, focal_px: focal, centre_px: centre, distortion: d } = this.#optics;
    const along = (row) => row[0] * x + row[1] * y + row[2] * z + row[3];
    const Z = Math.max(along(rows[2]), NEAR_M);
    let [a, b] = [along(rows[0]) / Z, along(rows[1]) / Z];
    if (this.#isNear(focal[0] * a + centre[0], focal[1] * b + centre[1])) {
      const r2 = a * a + b * b;
      const radial = 1 + d[0] * r2 + d[1] * r2 * r2;
      [a, b] = [
        a * radial + 2 * d[2] * a * b + d[3] * (r2 + 2 * a * a),
        b * radial + d[2] * (r2 + 2 * b * b) + 2 * d[3] * a * b,
      ];
    }
    return [focal[0] * a + centre[0] + 0.5, focal[1] * b + centre[1] + 0.5];
  }

  // Far outside the picture a lens's coefficients mean nothing, and may bring a pixel back into it.
  #isNear(u, v) {
    return Math.abs(u / this.#size[0] - 0.5) < 1 && Math.abs(v / this.#size[1] - 0.5) < 1;
  }
}
