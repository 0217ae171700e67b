"""Teleoperation: drive the robots with the keyboard. The barrier keeps them apart, and inside the arena.

w, s: faster, slower.  a, d: turn left, right.  space: all stand.  1, 2, ...: another robot.  q: leave.
A robot goes on as it was told until it is told something else.

Start it with: python configs/examples/teleop.py --real-time
"""

import os
import select
import sys
import termios
import tty
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from robofleet import Fleet

CONFIG = Path(__file__).parents[1] / "script.yaml"
STEPS = {"w": (0.02, 0.0), "s": (-0.02, 0.0), "a": (0.0, 0.3), "d": (0.0, -0.3)}  # v [m/s], omega [rad/s]
LIMIT = np.array([0.16, 2.4])


def keyboard() -> Iterator[str]:
    """Yield the key pressed now, or "", until q; the terminal is given back as it was."""
    before = termios.tcgetattr(0)
    tty.setcbreak(0)
    try:
        while (key := os.read(0, 1).decode("ascii", "ignore") if select.select([0], [], [], 0)[0] else "") != "q":
            yield key
    finally:
        termios.tcsetattr(0, termios.TCSADRAIN, before)


def teleoperate(fleet: Fleet, keys: Iterable[str]) -> None:
    """Drive by one key a tick, as long as there are keys."""
    command, chosen = np.zeros((len(fleet.robots), 2)), 0
    for key, _ in zip(keys, fleet.ticks(), strict=False):
        if key in STEPS:
            command[chosen] = np.clip(command[chosen] + STEPS[key], -LIMIT, LIMIT)
        elif key == " ":
            command[:] = 0.0
        elif key.isdecimal() and 1 <= int(key) <= len(command):
            chosen = int(key) - 1
        fleet.drive(command)


if __name__ == "__main__":
    with Fleet.from_arguments(CONFIG) as fleet:
        print(__doc__)
        teleoperate(fleet, keyboard() if sys.stdin.isatty() else sys.stdin.read())
