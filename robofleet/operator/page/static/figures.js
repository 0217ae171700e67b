// The figures that behaviours tell of their robots: in words, and whose they are.

const [FINE, COARSE] = [10, 1000]; // from here on a digit less is shown, as in the terminal

/** A value in the figure's unit; null is not known. */
export function inWords({ digits }, value) {
  const size = Math.abs(value);
  return value.toFixed(digits - (size >= FINE) - (size >= COARSE));
}

/** A figure's name, as a heading has it. */
export function heading({ title }) {
  return title.charAt(0).toUpperCase() + title.slice(1);
}

/** The colour of what is drawn for each group: where there are several, that of its first robot. */
export function groupColours({ groups, robots }, robotColours, alone) {
  if (groups.length < 2) return groups.map(() => alone);
  return groups.map((group) => robotColours[robots.findIndex(({ id }) => id === group.robots[0])]);
}
