"""Each invariant of a storm can fail: it is broken once in a gate or in the supervisor, and a few storms find it."""

from collections.abc import Callable
from itertools import count, islice
from typing import Any

import pytest
from pydantic import TypeAdapter

from robofleet.config.tree import Config
from robofleet.config.troubles import InjectedFault
from robofleet.core.clock import MS, S
from robofleet.drivers.simulated import SimulatedRobot
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
Sabotage = Callable[[Patch], None]
Storms = Callable[[Plan], bool]
_FEW = 5  # storms of the kind that can show it; the first that goes red ends a test
_FAULTS = 3  # of such a storm: with many at once another one may end the run before


@pytest.fixture(scope="module")
def fleet(platoon_of: Callable[..., Config]) -> Config:
    return platoon_of("tracker.source=truth")


@pytest.fixture(autouse=True)
def uncompiled(monkeypatch: Patch) -> None:
    """A compiled gate keeps the functions that it was compiled from; the plain one takes those of a test."""
    monkeypatch.setattr(drivers, "in_arrays", lambda *_: False)


def _changed(target: object, name: str, change: Callable[..., Any]) -> Sabotage:
    """Replace a function; ``change`` takes the true one, then its arguments."""
    true = getattr(target, name)
    return lambda patch: patch.setattr(target, name, lambda *args, **keys: change(true, *args, **keys))


def _constant(target: object, name: str, value: object) -> Sabotage:
    return lambda patch: patch.setattr(target, name, value)


def _fed_by_refused(take: Any, g: GateState, drive: Any, i: Inputs, now_ns: int) -> None:
    take(g, drive, i, now_ns)
    g.heard_ns, g.command_nonce = now_ns, max(g.command_nonce, now_ns - 10 * MS)


def _without_ramp(follow: Any, g: GateState, left: float, right: float, *rest: Any) -> None:
    follow(g, left, right, *rest)
    g.output_left, g.output_right = left, right


def _without_limit(take: Any, g: GateState, *rest: Any) -> None:
    take(g, *rest)
    g.limit = 12.5


def _cleared(take: Any, g: GateState, *rest: Any) -> None:
    latch = g.latch
    take(g, *rest)
    if latch == Latch.EMERGENCY_STOP:
        g.latch = Latch.NONE


def _creeping(write: Any, robot: SimulatedRobot, wheels: WheelSpeeds) -> None:
    write(robot, wheels if max(map(abs, wheels)) > 2.0 else WheelSpeeds(1.0, 1.0))  # it never hears the end of a ramp


def _without_cause(step: Any, status: Any, happening: Any) -> Any:
    after = step(status, happening)
    return after if after.phase is Phase.RUNNING else after._replace(cause=Event.NOTHING)


def _asking_only(begin: Any, stop: EmergencyStop, *rest: Any) -> None:
    begin(stop, *rest)
    stop._gates = [(source, robots, lambda _: None) for source, robots, _ in stop._gates]


def _unseen(*events: Event) -> Sabotage:
    def watched(watch: Any, *args: Any, **keys: Any) -> Any:
        memory, happenings = watch(*args, **keys)
        return memory, tuple(h for h in happenings if h.event not in events)

    return _changed(monitor, "watch", watched)


def _deaf(*events: Event) -> Sabotage:
    return _changed(supervisor, "step", lambda step, s, h: s if h.event in events else step(s, h))


_CLEARED_BY_ANYTHING = _changed(gate, "_take_permission", _cleared)
_DEAF_TO_STOPS = _deaf(Event.ESTOP_REQUESTED, Event.STOPPED_AT_GATE, Event.SUPERVISOR_STALLED)


