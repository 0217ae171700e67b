// What a tick says of each robot, and how bad it is. One place for the words that the arena and the table use.

export const FINE = 0;
export const SLOWED = 1; // the barrier changes its command
export const HALTED = 2; // it alone stands still
export const LOST = 3; // no image of it for too long
export const LATCHED = 4; // somebody must look at it

/** The robots of a tick: one object each, with its values by the names of the columns, `trouble` and `words`. `ended`:
 *  how the run did, once it has. */
export function robotsOf(hello, tick, ended = null) {
  return tick.robots.map((values, row) => {
    const robot = { ...hello.robots[row], row };
    hello.columns.forEach((column, k) => (robot[column] = values[k]));
    if (ended !== null) end(robot, ended);
    const starts = tick.start_share !== null || tick.phase === "starting";
    [robot.trouble, robot.words] = (starts && begins(robot, hello.words)) || assess(robot, hello.words);
    if (ended !== null && robot.trouble === FINE) robot.words = "ended";
    robot.place = hello.places[tick.way]?.[row] ?? null; // where it goes: x, y, psi
    if (robot.trouble === FINE && robot.to_go_m !== null) robot.words = onTheWay(robot, hello.ways[tick.way]);
    if (robot.reality === "simulated") robot.words += " (in no image: simulated)";
    return robot;
  });
}

/** Forget what a robot said of its motion: nobody hears it any more. Only its latch is known. */
function end(robot, { latched }) {
  if (latched !== null) robot.latch = latched.includes(robot.id) ? (robot.latch ?? "stored") : null;
  Object.assign(robot, { lost: 0, halted: null, gate: "ended", filtered: 0, to_go_m: null });
  Object.assign(robot, { left_rad_s: null, right_rad_s: null, age_ms: null });
}

function onTheWay({ gate, to_go_m: left }, way) {
  if (left === 0) return way.arrived;
  return `${gate === "open" ? "" : "stands, "}${left.toFixed(2)} m to ${way.goal}`;
}

/** What of a robot has not begun yet, or is tried, while the run starts: nothing is wrong with that. */
function begins({ driven, latch, lost, gate, x_m: x }, words) {
  if (driven && latch === "drill") return [FINE, words.drill];
  return driven && (gate === null || (lost && x === null)) ? [FINE, words.starting] : null;
}

function assess({ driven, latch, lost, halted, gate, filtered }, words) {
  if (latch && latch !== "none") return [LATCHED, words.latched.replace("{}", latch)];
  if (lost) return [LOST, words.lost];
  if (halted) return [HALTED, words.halted.replace("{}", halted)];
  if (!driven) return [FINE, words.parked];
  if (gate === null) return [HALTED, words.silent];
  if (filtered > 1) return [HALTED, words.unsafe];
  if (filtered) return [SLOWED, words.kept_apart];
  return [FINE, gate === "open" ? words.drives : words.stands];
}
