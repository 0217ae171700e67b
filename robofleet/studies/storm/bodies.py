"""Invariants of the true motion: rest after a stop, no contact, inside the arena. The plants publish it."""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.behaviours.go_to import GoTo
from robofleet.config import groups
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.core.arrays import Array, Flags
from robofleet.core.clock import S
from robofleet.safety.latches import Latch
from robofleet.safety.runaway import direction
from robofleet.simulation.faults import Injection
from robofleet.studies.storm.gates import intervals
from robofleet.studies.storm.ledger import GateDecision, Span, Violation
from robofleet.vehicles.interface import STOP

_GRID_STEP_NS = 10_000_000  # a robot goes 2 mm in it
_REST_RAD_S = 0.02  # of a wheel; friction holds it soon after
_STANDING_M_S = 1e-3
_NAMED_WITHIN_NS = 1_200_000_000  # of a wheel that turns by itself: 0.8 s, and its lag up and down
_FLICKER_RAD_S = 0.5  # of a measured speed: two counts of the shipped robots' encoders
_COMMANDED_RAD_S = 2.0  # no wheel stays at rest then
_HELD_WITHIN_NS = 1_500_000_000  # of a wheel that stands: 1 s, and the hold's way to the gate and down the ramp


def rest_within_s(robot: Robot) -> float:
    """Return how long a robot may roll on after its output is zero: its lag from top speed, and its firmware."""
    plant = robot.vehicle.simulated
    assert plant is not None
    decay = math.log(robot.vehicle.max_wheel_speed_rad_s / _REST_RAD_S)
    return plant.actuation_delay_s + plant.motor_lag_s * decay + 2 * plant.loop_period_s


def rolling_on(
    robot: Robot, decisions: Array, sent_ns: Array, truth: NDArray[Any], runaways: Sequence[Span]
) -> list[Violation]:
    """Find robots that move although their output has been zero for long enough.

    ``decisions``: instant [ns] and whether the output is zero, (K, 2); ``runaways``: when a wheel turned by itself.
    """
    found = []
    innocent = np.zeros(len(sent_ns), dtype=np.bool_)
    for runs in runaways:
        innocent |= (sent_ns >= runs.start_ns) & (sent_ns <= runs.end_ns + rest_within_s(robot) * S)
    half_base = robot.vehicle.wheel_base_m / 2
    speed = abs(truth["v_m_s"]) + half_base * abs(truth["omega_rad_s"])
    within_ns = rest_within_s(robot) * S
    for first, last in intervals(decisions[:, 1] > 0):
        until = decisions[last + 1, 0] if last + 1 < len(decisions) else math.inf
        a, b = np.searchsorted(sent_ns, [decisions[first, 0] + within_ns, until], side="right")
        moving = (speed > _STANDING_M_S) & ~innocent
        late = np.flatnonzero(moving[a : max(a, b - 1)])
        if len(late):
            row = a + int(late[0])
            since_ms = (sent_ns[row] - decisions[first, 0]) / 1e6
            numbers = f"{1e3 * speed[row]:.2f} mm/s {since_ms:.0f} ms after its output was zero"
            found.append(Violation("the robot is not at rest", sent_ns[row] / S, robot.id, numbers))
    return found


def unnamed(
    robot: str, decisions: Sequence[GateDecision], runaways: Sequence[Injection], outages: Sequence[Span]
) -> list[Violation]:
    """Find wheels that turned by themselves for a second, faster than their output, and whose gates were not latched.

    ``outages``: when nobody looked at them, or their motors stood.
    """
    at_ns = np.array([decision.true_ns for decision in decisions], dtype=np.float64)
    found = []
    for runs in runaways:
        wheel, speed = runs.fault.wheel, runs.fault.speed_rad_s
        same = (other for other in runaways if other is not runs and other.fault.wheel == wheel)
        unsure = [*outages, *(Span(other.start_ns, other.end_ns) for other in same)]
        surely = speed - math.copysign(_FLICKER_RAD_S, speed)
        disobeys = [
            decision.state.output == STOP or direction(getattr(decision.state.output, wheel), surely) != 0
            for decision in decisions
        ]
        for start_ns, end_ns in _together(at_ns, np.array(disobeys), [Span(runs.start_ns, runs.end_ns)], math.inf):
            named_ns = start_ns + _NAMED_WITHIN_NS
            watched = all(out.end_ns + S < start_ns or out.start_ns > named_ns for out in unsure)
            if named_ns >= end_ns or not watched:
                continue
            newest = decisions[int(np.searchsorted(at_ns, named_ns, side="right")) - 1]
            if newest.state.latch != Latch.RUNAWAY:
                numbers = f"{Latch(newest.state.latch).name}, {_NAMED_WITHIN_NS / 1e6:.0f} ms after it did not obey"
                found.append(Violation("a wheel turns by itself and is not named", named_ns / S, robot, numbers))
    return found


