// What a tick says of each robot, and how bad it is. One place for the words that the arena and the table use.

export const FINE = 0;
export const SLOWED = 1; // the barrier changes its command
export const HALTED = 2; // it alone stands still
export const LOST = 3; // no image of it for too long
export const LATCHED = 4; // somebody must look at it

/** The robots of a tick: one object each, with its values by the names of the columns, `trouble` and `words`. */
export function robotsOf(hello, tick) {
  return tick.robots.map((values, row) => {
    const robot = { ...hello.robots[row], row };
    hello.columns.forEach((column, k) => (robot[column] = values[k]));
    [robot.trouble, robot.words] = assess(robot, hello.words);
    robot.place = hello.places[tick.way]?.[row] ?? null; // where it goes: x, y, psi
    if (robot.trouble === FINE && robot.to_go_m !== null) robot.words = onTheWay(robot, hello.ways[tick.way]);
    if (robot.reality === "simulated") robot.words += " (in no image: simulated)";
    return robot;
  });
}

function onTheWay({ gate, to_go_m: left }, way) {
  if (left === 0) return way.arrived;
  return `${gate === "open" ? "" : "stands, "}${left.toFixed(2)} m to ${way.goal}`;
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
