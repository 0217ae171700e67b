"""The supervisor's step alone: who may start a run, what ends one, and who is told."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from robofleet.clock import MS, S
from robofleet.comms.keys import ENABLE, STATE, STATUS, TICK
from robofleet.comms.messages import RobotStatus, RobotTick, RunState, TickRecord
from robofleet.processes.supervisor import Supervisor
from robofleet.safety.supervisor import NOBODY, Event, Phase, RunStatus

Make = Callable[..., Any]
ROBOTS = ("r1", "r2", "r3", "r4")
BOOT = {robot: 100 + row for row, robot in enumerate(ROBOTS)}


class Asked:
    """A request, and its answer."""

    def __init__(self, text: str) -> None:
        self.text, self.answer = text, ""

    def reply(self, text: str) -> None:
        self.answer = text


class Stand:
    """A supervisor; drivers and a controller that talk unless they are silenced, robots that are seen unless lost."""

    def __init__(self, bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
        self.bench = bench
        self.requests: list[Asked] = []
        self.silent: set[str] = set()
        self.lost: set[str] = set()
        self.nonces: dict[str, int] = {}
        monkeypatch.setattr(bench.bus, "serve", lambda _: lambda: self.requests.pop(0) if self.requests else None)
        self.node = Supervisor(bench.config, bench.bus, bench.clock)

    def run(self, ns: int) -> None:
        self.bench.run(self.node, ns, (20 * MS, self._statuses), (33 * MS, self._tick))

    def ask(self, text: str) -> Asked:
        """Ask, and let a step answer."""
        asked = Asked(text)
        self.requests.append(asked)
        self.node.step(self.bench.now_ns)
        return asked

    @property
    def state(self) -> RunState:
        newest: RunState = self.bench.heard(STATE)[-1]
        return newest

    def running(self) -> None:
        self.run(S // 5)
        self.ask("start")
        self.run(S // 5)
        assert self.state.phase == Phase.RUNNING

    def _statuses(self) -> None:
        for robot in ROBOTS:
            if robot not in self.silent:
                now_ns = self.nonces[robot] = self.bench.now_ns
                status = RobotStatus(1, 1, BOOT[robot], now_ns, now_ns, 0, 0, 0, 0, 0, 0.0, 0.0, 0.0, 0.0, 1.0)
                self.bench.say(STATUS, status, robot)

    def _tick(self) -> None:
        if "controller" not in self.silent:
            robots = tuple(RobotTick(*[0.0] * 15, float(robot in self.lost)) for robot in ROBOTS)
            self.bench.say(TICK, TickRecord(1, 1, -1, self.bench.now_ns, 0, 0, 0, 0, 0, 0, robots))


@pytest.fixture
def stand(bench_of: Make, platoon_of: Make, monkeypatch: pytest.MonkeyPatch) -> Stand:
    return Stand(bench_of(platoon_of()), monkeypatch)


def test_a_run_starts_when_asked_and_stops_when_asked(stand: Stand) -> None:
    stand.run(S)
    assert stand.state.phase == Phase.IDLE
    assert stand.ask("start").answer == "ok"
    stand.run(S)
    assert (stand.state.phase, stand.state.cause) == (Phase.RUNNING, Event.FLEET_READY)
    assert stand.ask("stop").answer == "ok"
    assert (stand.state.phase, stand.state.cause) == (Phase.IDLE, Event.STOP_REQUESTED)


def test_an_unknown_request_is_answered_and_changes_nothing(stand: Stand) -> None:
    stand.running()
    assert stand.ask("fly").answer == "unknown request 'fly'"
    stand.run(S)
    assert stand.state.phase == Phase.RUNNING


@pytest.mark.parametrize("missing", ["r1", "r3", "controller"])
def test_a_fleet_that_is_not_whole_does_not_start(stand: Stand, missing: str) -> None:
    stand.silent.add(missing)
    stand.run(S)
    stand.ask("start")
    stand.run(S)
    assert stand.state.phase == Phase.ARMED
    stand.silent.clear()
    stand.run(S // 5)
    assert stand.state.phase == Phase.RUNNING


def test_a_robot_that_is_not_seen_does_not_start(stand: Stand) -> None:
    stand.lost.add("r2")
    stand.ask("start")
    stand.run(S)
    assert stand.state.phase == Phase.ARMED


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_driver_that_is_silent_for_half_a_second_is_a_fault_with_its_name(stand: Stand, robot: str) -> None:
    stand.running()
    stand.silent.add(robot)
    stand.run(460 * MS)
    assert stand.state.phase == Phase.RUNNING
    stand.run(120 * MS)
    phase, cause, row = stand.state[2:]
    assert (phase, cause) == (Phase.FAULT, Event.DRIVER_SILENT)
    assert RunStatus(Phase(phase), Event(cause), row).describe(ROBOTS) == f"the driver went silent: {robot}"


def test_a_silent_controller_is_a_fault(stand: Stand) -> None:
    stand.running()
    stand.silent.add("controller")
    stand.run(460 * MS)
    assert stand.state.phase == Phase.RUNNING
    stand.run(120 * MS)
    assert stand.state[2:] == (Phase.FAULT, Event.CONTROLLER_SILENT, NOBODY)


def test_a_robot_lost_for_two_seconds_is_a_fault_with_its_name(stand: Stand) -> None:
    stand.running()
    stand.lost.add("r4")
    stand.run(1900 * MS)
    assert stand.state.phase == Phase.RUNNING
    stand.lost.clear()
    stand.run(S // 5)
    stand.lost.add("r4")
    stand.run(1900 * MS)
    assert stand.state.phase == Phase.RUNNING, "it was seen in between"
    stand.run(200 * MS)
    assert stand.state[2:] == (Phase.FAULT, Event.ROBOT_LOST, ROBOTS.index("r4"))


def test_a_fault_stays_with_its_first_cause(stand: Stand) -> None:
    stand.running()
    stand.silent.add("r2")
    stand.run(S)
    stand.silent |= {"r1", "controller"}
    stand.run(S)
    stand.silent.clear()
    stand.ask("start")
    stand.run(S)
    assert stand.state[2:] == (Phase.FAULT, Event.DRIVER_SILENT, ROBOTS.index("r2"))


def test_enables_echo_the_newest_nonce_and_the_phase(stand: Stand) -> None:
    stand.running()
    for robot in ROBOTS:
        enable = stand.bench.heard(ENABLE, robot)[-1]
        assert (enable.boot_id, enable.phase) == (BOOT[robot], Phase.RUNNING)
        assert 0 <= stand.nonces[robot] - enable.nonce <= 40 * MS
    stand.silent.add("r1")
    stand.run(S // 5)
    late = stand.bench.heard(ENABLE, "r1")[-1]
    assert late.nonce == stand.nonces["r1"], "an old nonce is never made fresh"


def test_nobody_is_enabled_before_it_was_heard(stand: Stand) -> None:
    stand.silent.add("r3")
    stand.run(S // 5)
    assert stand.bench.heard(ENABLE, "r3") == []
    assert stand.bench.heard(ENABLE, "r2")


def test_a_state_every_40_ms_and_at_once_when_it_changes(stand: Stand) -> None:
    at: list[int] = []
    stand.bench.bus.tap(lambda said: at.append(stand.bench.now_ns) if said[0].endswith("/state") else None)
    stand.run(S)
    assert set(np.diff(at)) == {40 * MS}
    stand.bench.wait(5 * MS)
    before, enables = len(at), len(stand.bench.heard(ENABLE, "r1"))
    stand.ask("start")
    assert len(at) == before + 1
    assert len(stand.bench.heard(ENABLE, "r1")) == enables + 1
    assert stand.state.phase in (Phase.ARMED, Phase.RUNNING)


def test_missed_periods_are_not_made_up(stand: Stand) -> None:
    stand.run(S // 5)
    before = len(stand.bench.heard(STATE))
    stand.bench.wait(S)
    for _ in range(5):
        assert 0 < stand.node.step(stand.bench.now_ns) - stand.bench.now_ns <= 40 * MS
    assert len(stand.bench.heard(STATE)) == before + 1
