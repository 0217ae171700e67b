// Where robots will be when a picture's light falls, as robofleet/projection/prediction.py has it.

const FULL_TURN = 2 * Math.PI;

/** The pose [m, m, rad] of a robot that goes on for some seconds along an exact arc; `speed`: v [m/s], omega [rad/s]. */
export function ahead([x, y, psi], [v, omega], seconds) {
  const half = (omega * seconds) / 2;
  const chord = v * seconds * (half === 0 ? 1 : Math.sin(half) / half);
  const end = psi + 2 * half;
  const turns = Math.ceil((end - Math.PI) / FULL_TURN);
  return [x + chord * Math.cos(psi + half), y + chord * Math.sin(psi + half), end - FULL_TURN * turns];
}

/** v [m/s] and omega [rad/s] of a robot by its wheels' speeds [rad/s]; one whose are not known stands. */
export function bodySpeed({ left_rad_s: left, right_rad_s: right }, { wheel_radius_m: radius, wheel_base_m: base }) {
  if (left === null || right === null) return [0, 0];
  return [(radius * (right + left)) / 2, (radius * (right - left)) / base];
}
