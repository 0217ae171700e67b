"""What the supervisor hears, gathered into one view: the newest of every message, and all news."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.bus import Bus, Inbox, Wake
from robofleet.bus.keys import RECORDER, TICK
from robofleet.bus.messages import RECORDER_STATUS, TICK_RECORD, UNIT_STATUS, RecorderStatus, TickRecord
from robofleet.bus.statuses import Statuses
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.core.kernels import kernel
from robofleet.nodes import camera_reports
from robofleet.nodes.camera_reports import CameraReports
from robofleet.safety.supervisor import MOVING, Event
from robofleet.safety.view import ROBOT, FleetView, Machine, Rows

_FAILURES = np.array([event for event in Event if event.name.startswith(("BEHAVIOUR_", "SCRIPT_"))])


class FleetListener:
    """Listens to the drivers, the controller and the tracker; what came late behind something newer is passed over."""

    def __init__(
        self, config: Config, bus: Bus, wake: Wake, free_bytes: Callable[[], int],
        machine: Callable[[int], Machine | None],
    ) -> None:  # fmt: skip
        robots, driven = config.bodies, len(config.members)
        self._free_bytes, self._machine = free_bytes, machine
        self._daemons, self._build = frozenset(config.daemons), slices.build(config)
        ids = [robot.id for robot in robots]
        self.statuses = Statuses(bus, config.units, ids, by_radio=config.daemons, wake=wake)
        self.newer: list[int] = []  # units, as numbers, of which the newest look found a newer status
        self._ticks = Inbox(bus.newest(TICK), TICK_RECORD.view)
        self._cameras = CameraReports(config, bus)
        self._recorders = Inbox(bus.newest(RECORDER), RECORDER_STATUS.decode)
        self._recorder: RecorderStatus | None = None  # as it said last; lockstep has none
        self._robots = np.zeros(len(robots), ROBOT)
        self._robots["battery"], self._robots["driven"] = -1.0, np.arange(len(robots)) < driven
        self._fleet = FleetView(0, ())

    def look(self, now_ns: int, operator_ns: int) -> FleetView:
        """Return everything that is known now; ``operator_ns`` is the operator's newest sign of life."""
        self.hear_robots(now_ns)
        if (tick := self._ticks.take()) is not None:
            self._take_tick(*tick, now_ns)
        self._fleet, news = self._cameras.look(self._robots, self._fleet, now_ns)
        self._fleet = self._fleet._replace(
            now_ns=now_ns, robots=Rows(self._robots).copied(), news=news, free_bytes=self._room(),
            operator_ns=operator_ns, machine=self._machine(now_ns),
        )  # fmt: skip
        return self._fleet

    def _room(self) -> int:
        """Return the bytes left for the recording; none, where the recorder finds that the disk takes nothing."""
        self._recorder = self._recorders.take() or self._recorder
        return 0 if self._recorder is not None and self._recorder.failed else self._free_bytes()

    def hear_robots(self, now_ns: int) -> None:
        """Take the statuses that came: those of the ``newer`` units."""
        statuses, self.newer = self.statuses, self.statuses.take()
        for unit in self.newer:
            status, part = statuses.newest[unit], statuses.units[unit]
            assert status is not None
            if part.name in self._daemons and status.build != self._build:
                continue  # it has not taken this run's configuration yet
            _take_statuses(self._robots, statuses.robots, part.numbers, now_ns, status.build, np.uint64(status.boot_id))

    def _take_tick(self, record: TickRecord, robots: NDArray[Any], now_ns: int) -> None:
        if record.epoch == self._fleet.controller_epoch and record.tick <= self._fleet.tick:
            return
        self._fleet = self._fleet._replace(
            controller_ns=now_ns, controller_epoch=record.epoch, controller_build=record.build, tick=record.tick,
            overruns=record.overruns, arrived=record.phase * record.arrived,
        )  # fmt: skip
        _take_tick(self._robots, robots, _FAILURES, record.phase in MOVING)


@kernel
def _take_statuses(robots, statuses, rows, now_ns, build, boot_id):  # type: ignore[no-untyped-def]
    for k in rows:
        r, s = robots[k], statuses[k]
        r.heard_ns, r.build, r.boot_id = now_ns, build, boot_id
        r.session, r.latch, r.latch_id, r.faults, r.battery = s.session, s.latch, s.latch_id, s.faults, s.battery
        r.left_angle, r.right_angle, r.left_speed, r.right_speed = (
            s.left_angle_rad, s.right_angle_rad, s.left_rad_s, s.right_rad_s,
        )  # fmt: skip
        r.left_output, r.right_output = s.left_output_rad_s, s.right_output_rad_s
        r.left_told, r.right_told = s.left_told_rad, s.right_told_rad


@kernel
def _take_tick(robots, ticks, failures, moving):  # type: ignore[no-untyped-def]
    for k in range(min(len(robots), len(ticks))):
        r, t = robots[k], ticks[k]
        r.lost, r.filtered, r.blocked = t.lost > 0.0, int(t.filtered), t.blocked > 0.0
        r.failed = 0
        for event in failures:
            if moving and t.failed == event:
                r.failed = event


KERNELS = (_take_statuses, _take_tick, *camera_reports.KERNELS)


def compile_kernels() -> None:
    """Compile, or load from the cache, by messages about one robot."""
    robots = np.zeros(1, ROBOT)
    _take_statuses(robots, np.zeros(1, UNIT_STATUS.item_dtype), np.zeros(0, np.intp), 0, 0, np.uint64(0))
    _take_tick(robots, np.ndarray((0,), TICK_RECORD.item_dtype, b"0"), _FAILURES, True)
    camera_reports.compile_kernels(robots)
