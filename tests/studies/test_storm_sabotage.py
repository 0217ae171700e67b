"""Each invariant of a storm can fail: it is broken once in a gate or in the supervisor, and a few storms find it."""

from collections.abc import Callable, Iterator
from itertools import count, islice
from typing import Any

import pytest
from pydantic import TypeAdapter

from robofleet.config.tree import Config
from robofleet.config.troubles import InjectedFault
from robofleet.core.clock import MS, S
from robofleet.nodes.unit import drivers
from robofleet.nodes.unit.state_store import MemoryStateStore
from robofleet.operator.estop import EmergencyStop
from robofleet.safety import gate, monitor, runaway, supervisor
from robofleet.safety.gate import GateState, Inputs
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import Event, Phase
from robofleet.studies.storm import episode
from robofleet.studies.storm.episode import play
from robofleet.studies.storm.schedule import Act, Plan, plan
from robofleet.vehicles.interface import WheelSpeeds

pytestmark = pytest.mark.long

Patch = pytest.MonkeyPatch
Storms = Callable[[Plan], bool]
_CREEP = WheelSpeeds(1.0, 1.0)
_FEW = 5  # storms of the kind that can show it; the first that goes red ends a test
_FAULTS = 3  # of such a storm: with many at once another one may end the run before


@pytest.fixture(scope="module")
def fleet(platoon_of: Callable[..., Config]) -> Config:
    return platoon_of("tracker.source=truth")


@pytest.fixture(autouse=True)
def uncompiled(monkeypatch: Patch) -> None:
    """A compiled gate keeps the functions that it was compiled from; the plain one takes those of a test."""
    monkeypatch.setattr(drivers, "in_arrays", lambda *_: False)


def _old_messages_count(patch: Patch) -> None:
    patch.setattr(gate, "VALID_NS", 10 * S)


def _refused_feeds_the_watchdog(patch: Patch) -> None:
    take = gate._take_command

    def taken(g: GateState, drive: Any, i: Inputs, now_ns: int) -> None:
        take(g, drive, i, now_ns)
        g.heard_ns, g.command_nonce = now_ns, max(g.command_nonce, now_ns - 10 * MS)

    patch.setattr(gate, "_take_command", taken)


def _no_ramp(patch: Patch) -> None:
    follow = gate._follow

    def followed(g: GateState, left: float, right: float, acceleration: float, now_ns: int) -> None:
        follow(g, left, right, acceleration, now_ns)
        g.output_left, g.output_right = left, right

    patch.setattr(gate, "_follow", followed)


def _slow_ramp(patch: Patch) -> None:
    follow = gate._follow
    patch.setattr(gate, "_follow", lambda g, left, right, top, now_ns: follow(g, left, right, top / 9, now_ns))


def _no_limit(patch: Patch) -> None:
    take = gate._take_permission

    def taken(g: GateState, i: Inputs, clearable: bool, now_ns: int) -> None:
        take(g, i, clearable, now_ns)
        g.limit = 12.5

    patch.setattr(gate, "_take_permission", taken)


def _cleared_by_anything(patch: Patch) -> None:
    take = gate._take_permission

    def taken(g: GateState, i: Inputs, clearable: bool, now_ns: int) -> None:
        latch = g.latch
        take(g, i, clearable, now_ns)
        if latch == Latch.EMERGENCY_STOP:
            g.latch = Latch.NONE

    patch.setattr(gate, "_take_permission", taken)


def _lease_for_everybody(patch: Patch) -> None:
    patch.setattr(gate, "LAPSE_NS", 0)


def _nothing_lost(patch: Patch) -> None:
    patch.setattr(MemoryStateStore, "lose", lambda *_: None)


def _held_up_and_goes_on(patch: Patch) -> None:
    patch.setattr(gate, "_stop_held_up", lambda *_: None)


def _runaways_unnamed(patch: Patch) -> None:
    patch.setattr(runaway, "RESTS_WITHIN_NS", 100 * S)


def _robot_goes_on(patch: Patch) -> None:
    from robofleet.drivers.simulated import SimulatedRobot

    write = SimulatedRobot.write

    def written(robot: SimulatedRobot, wheels: WheelSpeeds) -> None:
        write(robot, wheels if max(map(abs, wheels)) > 2.0 else _CREEP)  # it never hears the end of a ramp

    patch.setattr(SimulatedRobot, "write", written)


def _unseen(*events: Event) -> Callable[[Patch], None]:
    def blind(patch: Patch) -> None:
        watch = monitor.watch

        def watched(*args: Any, **keys: Any) -> Any:
            memory, happenings = watch(*args, **keys)
            return memory, tuple(h for h in happenings if h.event not in events)

        patch.setattr(monitor, "watch", watched)

    return blind


def _no_cause(patch: Patch) -> None:
    step = supervisor.step

    def silent(status: Any, happening: Any) -> Any:
        after = step(status, happening)
        return after if after.phase is Phase.RUNNING else after._replace(cause=Event.NOTHING)

    patch.setattr(supervisor, "step", silent)


def _no_reset(patch: Patch) -> None:
    step = supervisor.step
    patch.setattr(supervisor, "step", lambda s, h: s if h.event is Event.RESET else step(s, h))


def _only_the_supervisor_is_asked(patch: Patch) -> None:
    patch.setattr(EmergencyStop, "__init__", _asking_only(EmergencyStop.__init__))


def _asking_only(begin: Callable[..., None]) -> Callable[..., None]:
    def begun(stop: Any, bus: Any, robots: Any, now_ns: int) -> None:
        begin(stop, bus, robots, now_ns)
        stop._tell = [lambda _: None for _ in robots]

    return begun