def _frozen_stop(storm: Plan) -> bool:
    frozen = [fault for fault in storm.faults if fault.kind == "stopped" and fault.process == "supervisor"]
    stops = [act.at_s for act in storm.acts if act.request == b"estop"]
    return any(fault.at_s < at_s < fault.at_s + fault.duration_s - 0.1 for fault in frozen for at_s in stops)


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
    return lambda storm: (
        len(storm.faults) <= _FAULTS
        and any(
            fault.kind == kind and fault.duration_s > 1.5 and getattr(fault, "process", "").startswith(process)
            for fault in storm.faults
        )
    )


@pytest.mark.parametrize(
    ("sabotage", "storms", "invariant"),
    [
        (_constant(gate, "VALID_NS", 10 * S), _with("killed", "controller"), "the target is not zero without"),
        (_changed(gate, "_take_command", _fed_by_refused), _any, "a refused command"),
        (_changed(gate, "follow", _without_ramp), _any, "a wheel accelerates"),
        (
            _changed(gate, "follow", lambda follow, g, l, r, top, ns: follow(g, l, r, top / 9, ns)),
            _any,
            "the output was not zero 230 ms",
        ),
        (_changed(gate, "_take_permission", _without_limit), _any, "a refused enable"),
        (_CLEARED_BY_ANYTHING, _estop, "a latch was cleared"),
        (_changed(EmergencyStop, "__init__", _asking_only), _frozen_stop, "an emergency stop has not latched"),
        (_DEAF_TO_STOPS, _calm_stop, "the run went on after an emergency stop"),
        (_CLEARED_BY_ANYTHING, _estop, "the latch went before a reset"),
        (_constant(gate, "LAPSE_NS", 0), _with("second_controller"), "the lease changed"),
        (
            _constant(gate, "_stop_held_up", lambda *_: None),
            _with("stopped", "driver"),
            "a gate that was held up goes on",
        ),
        (_changed(SimulatedRobot, "write", _creeping), _any, "the robot is not at rest"),
        (_unseen(Event.WIRED_STOP, Event.GATE_LATCHED), _with("wired_stop"), "nothing stopped"),
        (_changed(supervisor, "step", _without_cause), _with("wired_stop"), "without a cause"),
        (_deaf(Event.RESET), _with("wired_stop"), "it does not run again"),
    ],
)
def test_a_check_that_is_missing_is_found(
    fleet: Config, monkeypatch: Patch, sabotage: Sabotage, storms: Storms, invariant: str
) -> None:
    sabotage(monkeypatch)
    for seed in islice((seed for seed in count(1) if storms(plan(fleet, seed))), _FEW):
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


@pytest.mark.parametrize(("acts", "speed_rad_s"), [((Act(0.9, b"estop"),), 6.1), ((), -6.1)], ids=["stands", "drives"])
def test_a_wheel_that_turns_by_itself_must_be_named(
    fleet: Config, monkeypatch: Patch, acts: tuple[Act, ...], speed_rad_s: float
) -> None:
    faults = ({**RUNS, "speed_rad_s": speed_rad_s},)
    assert played(fleet, monkeypatch, faults, *acts) == []
    monkeypatch.setattr(runaway, "RESTS_WITHIN_NS", 100 * S)
    assert "a wheel turns by itself and is not named" in played(fleet, monkeypatch, faults, *acts)


def test_a_wheel_that_stands_must_hold_the_run(fleet: Config, monkeypatch: Patch) -> None:
    assert played(fleet, monkeypatch, (STUCK,)) == []
    _unseen(Event.WHEEL_STALLED)(monkeypatch)
    assert "a wheel stands and the run goes on" in played(fleet, monkeypatch, (STUCK,))


def test_an_emergency_stop_on_a_full_disk_must_outlive_a_kill(fleet: Config, monkeypatch: Patch) -> None:
    stop = Act(1.5, b"estop")
    assert played(fleet, monkeypatch, (FULL, KILLED), stop) == []
    monkeypatch.setattr(MemoryStateStore, "lose", lambda *_: None)
    assert "a latch was cleared without an authorised reset at rest" in played(fleet, monkeypatch, (FULL, KILLED), stop)