def unheld(
    robot: str, decisions: Sequence[GateDecision], stuck: Sequence[Span], outages: Sequence[Span]
) -> list[Violation]:
    """Find wheels that stood though their output was to turn, for so long that the run should have been held.

    ``stuck``: when the motors stood whatever was commanded; ``outages``: when nobody heard of it, or who did was not
    heard.
    """
    at_ns = np.array([decision.true_ns for decision in decisions], dtype=np.float64)
    outputs = np.array([decision.state.output for decision in decisions], dtype=np.float64)
    found = []
    for wheel in outputs.T:
        for start_ns, end_ns in _together(at_ns, abs(wheel) >= _COMMANDED_RAD_S, stuck, at_ns[-1]):
            unbroken = all(out.end_ns < start_ns or out.start_ns > end_ns for out in outages)
            if end_ns - start_ns > _HELD_WITHIN_NS and unbroken:
                numbers = f"its output was to turn for {(end_ns - start_ns) / 1e6:.0f} ms"
                found.append(Violation("a wheel stands and the run goes on", end_ns / S, robot, numbers))
    return found


def _together(at_ns: Array, flags: Flags, spans: Sequence[Span], end_ns: float) -> Iterator[Span]:
    """Yield when a flag of decisions and a span hold at once; ``end_ns``: of the last decision."""
    until_ns = np.append(at_ns[1:], end_ns)
    for first, last in intervals(flags):
        yield from (Span(max(at_ns[first], span.start_ns), min(until_ns[last], span.end_ns)) for span in spans)


def at_goals(config: Config, poses: Mapping[str, tuple[float, float, float]]) -> set[str]:
    """Return the robots that have nothing more to do: they stand at their goals, to twice the accuracy of the group.

    ``poses``: true x, y [m], psi [rad] of each robot.
    """
    found = set()
    for group in config.groups:
        if not issubclass(groups.kind(group), GoTo):
            continue
        settings = GoTo.Settings.model_validate(group.settings)
        near_m, turned = 2 * settings.position_accuracy_m, math.radians(2 * settings.heading_accuracy_deg)
        labelled = settings.assignment == "labelled"
        for robot in group.robots:
            x, y, psi = poses.get(robot, (math.nan,) * 3)
            goals = [settings.goals[robot]] if labelled else settings.goals.values()
            if any(
                math.hypot(x - goal.x_m, y - goal.y_m) <= near_m
                and abs(math.remainder(psi - goal.pose[2], math.tau)) <= turned
                for goal in goals
            ):
                found.add(robot)
    return found


def apart(config: Config, sent_ns: list[Array], truths: list[NDArray[Any]], until_ns: float) -> list[Violation]:
    """Find two bodies that touch, and bodies that cross the arena's edge, before an instant."""
    start, end = max(times[0] for times in sent_ns), min(until_ns, *(times[-1] for times in sent_ns))
    grid = np.arange(start, end, _GRID_STEP_NS)
    if not len(grid):
        return []
    x, y = (
        np.array([np.interp(grid, t, truth[name]) for t, truth in zip(sent_ns, truths, strict=True)])
        for name in ("x_m", "y_m")
    )
    robots, found = config.bodies, []
    radii = [robot.vehicle.body_radius_m for robot in robots]
    half_x, half_y = (side / 2 for side in config.arena.size_m)
    for i, robot in enumerate(robots):
        beyond = np.maximum(abs(x[i]) - half_x, abs(y[i]) - half_y) + radii[i]
        found += _first(grid, beyond, "the body crosses the arena's edge", robot.id)
    for i, j in itertools.combinations(range(len(robots)), 2):
        overlap = radii[i] + radii[j] - np.hypot(x[i] - x[j], y[i] - y[j])
        found += _first(grid, overlap, f"the body touches {robots[j].id}'s", robots[i].id)
    return found


def _first(grid: Array, excess: Array, invariant: str, robot: str) -> list[Violation]:
    wrong = np.flatnonzero(excess > 0)
    if not len(wrong):
        return []
    row = wrong[0]
    return [Violation(invariant, grid[row] / S, robot, f"by {1e3 * excess[wrong].max():.1f} mm at most")]