def _deaf_to_stops(patch: Patch) -> None:
    step, deaf = supervisor.step, (Event.ESTOP_REQUESTED, Event.STOPPED_AT_GATE, Event.SUPERVISOR_STALLED)
    patch.setattr(supervisor, "step", lambda s, h: s if h.event in deaf else step(s, h))


def _frozen_stop(storm: Plan) -> bool:
    frozen = [fault for fault in storm.faults if fault.kind == "stopped" and fault.process == "supervisor"]
    return any(
        fault.at_s < act.at_s < fault.at_s + fault.duration_s - 0.1
        for fault in frozen
        for act in storm.acts
        if act.request == b"estop"
    )


def _any(_storm: Plan) -> bool:
    return True


def _estop(storm: Plan) -> bool:
    return any(act.request == b"estop" for act in storm.acts)


def _calm_stop(storm: Plan) -> bool:
    """Whether a stop comes before any fault, so nothing else ends the run."""
    first_s = min(fault.at_s for fault in storm.faults)
    return any(act.request == b"estop" and act.at_s < first_s - 0.4 for act in storm.acts)


def _with(kind: str, process: str = "") -> Storms:
    """Return which storms bring a long fault of a kind, to a process whose name begins like that."""

    def brings(storm: Plan) -> bool:
        return len(storm.faults) <= _FAULTS and any(
            fault.kind == kind and fault.duration_s > 1.5 and getattr(fault, "process", "").startswith(process)
            for fault in storm.faults
        )

    return brings


def _seeds(fleet: Config, wanted: Storms) -> Iterator[int]:
    return islice((seed for seed in count(1) if wanted(plan(fleet, seed))), _FEW)


@pytest.mark.parametrize(
    ("sabotage", "storms", "invariant"),
    [
        (_old_messages_count, _with("killed", "controller"), "the target is not zero without"),
        (_refused_feeds_the_watchdog, _any, "a refused command"),
        (_no_ramp, _any, "a wheel accelerates"),
        (_slow_ramp, _any, "the output was not zero 230 ms"),
        (_no_limit, _any, "a refused enable"),
        (_cleared_by_anything, _estop, "a latch was cleared"),
        (_only_the_supervisor_is_asked, _frozen_stop, "an emergency stop has not latched"),
        (_deaf_to_stops, _calm_stop, "the run went on after an emergency stop"),
        (_cleared_by_anything, _estop, "the latch went before a reset"),
        (_lease_for_everybody, _with("second_controller"), "the lease changed"),
        (_held_up_and_goes_on, _with("stopped", "driver"), "a gate that was held up goes on"),
        (_robot_goes_on, _any, "the robot is not at rest"),
        (_unseen(Event.WIRED_STOP, Event.GATE_LATCHED), _with("wired_stop"), "nothing stopped"),
        (_no_cause, _with("wired_stop"), "without a cause"),
        (_no_reset, _with("wired_stop"), "it does not run again"),
    ],
)
def test_a_check_that_is_missing_is_found(
    fleet: Config, monkeypatch: Patch, sabotage: Callable[[Patch], None], storms: Storms, invariant: str
) -> None:
    sabotage(monkeypatch)
    for seed in _seeds(fleet, storms):
        if any(invariant in violation.invariant for violation in play(fleet, seed).violations):
            return
    pytest.fail(f"{_FEW} storms have not found it")


RUNS = {"kind": "motor_runs", "robot": "r2", "wheel": "left", "speed_rad_s": 6.1, "at_s": 1.0, "duration_s": 3.0}
STUCK = {"kind": "motor_stuck", "robot": "r2", "at_s": 1.0, "duration_s": 3.0}
FULL = {"kind": "disk_full", "at_s": 0.5, "duration_s": 4.0}
KILLED = {"kind": "killed", "process": "driver-r1", "at_s": 2.0, "duration_s": 0.3}


def played(fleet: Config, patch: Patch, faults: tuple[dict[str, Any], ...], *acts: Act) -> list[str]:
    """Return what does not hold in a storm that was planned by hand."""
    validate = TypeAdapter(InjectedFault).validate_python
    storm = Plan(tuple(validate(fault) for fault in faults), acts, 4.5, 0.0)
    patch.setattr(episode, "plan", lambda *_: storm)
    return [violation.invariant for violation in play(fleet, 3).violations]


def test_a_wheel_that_turns_by_itself_must_be_named(fleet: Config, monkeypatch: Patch) -> None:
    hold = Act(0.9, b"estop")
    assert played(fleet, monkeypatch, (RUNS,), hold) == []
    _runaways_unnamed(monkeypatch)
    assert "a wheel turns by itself and is not named" in played(fleet, monkeypatch, (RUNS,), hold)


def test_a_wheel_that_stands_must_hold_the_run(fleet: Config, monkeypatch: Patch) -> None:
    assert played(fleet, monkeypatch, (STUCK,)) == []
    _unseen(Event.WHEEL_STALLED)(monkeypatch)
    assert "a wheel stands and the run goes on" in played(fleet, monkeypatch, (STUCK,))


def test_an_emergency_stop_on_a_full_disk_must_outlive_a_kill(fleet: Config, monkeypatch: Patch) -> None:
    stop = Act(1.5, b"estop")
    assert played(fleet, monkeypatch, (FULL, KILLED), stop) == []
    _nothing_lost(monkeypatch)
    assert "a latch was cleared without an authorised reset at rest" in played(fleet, monkeypatch, (FULL, KILLED), stop)
