"""The newest status of every unit: its robots' heartbeat."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.bus import Bus, Inbox, Wake
from robofleet.bus.keys import STATUS
from robofleet.bus.messages import UNIT_STATUS, UnitStatus
from robofleet.core.clock import MS

URGENT_PERIOD_NS = 5 * MS


class UnitPart(NamedTuple):
    """A unit among the robots that somebody looks after."""

    name: str
    size: int  # all robots of the unit
    numbers: NDArray[np.intp]  # (K,) of those that are looked after, in the looker's own order
    rows: "slice | NDArray[np.intp]"  # the same as an index
    places: "slice | NDArray[np.intp]"  # of the same robots in the unit


class Statuses:
    """The newest status of every robot (N,), in an order of one's own; what was overtaken on its way is passed over.

    ``units``: the units by name with their robots; ``robots``: those that one looks after; ``by_radio``: the units
    that tell seldom and are answered soon, ``wake`` is called of their statuses.
    """

    def __init__(
        self, bus: Bus, units: Mapping[str, Sequence[str]], robots: Sequence[str], *,
        by_radio: Collection[str] = (), wake: Wake | None = None,
    ) -> None:  # fmt: skip
        rows = {robot: row for row, robot in enumerate(robots)}
        self.units: list[UnitPart] = []
        for name, members in units.items():
            mine = [(rows[robot], index) for index, robot in enumerate(members) if robot in rows]
            if mine:
                rows_of, places = (np.array(column, np.intp) for column in zip(*mine, strict=True))
                self.units.append(UnitPart(name, len(members), rows_of, _index(rows_of), _index(places)))
        self.by_radio = frozenset(number for number, unit in enumerate(self.units) if unit.name in by_radio)
        wakes = [wake if number in self.by_radio else None for number in range(len(self.units))]
        self._inboxes = [
            Inbox(bus.newest(STATUS, unit.name, woken), UNIT_STATUS.view)
            for unit, woken in zip(self.units, wakes, strict=True)
        ]
        self.newest: list[UnitStatus | None] = [None] * len(self.units)  # without their robots
        self.robots: NDArray[Any] = np.zeros(len(robots), UNIT_STATUS.item_dtype)
        self._whole = np.dtype(f"V{self.robots.dtype.itemsize}")  # an item as its bytes: fields are copied one by one
        self._bytes = self.robots.view(self._whole)
        self.known = np.zeros(len(robots), np.bool_)  # whose status is known
        self.urgent_units: list[int] = []  # by cable, with a bad link: spoken to every URGENT_PERIOD_NS

    def take(self) -> list[int]:
        """Take what came; returns the units, as numbers, of which there is a newer status."""
        newer = []
        for number, (inbox, unit) in enumerate(zip(self._inboxes, self.units, strict=True)):
            message = inbox.take()
            if message is None:
                continue
            (status, items), known = message, self.newest[number]
            if len(items) != unit.size or (known and known.boot_id == status.boot_id and status.nonce <= known.nonce):
                continue
            self.newest[number] = status
            self._bytes[unit.rows] = items.view(self._whole)[unit.places]
            self.known[unit.rows] = True
            newer.append(number)
        if newer:
            self.urgent_units = [
                number
                for number, known in enumerate(self.newest)
                if known is not None and known.hurry and number not in self.by_radio
            ]
        return newer


def _index(numbers: NDArray[np.intp]) -> "slice | NDArray[np.intp]":
    """Return numbers as an index: those that follow each other as a slice, which is several times as fast."""
    first, count = int(numbers[0]), len(numbers)
    return slice(first, first + count) if (numbers == np.arange(first, first + count)).all() else numbers
