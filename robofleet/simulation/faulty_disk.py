"""A disk that can be full, for a robot's stored state, a process's log, and the free space of a recording."""

import errno
import io
import os
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from robofleet.simulation.faults import Schedule

State = TypeVar("State")


class _StateStore(Protocol[State]):
    def load(self, robot: str) -> State: ...

    def save(self, robot: str, kept: State) -> None: ...

    def lose(self, robot: str) -> None: ...


class FaultyStore(Generic[State]):
    """A state store whose disk can be full, so that it takes nothing at all: what is there can only be made invalid."""

    def __init__(self, store: _StateStore[State], schedule: Schedule) -> None:
        self.load, self.lose, self._store, self._schedule = store.load, store.lose, store, schedule

    def save(self, robot: str, kept: State) -> None:
        _refuse_if_full(self._schedule)
        self._store.save(robot, kept)


class FaultyLog(io.TextIOBase):
    """A log on a disk that can be full; where it is not, nobody reads it."""

    def __init__(self, schedule: Schedule) -> None:
        self._schedule = schedule

    def write(self, text: str) -> int:
        _refuse_if_full(self._schedule)
        return len(text)


def free_bytes(free: Callable[[], int], schedule: Schedule) -> Callable[[], int]:
    """Return what tells the room left on a disk: none while it is full."""
    return lambda: 0 if schedule.disk_is_full() else free()


def _refuse_if_full(schedule: Schedule) -> None:
    if schedule.disk_is_full():
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
