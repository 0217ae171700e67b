"""Every rule of the monitor fires through the supervisor; with that rule taken out its event is not told.

The rules are read from the monitor's source: each condition under which it tells an event. One that is added there
without a scenario here fails.
"""

import ast
import inspect
import re
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType, ModuleType
from typing import Any, NamedTuple

import pytest

from robofleet.bus.keys import STATE
from robofleet.core.clock import MS, S
from robofleet.core.kernels import Kernel
from robofleet.safety import monitor
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import Event, Phase
from robofleet.vehicles.interface import RobotFault
from tests.nodes.stand import Stand

STOPS = {"left_angle_rad": 1.0, "left_output_rad_s": 12.5}  # its left wheel stands, though it is told to turn
Act = Callable[[Stand], None]


class Scenario(NamedTuple):
    """What brings a rule about, and the event that is told then."""

    event: Event
    act: Act
    lasts_ns: int = 200 * MS
    begin: Act = Stand.running
    overrides: tuple[str, ...] = ()
    keys: Mapping[str, Any] = MappingProxyType({})
    patience: tuple[str, ...] = ()  # thresholds of the monitor that are too long for a test


def says(**fields: Any) -> Act:
    return lambda stand: stand.robots["r2"].says.update(fields)


def silent(name: str) -> Act:
    return lambda stand: stand.silent.add(name)


def every_tick(**fields: float) -> Act:
    return lambda stand: stand.stopped.update(fields)


def newest_tick(robot: Mapping[str, float] = MappingProxyType({}), **changes: int) -> Act:
    """Let the controller tell of one tick; ``robot``: fields of each robot's part."""

    def act(stand: Stand) -> None:
        stand.tick += 1
        stand.tell_tick(dict(robot), **changes)

    return act


def image(**changes: int) -> Act:
    return lambda stand: stand.tell_image(**changes)


def driven_to(robot: str, x_m: float) -> Act:
    """Let a robot be seen on its way, never further than it can drive between two images."""

    def act(stand: Stand) -> None:
        def move() -> None:
            x, y, psi = stand.places[robot]
            stand.places[robot] = (x + max(-0.02, min(0.02, x_m - x)), y, psi)

        stand.robots[robot].says["left_angle_rad"] = 1.0  # it counts: nobody takes it for one that rolls by itself
        stand.others.append((33 * MS, move))

    return act


def hidden(stand: Stand) -> None:
    stand.hidden.add("r2")


def seen_only_by_a_camera_that_is_out(stand: Stand) -> None:
    hidden(stand)
    stand.node._listener._robots["camera_out"][1] = 1


def restarted(stand: Stand) -> None:
    stand.robots["r2"].boot_id = 999


def controller_restarted(stand: Stand) -> None:
    stand.epoch, stand.tick = 8, 0


def disk_filled(stand: Stand) -> None:
    stand.free_bytes = 0


