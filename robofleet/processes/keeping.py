"""What a driver must remember when it is started again: the epoch of its lease, and what latched its gate."""

import errno
import json
import os
from pathlib import Path
from typing import NamedTuple, Protocol

from robofleet.safety.gate import GateState, Latch
from robofleet.simulation.faults import Schedule


class Kept(NamedTuple):
    """One robot's memory."""

    epoch: int = 0
    latch: Latch = Latch.NONE
    latch_id: int = 0


class Keeping(Protocol):
    """Where it is kept."""

    def load(self, robot: str) -> Kept:
        """Return what was kept, or what a new robot starts with."""

    def save(self, robot: str, kept: Kept) -> None:
        """Keep it; it is there, whatever happens next, when this returns. OSError where that cannot be."""


class MemoryKeeping:
    """Lockstep's: nothing outlives the run."""

    def __init__(self) -> None:
        self._kept: dict[str, Kept] = {}

    def load(self, robot: str) -> Kept:
        """Return what was kept."""
        return self._kept.get(robot, Kept())

    def save(self, robot: str, kept: Kept) -> None:
        """Keep it."""
        self._kept[robot] = kept


class FileKeeping:
    """One small file a robot, in the user's state folder, replaced at once."""

    def __init__(self, arena: str) -> None:
        state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
        self._folder = Path(state) / "robofleet" / arena

    def load(self, robot: str) -> Kept:
        """Return what was kept; a file that cannot be read latches the robot: nobody knows what was before."""
        try:
            found = json.loads(self._file(robot).read_text())
            return Kept(int(found["epoch"]), Latch(found["latch"]), int(found["latch_id"]))
        except FileNotFoundError:
            return Kept()

    def save(self, robot: str, kept: Kept) -> None:
        """Write it beside, then in its place."""
        file = self._file(robot)
        file.parent.mkdir(parents=True, exist_ok=True)
        beside = file.with_suffix(".new")
        with beside.open("w") as stream:
            json.dump(kept._asdict(), stream)
            stream.flush()
            os.fsync(stream.fileno())
        beside.replace(file)

    def _file(self, robot: str) -> Path:
        return self._folder / f"{robot}.json"


class FaultyKeeping:
    """A keeping whose disk can be full."""

    def __init__(self, keeping: Keeping, faults: Schedule) -> None:
        self.load, self._keeping, self._faults = keeping.load, keeping, faults

    def save(self, robot: str, kept: Kept) -> None:
        """Keep it, if the disk takes it."""
        if self._faults.disk_is_full():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._keeping.save(robot, kept)


def kept(state: GateState) -> Kept:
    """Return what of a gate's state must be kept: a drill is forgotten."""
    latch = Latch.NONE if state.latch is Latch.DRILL else state.latch
    return Kept(state.epoch, latch, state.latch_id)
