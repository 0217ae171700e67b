"""go_to: every robot to a pose, position and heading, without collisions and without deadlock.

Before they drive, the robots stand until a joint plan is found (``control.planning``); it is looked for in parts, some
in each tick. It is executed by dependencies (``control.precedence``): who is late is waited for. A new plan is made
where the old one is wrong: a robot was carried away or pushed, something else stands in a way, or nobody gets on.
"""

import itertools
import math
from collections.abc import Generator, Iterable, Iterator, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from robofleet.behaviours.interface import (
    Behaviour,
    Bound,
    Decision,
    Dots,
    Figure,
    Past,
    Pose,
    Refusal,
    Shape,
    Situation,
    Team,
    rounded,
    statistics,
)
from robofleet.control import planning, precedence
from robofleet.control.flow import integrator_gain
from robofleet.control.following import PATIENCE_S, Follower, FollowerSettings, State
from robofleet.control.planning import Problem
from robofleet.control.precedence import Plan
from robofleet.core.arrays import Array, Indices
from robofleet.core.settings import ROBOTS, Coordinate, Degrees, Model, Name, within
from robofleet.safety.distances import Body, apart, apart_at_rest, from_edge
from robofleet.safety.supervisor import Event
from robofleet.vehicles.solids import distances

_SEARCH_PARTS_PER_TICK = 5
_MARGIN_M = 0.01  # of what robots keep under way beyond what the barrier keeps
_CELLS_ACROSS = 3.8  # the distance under way
_PUSHED_M = 0.10  # off its place, a robot needs another plan
_LOST_TICKS = 30  # for which it was there
_STUCK_S = 6.0  # without progress of anybody
_RETRY_S = 1.0  # after no plan was found
_MOST_FAILED = 10  # plans in a row: then the run is held
_STILL_M_PER_TICK = 0.004
_STILL_TICKS = 6
_THERE_TICKS = 15
_OTHER_MOVED_M = 0.01  # at least
_STANDS_S = 1.0  # what has stood for so long is there to stay


class Goal(Model):
    """A pose that a robot is to have."""

    x_m: Coordinate
    """x of the centre [world frame]."""
    y_m: Coordinate
    """y of the centre [world frame]."""
    heading_deg: Degrees = 0.0
    """Heading, counter-clockwise from the x axis."""

    @property
    def pose(self) -> Pose:
        """x, y [m], psi [rad]."""
        return self.x_m, self.y_m, math.radians(self.heading_deg)