def asked_to_start(stand: Stand) -> None:
    stand.run(S // 5)
    assert stand.ask("start") == "ok"


def asked_to_hold(stand: Stand) -> None:
    assert stand.ask("hold") == "ok"


def stood_still(stand: Stand) -> None:
    stand.bench.wait(501 * MS)
    for others_talk in (stand._talk, stand._control, stand._see):
        others_talk()


def nothing(stand: Stand) -> None:
    """What is under way takes too long."""


SCENARIOS = {
    "_host SUPERVISOR_STALLED": Scenario(Event.SUPERVISOR_STALLED, stood_still),
    "_host OPERATOR_LOST": Scenario(Event.OPERATOR_LOST, silent("operator"), 1300 * MS, keys={"attended": True}),
    "_host DISK_FULL": Scenario(Event.DISK_FULL, disk_filled),
    "_host ARMED_TOO_LONG": Scenario(
        Event.ARMED_TOO_LONG, nothing, 700 * MS, asked_to_start, keys={"prove": lambda state, *_: (state, None)},
        patience=("ARMED_NS", "ARMED_ROBOT_NS"),
    ),
    "_host HELD_TOO_LONG": Scenario(Event.HELD_TOO_LONG, asked_to_hold, patience=("HELD_NS",)),
    "_host _ARRIVALS": Scenario(Event.ACCOMPLISHED, newest_tick(phase=Phase.RUNNING, arrived=1)),
    "_host UNDER_WAY_TOO_LONG": Scenario(
        Event.UNDER_WAY_TOO_LONG, nothing, begin=asked_to_start, overrides=("run.begin=go_to_start",),
        patience=("UNDER_WAY_NS",),
    ),
    "_controller CONTROLLER_SILENT": Scenario(Event.CONTROLLER_SILENT, silent("controller"), 600 * MS),
    "_controller CONTROLLER_RESTARTED": Scenario(Event.CONTROLLER_RESTARTED, controller_restarted),
    "_controller OTHER_BUILD": Scenario(Event.OTHER_BUILD, newest_tick(build=1)),
    "_controller TICKS_OVERRUN": Scenario(Event.TICKS_OVERRUN, newest_tick(overruns=3)),
    "_tracker TRACKER_SILENT": Scenario(Event.TRACKER_SILENT, silent("tracker"), 350 * MS),
    "_tracker TRACKER_RESTARTED": Scenario(Event.TRACKER_RESTARTED, image(epoch=9)),
    "_tracker OTHER_BUILD": Scenario(Event.OTHER_BUILD, image(build=1)),
    "_of_robots LINK_LOST DRIVER_SILENT": Scenario(Event.DRIVER_SILENT, silent("r2"), 600 * MS),
    "_of_robots LINK_LOST DRIVER_RESTARTED": Scenario(Event.DRIVER_RESTARTED, restarted),
    "_of_robots OTHER_BUILD": Scenario(Event.OTHER_BUILD, says(build=1)),
    "_of_robots LINK_LOST LEASE_LOST": Scenario(Event.LEASE_LOST, says(session=9)),
    "_of_robots WIRED_STOP": Scenario(Event.WIRED_STOP, says(faults=RobotFault.WIRED_STOP)),
    "_of_robots RUNAWAY": Scenario(Event.RUNAWAY, says(latch=Latch.RUNAWAY)),
    "_of_robots ROBOT_FAULT": Scenario(Event.CLIFF, says(faults=RobotFault.CLIFF)),
    "_of_robots STOPPED_AT_GATE GATE_LATCHED": Scenario(Event.GATE_LATCHED, says(latch=Latch.DRIVER_FAILED)),
    "_of_robots BATTERY_LOW": Scenario(Event.BATTERY_LOW, says(battery=0.05)),
    "_of_robots POSE_JUMPED BYSTANDER_MOVED": Scenario(
        Event.POSE_JUMPED, lambda stand: stand.places.update(r2=(-0.5, 0.3, 0.0))
    ),
    "_of_robots CAMERA_OUT": Scenario(Event.CAMERA_OUT, seen_only_by_a_camera_that_is_out, 2200 * MS),
    "_of_robots TAG_LOST BYSTANDER_LOST": Scenario(Event.TAG_LOST, hidden, 2200 * MS),
    "_of_robots TAG_LATE": Scenario(Event.TAG_LATE, hidden, 300 * MS),
    "_of_robots OUTSIDE_ARENA": Scenario(Event.OUTSIDE_ARENA, driven_to("r1", -1.58), 1500 * MS),
    "_of_robots FILTER_INFEASIBLE": Scenario(Event.FILTER_INFEASIBLE, every_tick(filtered=2.0), 700 * MS),
    "_of_robots WHEEL_STALLED": Scenario(Event.WHEEL_STALLED, says(**STOPS), 1200 * MS),
    "_of_robots DEADLOCKED": Scenario(Event.DEADLOCKED, every_tick(blocked=1.0)),
    "_of_robots BEHAVIOUR_RAISED": Scenario(
        Event.BEHAVIOUR_LATE, newest_tick({"failed": float(Event.BEHAVIOUR_LATE)}, phase=Phase.RUNNING)
    ),
    "_of_pairs TOO_CLOSE": Scenario(Event.TOO_CLOSE, driven_to("r2", -0.9), 1000 * MS),
}  # fmt: skip


def rules(tree: ast.Module) -> Iterator[tuple[str, ast.If]]:
    """Yield each condition under which the monitor tells an event: its function, its events, and the condition."""
    for function in tree.body:
        for node in ast.walk(function):
            match node:
                case (
                    ast.If(body=[*_, ast.Expr(value=ast.Yield() as told)])
                    | ast.If(body=[*_, ast.Assign(value=ast.Call(func=ast.Name(id="_add")) as told)])
                ):
                    events = re.findall(r"Event\.\w+|_ARRIVALS", ast.unparse(told))
                    yield " ".join([function.name, *(event.removeprefix("Event.") for event in events)]), node


def monitor_without(rule: str) -> Any:
    """Return the monitor with a condition that never holds; its kernels run as Python."""
    tree, copy = ast.parse(inspect.getsource(monitor)), ModuleType(monitor.__name__)
    (condition,) = [node for name, node in rules(tree) if name == rule]
    condition.test = ast.copy_location(ast.Constant(value=False), condition.test)
    exec(compile(tree, str(monitor.__file__), "exec"), copy.__dict__)
    vars(copy).update({name: value.py_func for name, value in vars(copy).items() if isinstance(value, Kernel)})
    return copy


def test_every_rule_has_a_scenario() -> None:
    names = [name for name, _ in rules(ast.parse(inspect.getsource(monitor)))]
    assert len(set(names)) == len(names), "each rule stands once"
    assert set(names) == SCENARIOS.keys()


@pytest.mark.slow_after_first
@pytest.mark.parametrize("rule", SCENARIOS)
def test_a_rule_fires_through_the_supervisor_and_does_not_once_it_is_taken_out(
    rule: str, stand_of: Callable[..., Stand], monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario, without = SCENARIOS[rule], monitor_without(rule)

    def events_told() -> set[int]:
        stand = stand_of(*scenario.overrides, **scenario.keys)
        scenario.begin(stand)
        before = len(stand.bench.heard(STATE))
        for robot in stand.robots.values():
            robot.deaf = True  # the latches by which gates follow an emergency stop are events, too
        scenario.act(stand)
        stand.run(scenario.lasts_ns)
        states = stand.bench.heard(STATE)
        earlier = {state.cause for state in states[:before]} | {Event.HOLD_REQUESTED, Event.NOTHING}
        causes = {state.cause for state in states} | {robot.cause for state in states for robot in state.robots}
        return causes - earlier

    for module in (monitor, without):
        for threshold in scenario.patience:
            monkeypatch.setattr(module, threshold, 100 * MS)
    every = events_told()
    assert every <= {scenario.event, Event.TAG_LATE}
    monkeypatch.setattr(monitor, "watch", without.watch)
    assert every - events_told() == {scenario.event}
