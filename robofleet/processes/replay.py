"""Replay: what every tick of a recorded run consumed goes through today's controller, and what it says is compared.

A record says which poses and which state its tick took; the grid gives the instant. Nothing else reaches what a
controller decides: what the drivers say is about leases, and the commands carry the wheels of the record.

What a controller believes depends on all its ticks. So it is exact from a beginning on, until a record or a message is
missing: its first tick, or one that had taken nothing yet, as after another controller had these robots.
"""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.clock import S, SimulatedClock, stopwatch_ns
from robofleet.comms.bus import MemoryBus
from robofleet.comms.keys import CAMERA, COMMAND, POSES, STATE, TICK, Topic, key
from robofleet.comms.layouts import ListLayout
from robofleet.comms.messages import FLEET_POSES, RUN_STATE, TICK_RECORD, WHEEL_COMMAND
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.processes.controller import Controller
from robofleet.recording.reading import RecordingError
from robofleet.recording.run import Recording

Rows = NDArray[Any]

_HEAD = ("run_tick", "phase", "exposure_ns")  # of a record; its other fields are identities and times
_WHEELS = ("left_rad_s", "right_rad_s")


class Difference(NamedTuple):
    """A figure that came out otherwise."""

    tick: int
    robot: str  # empty where it is the whole fleet's
    column: str
    recorded: float
    now: float

    def __str__(self) -> str:
        """Return it as a line."""
        whose = f"{self.robot}: " if self.robot else ""
        return f"tick {self.tick}: {whose}{self.column}: {self.recorded!r} was recorded, now {self.now!r}"


@dataclass
class Verdict:
    """What a replay found."""

    robots: int
    ticks: int = 0  # compared
    commands: int = 0  # compared
    duration_s: float = 0.0  # of the ticks compared
    elapsed_s: float = 0.0  # that it took
    differences: list[Difference] = field(default_factory=list)
    holes: list[str] = field(default_factory=list)  # what was not compared, a line each


def replay(recording: Recording, tolerance: float | None) -> Verdict:
    """Drive today's controller with what the recorded one took. ``tolerance`` None: bit for bit.

    Raises:
        RecordingError: if there is nothing to replay.
    """
    began_ns = stopwatch_ns()
    ticks = _ticks(recording)
    verdict = Verdict(len(recording.config.platoon))
    commands = _commands(recording)
    for epoch in dict.fromkeys(ticks["epoch"].tolist()):
        rows = ticks[ticks["epoch"] == epoch]
        rows = rows[np.argsort(rows["tick"], kind="stable")]
        wheels = _Stretch(recording, rows, tolerance, verdict).compare()
        own = commands[commands["session"] >> 32 == epoch]
        _compare_commands(recording.config, rows, wheels, own, tolerance, verdict)
    verdict.duration_s = verdict.ticks * recording.config.controller.tick_s
    verdict.elapsed_s = (stopwatch_ns() - began_ns) / S
    return verdict
