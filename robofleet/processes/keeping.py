"""What a driver must remember when it is started again: the epoch of its lease, and what latched its gate."""

import errno
import json
import os
import sys
from pathlib import Path
from typing import NamedTuple, Protocol

from robofleet.safety.gate import GateState, Latch
from robofleet.simulation.faults import Schedule

_MOST = 1 << 31  # of what the wire carries in 32 bits: so many leases or latches nobody lives to see


class Kept(NamedTuple):
    """One robot's memory."""

    epoch: int = 0
    latch: Latch = Latch.NONE
    latch_id: int = 0


class Keeping(Protocol):
    """Where it is kept."""

    def load(self, robot: str) -> Kept:
        """Return what was kept, or what a new robot starts with; what cannot be read latches. Raises nothing."""

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
        file = self._file(robot)
        try:
            return _checked(json.loads(file.read_text()))
        except FileNotFoundError:
            return Kept()
        except (OSError, ValueError, KeyError, TypeError) as error:
            print(f"{robot}: {file}: cannot be read ({error!r}): look at the robot, then reset", file=sys.stderr)
            return Kept(0, Latch.MEMORY_LOST, 1)

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
        folder = os.open(file.parent, os.O_RDONLY)  # the new name is not on disk before its folder is
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

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


def _checked(found: dict[str, int]) -> Kept:
    """Return what a file says; ValueError, KeyError or TypeError if nobody can have written that."""
    epoch, latch, latch_id = found["epoch"], Latch(found["latch"]), found["latch_id"]
    if type(epoch) is not int or type(latch_id) is not int or not 0 <= epoch < _MOST or not 0 <= latch_id < _MOST:
        raise ValueError(f"epoch {epoch!r}, latch_id {latch_id!r}")
    if latch and not latch_id:
        raise ValueError("a latch without its number")
    return Kept(epoch, latch, latch_id)


def kept(state: GateState) -> Kept:
    """Return what of a gate's state must be kept: a drill is forgotten."""
    latch = Latch.NONE if state.latch is Latch.DRILL else state.latch
    return Kept(state.epoch, latch, state.latch_id)