class GoTo(Behaviour):
    """Every robot of the group to its pose."""

    class Settings(Model):
        """Keys of a group that goes to poses."""

        goals: Annotated[dict[Name, Goal], Field(min_length=1, max_length=ROBOTS)]
        """Goal of each robot, by the robot's id. With ``assignment: nearest`` the ids only count the goals."""
        assignment: Literal["labelled", "nearest"] = "labelled"
        """``labelled``: each robot has its own goal. ``nearest``: the goals are shared out so that the longest way is
        as short as possible, and then the sum of all ways."""
        speed_m_s: Annotated[float, within(0.01, 10)] | None = None
        """Speed under way. Without it each robot drives at 95 % of its top speed."""
        position_accuracy_m: Annotated[float, within(0.001, 0.1)] = 0.002
        """A robot stops within this distance of its goal. One that comes to rest further off is corrected, for 8 s at
        most."""
        heading_accuracy_deg: Annotated[float, within(0.2, 90)] = 0.9
        """A robot stops within this angle of its goal's heading, and is corrected likewise."""
        slowest_wheel_rad_s: Annotated[float, within(0, 10)] = 0.9
        """Least wheel speed at the goal and where a robot waits. It must start a wheel that stands."""

    settings: Settings
    figures = (
        Figure("distance_to_goal", "m", "mm", "distance of the centre from the goal"),
        Figure("heading_error", "rad", "deg", "magnitude of the heading minus the goal's heading"),
        Figure("waiting", "", "", "1 where the robot waits for others, or for a plan", live=False),
    )

    def __init__(self, settings: Settings, team: Team) -> None:
        super().__init__(settings, team)
        self._goals = np.array([settings.goals[r].pose if r in settings.goals else (np.nan,) * 3 for r in team.robots])
        if settings.assignment == "nearest" and len(settings.goals) == len(team):
            self._goals = np.array([goal.pose for goal in settings.goals.values()])
        radius = max(body.radius for body in team.bodies)
        ahead = 2 * team.keepout.ahead + _MARGIN_M
        self._distance = max(apart(team.keepout, a, b) for a in team.bodies for b in team.bodies) + ahead
        self._beside_bodies = self._distance - radius  # of a centre from the edge of another body
        self._edge = max(from_edge(team.keepout, body) for body in team.bodies) + ahead / 2
        self.rehearsed = False  # in this process
        self._follower = Follower(self._following(settings, team), [body.drive for body in team.bodies])
        self.restart()

    @staticmethod
    def _following(s: Settings, team: Team) -> FollowerSettings:
        speeds = tuple(s.speed_m_s or 0.95 * body.drive.max_speed for body in team.bodies)
        gain = integrator_gain(team.flow.alpha, team.tick, team.flow.integrator)
        return FollowerSettings(
            team.tick, team.point_ahead, team.flow.horizon, gain, speeds, s.position_accuracy_m,
            math.radians(s.heading_accuracy_deg), s.slowest_wheel_rad_s,
        )  # fmt: skip

    def rehearse(self) -> None:
        """Load or compile every kernel: no later decision waits for that."""
        if not self.rehearsed:
            self._follower.rehearse()
            self.rehearsed = True

    def restart(self) -> None:
        n = len(self.team)
        self._work: Generator[None, None, Plan | None] | None = None
        self._planned = False
        self._poses = np.full((n, 3), np.nan)
        self._still = np.zeros(n, dtype=np.int64)  # ticks
        self._off = np.zeros(n, dtype=np.int64)  # ticks
        self._seen, self._stood = np.zeros((0, 3)), 0  # others, and for how many ticks they have not moved
        self._target = self._goals  # of each robot, as assigned
        self._progress = (0.0, 0)  # of all robots, and ticks since it grew
        self._pause = 0  # ticks
        self._failed = 0  # plans in a row
        self._follower.begin(None, np.zeros((n, 3)), self._goals)

    def carried(self, robot: int) -> None:
        self._drop()

    def by_point_flow(self) -> bool:
        return True

    def changed(self, velocities: Array) -> None:
        if np.isfinite(self._poses).all():
            self._follower.changed(velocities, self._poses)

    @property
    def arrived(self) -> bool:
        """Whether all robots have been at their goals for a while."""
        return self._planned and bool((self._follower.state[:, State.THERE] >= _THERE_TICKS).all())

    def decide(self, now: Situation) -> Decision:
        self.rehearse()
        moved = np.hypot(*(now.poses - self._poses)[:, :2].T)
        self._still = np.where(moved < _STILL_M_PER_TICK * self.team.tick / 0.033, self._still + 1, 0)
        self._poses = now.poses.copy()
        if self._planned and self._wrong(now):
            self._drop()
        if not self._planned:
            self._plan(now)
        velocities = self._follower.tick(now.poses, now.driving, now.disturbance)
        left = now.poses - self._target
        state = self._follower.state
        ahead = self.team.point_ahead
        references = state[:, :2] + ahead * np.column_stack([np.cos(state[:, State.PSI]), np.sin(state[:, State.PSI])])
        figures = {
            "distance_to_goal": np.hypot(left[:, 0], left[:, 1]),
            "heading_error": np.abs((left[:, 2] + math.pi) % math.tau - math.pi),
            "waiting": ((state[:, State.MOVING] == 0) & (state[:, State.FINISHING] == 0)).astype(float),
        }
        hold = Event.BEHAVIOUR_NO_WAY if self._failed >= _MOST_FAILED else None
        self._failed = 0 if hold else self._failed
        return Decision(velocities, "body", references if self._planned else None, figures, hold=hold)

    def _drop(self) -> None:
        self._planned, self._work, self._pause = False, None, 0
        self._still[:] = 0
        self._follower.begin(None, self._poses, self._target)

    def _plan(self, now: Situation) -> None:
        """Look for a plan from where the robots stand."""
        if not now.driving.any():
            return
        if self._pause or (self._still < _STILL_TICKS).any():
            self._pause = max(0, self._pause - 1)
            return
        if self._work is None:
            self._work = self._search(now)
        try:
            for _ in range(_SEARCH_PARTS_PER_TICK):
                next(self._work)
        except StopIteration as done:
            self._work = None
            if done.value is None:
                self._failed += 1
                self._pause = round(_RETRY_S / self.team.tick)
                return
            self._planned, self._progress, self._failed = True, (0.0, 0), 0
            self._off[:] = 0
            self._follower.begin(done.value, now.poses, self._target)

    def _search(self, now: Situation) -> Generator[None, None, Plan | None]:
        self._target = self._goals
        if self.settings.assignment == "nearest":
            ways = np.linalg.norm(now.poses[:, None, :2] - self._goals[None, :, :2], axis=2)
            if self.team.keepout.solids:
                ways = yield from planning.ways(self._problem(now))
            self._target = self._goals[_shared_out(ways)]
        return (yield from precedence.plan(self._problem(now), self.team.rng))

    def _problem(self, now: Situation) -> Problem:
        starts, goals = now.poses[:, :2].copy(), self._target[:, :2].copy()
        obstacles = np.column_stack([now.others[:, :2], now.others[:, 2] + self._beside_bodies])
        if len(obstacles):  # a start or a goal that is nearer than that can be left, and come to
            ends = np.concatenate([starts, goals])
            nearest = np.linalg.norm(obstacles[:, None, :2] - ends[None], axis=2).min(axis=1)
            obstacles[:, 2] = np.minimum(obstacles[:, 2], nearest - 1e-6)
        return self._ways(starts, goals, obstacles)

    def _ways(self, starts: Array, goals: Array, obstacles: Array) -> Problem:
        half = (self.team.arena[0] / 2 - self._edge, self.team.arena[1] / 2 - self._edge)
        keeps = self.team.keepout.solids, self._edge
        return Problem(starts, goals, obstacles, half, self._distance, self._distance / _CELLS_ACROSS, *keeps)

    def _wrong(self, now: Situation) -> bool:
        """Whether the plan is to be made anew."""
        state, follower = self._follower.state, self._follower
        done, _ = follower.steps
        off = np.hypot(*(now.poses - state[:, :3])[:, :2].T) > _PUSHED_M
        self._off = np.where(off, self._off + 1, 0)
        made = float(done.sum() + (state[:, State.THERE] > 0).sum())
        best, since = self._progress
        brought = state[:, State.BRINGING] * self.team.tick
        ending = bool(((brought > 0.0) & (brought < PATIENCE_S) & (state[:, State.THERE] == 0)).any())
        nobody = bool(now.driving.all()) and not self.arrived and not ending
        self._progress = (made, 0) if made > best else (best, since + nobody)
        stuck = self._progress[1] * self.team.tick > _STUCK_S
        return stuck or bool((self._off > _LOST_TICKS).any()) or self._in_the_way(now.others)

    def _in_the_way(self, others: Array) -> bool:
        """Whether something has come to stand in a way. What moves is the barrier's, and may go again."""
        if others.shape != self._seen.shape or (np.abs(others - self._seen) > _OTHER_MOVED_M).any():
            self._seen, self._stood = others.copy(), 0
            return False
        self._stood += 1
        if self._stood != round(_STANDS_S / self.team.tick) or not len(others):
            return False
        ways = self._follower.rest()
        near = (
            np.linalg.norm(ways[:, None] - others[None, :, :2], axis=2) < others[:, 2] + self._beside_bodies - _MARGIN_M
        )
        return bool(near.any())

    # Before a run

    def refusals(self) -> Iterator[Refusal]:
        s, robots = self.settings, self.team.robots
        if s.assignment == "nearest":
            if len(s.goals) != len(robots):
                message = f"{len(s.goals)} goals for {len(robots)} robots: give as many goals as the group has robots"
                yield Refusal("settings.goals", message)
            else:
                yield from self._cut_off()
            return
        for name in s.goals:
            if name not in robots:
                message = f"{name} is not in the group: the group's robots are {', '.join(robots)}"
                yield Refusal(f"settings.goals.{name}", message)
        for robot in robots:
            if robot not in s.goals:
                yield Refusal("settings.goals", f"{robot} has no goal: add `{robot}: {{x_m: ..., y_m: ...}}`")
        if set(s.goals) == set(robots):
            yield from self._cut_off()

    def _cut_off(self) -> Iterator[Refusal]:
        """Yield goals to which no way leads from where the robots start."""
        starts = np.array([pose[:2] for pose in self.team.starts if pose is not None])
        if not self.team.keepout.solids or len(starts) < len(self.team):
            return
        problem = self._ways(starts, self._goals[:, :2].copy(), np.zeros((0, 3)))
        mend = f"a way must be {2 * self._edge:.2g} m wide: move the goal or an obstacle"
        if self.settings.assignment == "nearest":
            ways = _done(planning.ways(problem))
            for row, goal in enumerate(_shared_out(ways)):
                if not np.isfinite(ways[row, goal]):
                    robot = self.team.robots[row]
                    why = f"no way leads from {robot}'s start to a goal that is left for it past"
                    yield Refusal("settings.goals", f"{why} {self._named_solids()}: {mend}")
            return
        for row in planning.unreachable(problem):
            robot = self.team.robots[row]
            message = f"no way leads from {robot}'s start to its goal past {self._named_solids()}: {mend}"
            yield Refusal(f"settings.goals.{robot}", message)

    def _named_solids(self) -> str:
        return ", ".join("the floor's edge" if solid.floor else solid.name for solid in self.team.keepout.solids[:5])

    def bounds(self) -> Iterator[Bound]:
        names = list(self.settings.goals)
        if self.settings.assignment == "labelled":
            names = [name for name in names if name in self.team.robots]
        goals = [(name, np.array(self.settings.goals[name].pose)) for name in names]
        yield from _tightest(self._edge_of(name, goal) for name, goal in goals)
        yield from _tightest(bound for name, goal in goals for bound in self._beside(name, goal))
        yield from _tightest(bound for name, goal in goals for bound in self._beside_bystanders(name, goal))
        yield from _tightest(self._apart(*pair, *other) for pair, other in itertools.combinations(goals, 2))
        speed = self.settings.speed_m_s
        for robot, drive in zip(self.team.robots, self.team.drives, strict=True):
            if speed is not None:
                mend = f"{robot} drives no faster"
                yield Bound("settings.speed_m_s", "speed_m_s", speed, drive.max_speed, "m/s", mend)

    def _edge_of(self, name: str, goal: Array) -> Bound:
        left = (np.array(self.team.arena) / 2 - np.abs(self._barrier_point(goal))).min()
        edge = (
            max(from_edge(self.team.keepout, body) for body in self._bodies(name)) + self.settings.position_accuracy_m
        )
        mend = "the barrier keeps the robot from the arena's edge, so move the goal inwards"
        what = f"the distance of {name}'s goal from the edge"
        return Bound(f"settings.goals.{name}", what, float(left), edge, "m", mend, at_least=True)

    def _beside(self, name: str, goal: Array) -> Iterator[Bound]:
        keepout = self.team.keepout
        near = max(from_edge(keepout, body) for body in self._bodies(name))
        for solid, away in zip(
            keepout.solids, distances(keepout.solids, self._barrier_point(goal)[None])[:, 0], strict=True
        ):
            edge = "the floor's edge (floor_m)" if solid.floor else solid.name
            mend = f"the barrier keeps robots from {edge}, so move the goal" + ("" if solid.floor else f" or {edge}")
            what = f"the distance of {name}'s goal from {edge}"
            least = near + self.settings.position_accuracy_m
            yield Bound(f"settings.goals.{name}", what, float(away), least, "m", mend, at_least=True)

    def _beside_bystanders(self, name: str, goal: Array) -> Iterator[Bound]:
        keepout = self.team.keepout
        for robot, other, start in self.team.bystanders:
            if start is not None:
                away = math.dist(self._barrier_point(goal), start[:2]) - keepout.ahead
                near = max(apart(keepout, body, other) for body in self._bodies(name))
                mend = f"the barrier keeps robots from {robot}, so move the goal or {robot}"
                what = f"the distance of {name}'s goal from {robot}, which stands"
                yield Bound(f"settings.goals.{name}", what, away, near, "m", mend, at_least=True)

    def _apart(self, robot: str, goal: Array, other: str, other_goal: Array) -> Bound:
        keepout = self.team.keepout
        near = max(apart_at_rest(keepout, a, b) for a in self._bodies(robot) for b in self._bodies(other))
        near += 2 * self.settings.position_accuracy_m
        what = f"the distance of the goals of {robot} and {other}, {keepout.ahead:g} m ahead of the axles,"
        mend = "the barrier keeps bodies so far apart, so move one of them, or lower controller.barrier.ahead_m"
        away = float(np.hypot(*(self._barrier_point(goal) - self._barrier_point(other_goal))))
        return Bound(f"settings.goals.{other}", what, away, near, "m", mend, at_least=True)

    def _barrier_point(self, goal: Array) -> Array:
        """Return the point that the barrier keeps apart, of a robot at a goal [m]."""
        ahead, psi = self.team.keepout.ahead, goal[2]
        return np.asarray(goal[:2] + ahead * np.array([math.cos(psi), math.sin(psi)]))

    def _bodies(self, name: str) -> Sequence[Body]:
        """Return who may come to a goal."""
        if self.settings.assignment == "nearest":
            return self.team.bodies
        return (self.team.bodies[self.team.robots.index(name)],)

    def shapes(self) -> Sequence[Shape]:
        return (Dots("goals", self._goals[:, :2]),)

    def summary(self, past: Past) -> dict[str, Any]:
        """Return the figures, and what was left of them in the end."""
        figures = super().summary(past)
        for figure in self.figures[:2]:
            figures[f"final_{figure.shown_key}"] = statistics(past.figures[figure.name][-1:] * figure.scale)
        return figures | {"not_at_goal": self._not_at_goal(past)}

    def _not_at_goal(self, past: Past) -> dict[str, dict[str, float]] | None:
        """Return how far off the robots ended that are not at their goals as accurately as they should be, by id."""
        distance, turn = self.figures[:2]
        ends = np.array([past.figures[figure.name][-_THERE_TICKS:] for figure in (distance, turn)])
        if not ends.size or not np.isfinite(ends).all():
            return None
        off, angle = np.median(ends, axis=1)
        beyond = (off > self.settings.position_accuracy_m) | (angle > math.radians(self.settings.heading_accuracy_deg))
        return {
            self.team.robots[row]: {
                distance.shown_key: rounded(off[row] * distance.scale),
                turn.shown_key: rounded(angle[row] * turn.scale),
            }
            for row in np.flatnonzero(beyond)
        }


def _shared_out(ways: Array) -> Indices:
    """Return which goal each robot has, by its ways (N, N) [m] to them: one without a way only where all must be."""
    some = ways[np.isfinite(ways)]
    return planning.assign(np.where(np.isfinite(ways), ways, 1.0 + 2.0 * some.max(initial=0.0)))


def _done(work: Generator[None, None, Array]) -> Array:
    """Return what all parts of a work give."""
    while True:
        try:
            next(work)
        except StopIteration as done:
            found: Array = done.value
            return found


def _tightest(bounds: Iterable[Bound]) -> Iterator[Bound]:
    """Yield the bounds that do not hold; where all hold, the one that nearly does not."""
    found = sorted(bounds, key=lambda bound: -bound.tightness)
    broken = [bound for bound in found if not bound.holds]
    yield from broken or found[:1]
