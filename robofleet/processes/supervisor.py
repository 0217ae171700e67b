"""The supervisor: it owns the run's state and says every 40 ms to every driver whether its wheels may move."""

import numpy as np

from robofleet.clock import MS, Clock, S
from robofleet.comms.bus import Bus, Inbox
from robofleet.comms.keys import ENABLE, REQUEST, STATE, TICK
from robofleet.comms.messages import ENABLE as ENABLE_LAYOUT
from robofleet.comms.messages import (
    RUN_STATE,
    TICK_RECORD,
    Enable,
    RobotState,
    RunState,
    TickRecord,
)
from robofleet.comms.statuses import HURRY_NS, Statuses
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.safety import supervisor
from robofleet.safety.arming import Stage
from robofleet.safety.gate import Latch
from robofleet.safety.supervisor import NOBODY, Event, Happening, Phase, RunStatus

_PERIOD_NS = 40 * MS
_SILENT_NS = S // 2
_LOST_NS = 2 * S

_REQUESTS = {
    b"start": Event.START_REQUESTED,
    b"stop": Event.STOP_REQUESTED,
    b"hold": Event.HOLD_REQUESTED,
    b"resume": Event.RESUME_REQUESTED,
    b"estop": Event.ESTOP_REQUESTED,
}


class Supervisor:
    """Requests of the operator and the fleet's health drive one transition table."""

    def __init__(self, config: Config, bus: Bus, clock: Clock, rng: np.random.Generator) -> None:
        robots = config.platoon
        self._epoch = slices.drawn_id(rng, 32)
        self._limits = [robot.vehicle.max_wheel_speed_rad_s for robot in robots]
        now_ns = clock.now_ns()
        self._statuses = Statuses(bus, [robot.id for robot in robots])
        self._ticks = Inbox(bus.newest(TICK), TICK_RECORD)
        self._enables = [bus.publisher(ENABLE, robot.id) for robot in robots]
        self._publish_state = bus.publisher(STATE)
        self._request = bus.serve(REQUEST, "supervisor")
        self._status = RunStatus()
        self._heard_ns = [0] * len(robots)
        self._seen_ns = [now_ns] * len(robots)
        self._tick: TickRecord | None = None
        self._tick_ns = 0
        self._next_ns = now_ns
        self._seq = 0

    def step(self, now_ns: int) -> int:
        """Listen, decide, and publish when due or when the state changed."""
        before = self._status
        self._listen(now_ns)
        for event, robot in self._events(now_ns):
            self._status = supervisor.step(self._status, Happening(event, robot))
        if now_ns >= self._next_ns or self._status != before:
            self._publish()
        else:
            for row in self._statuses.hurried():
                self._enable(row)
        if now_ns >= self._next_ns:
            self._next_ns += _PERIOD_NS * (1 + (now_ns - self._next_ns) // _PERIOD_NS)
        return min(self._next_ns, now_ns + HURRY_NS) if self._statuses.hurried() else self._next_ns

    def close(self) -> None:
        """Nothing to bring to rest: the gates close when enables cease."""

    def _listen(self, now_ns: int) -> None:
        for row in self._statuses.take():
            self._heard_ns[row] = now_ns
        if (record := self._ticks.take()) is not None:
            self._tick, self._tick_ns = record, now_ns
            for row, robot in enumerate(record.robots[: len(self._seen_ns)]):
                if not robot.lost:
                    self._seen_ns[row] = now_ns

    def _events(self, now_ns: int) -> list[tuple[Event, int]]:
        events = []
        while (request := self._request()) is not None:
            event = _REQUESTS.get(request.payload)
            request.reply(b"ok" if event is not None else b"unknown request " + request.payload)
            if event is not None:
                events.append((event, NOBODY))
        silent = [row for row, heard in enumerate(self._heard_ns) if now_ns - heard > _SILENT_NS]
        lost = [row for row, seen in enumerate(self._seen_ns) if now_ns - seen > _LOST_NS]
        controlled = self._tick is not None and now_ns - self._tick_ns <= _SILENT_NS
        if not controlled:
            events.append((Event.CONTROLLER_SILENT, NOBODY))
        events += [(Event.DRIVER_SILENT, row) for row in silent]
        events += [(Event.TAG_LOST, row) for row in lost]
        if self._tick is not None and controlled and not silent and not any(r.lost for r in self._tick.robots):
            events.append((Event.PROVED, NOBODY))
        return events

    def _publish(self) -> None:
        self._seq += 1
        phase, cause, robot, detail = self._status
        running = phase is Phase.RUNNING
        robots = tuple(RobotState(int(running), 0, Event.NOTHING) for _ in self._limits)
        state = RunState(self._epoch, self._seq, phase, cause, robot, detail, Stage.CHECKS, NOBODY, 0, robots)
        self._publish_state(RUN_STATE.encode(state))
        for row in range(len(self._limits)):
            self._enable(row)

    def _enable(self, row: int) -> None:
        status, phase = self._statuses.newest[row], self._status.phase
        if status is not None:
            self._seq += 1
            latch = Latch.EMERGENCY_STOP if phase is Phase.ESTOP else Latch.NONE
            limit = self._limits[row] if phase is Phase.RUNNING else 0.0
            enable = Enable(status.epoch, self._seq, status.boot_id, status.nonce, phase, latch, 0, limit)
            self._enables[row](ENABLE_LAYOUT.encode(enable))
