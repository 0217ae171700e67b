"""teleop: a person drives a robot by the page's stick, or by a gamepad, there or by ``robofleet teleop``; the others
follow it.

The group's first robot does what the person commands, up to the speeds that are set, while the stick is held: whoever
sends commands sends none without it. Each other robot follows the way of the robot ahead of it,
``spacing_m`` behind. All of them stand without a command, and when the newest one is too old.

In a held run the person may drive one robot of the group out, any of them, at a crawl: the others stand. Who permits
that is the supervisor (``safety/rescue.py``).
"""

import itertools
from collections import deque
from collections.abc import Iterator
from typing import Annotated, Any, NamedTuple

import numpy as np

from robofleet.behaviours.interface import Behaviour, Bound, Decision, Figure, Past, Situation, Team, WishKind
from robofleet.core.arrays import Array, Flags
from robofleet.core.settings import Model, within
from robofleet.safety.distances import apart

_ROUNDING = 1e-9
_INNER = "wish_epoch", "wish"  # figures for replays, not for people
_WAY_STEP_M = 0.005  # between two points of a way that are remembered


class Teleop(Behaviour):
    """What a person drives."""

    class Settings(Model):
        """How fast it goes, and how long the person's computer may say nothing."""

        max_speed_m_s: Annotated[float, within(0.001, 10)] = 0.1
        """Speed of the first robot with the stick fully forward."""
        max_turn_rad_s: Annotated[float, within(0.01, 100)] = 1.5
        """How fast it turns with the stick fully to the side."""
        crawl_m_s: Annotated[float, within(0.001, 0.1)] = 0.05
        """Speed at which a person drives one robot out of a held run; also how fast its wheels roll when it turns."""
        silent_s: Annotated[float, within(0.05, 10)] = 0.15
        """Age at which a command is too old: the robots stand until the next one. It counts from the controller's tick
        that the person's computer has seen last."""
        spacing_m: Annotated[float, within(0.01, 100)] = 0.25
        """Way from each other robot's point p to the point p of the robot ahead."""
        follow_rate: Annotated[float, within(0.01, 100)] = 2.0
        """How fast a follower closes a gap [1/s]: its speed per metre of gap."""

    settings: Settings
    takes_wishes = True
    figures = (
        Figure("command_age", "s", meaning="age of the person's newest command"),
        Figure("following_error", "m", "mm", "distance of p from its place on the way of the robot ahead"),
        Figure("wish_epoch", meaning="number of the hand that drives the group", live=False),
        Figure("wish", meaning="number of the command that is done", live=False),
    )

    def __init__(self, settings: Settings, team: Team) -> None:
        super().__init__(settings, team)
        self.restart()

    def restart(self) -> None:
        self._ways = [deque[Array]() for _ in self.team.robots[1:]]  # of each robot that another one follows

    def carried(self, robot: int) -> None:
        """Begin the ways anew that it was on, or that it led."""
        for k in (robot - 1, robot):
            if 0 <= k < len(self._ways):
                self._ways[k].clear()

    def decide(self, now: Situation) -> Decision:
        points, n = now.points(self.team.point_ahead), len(self.team)
        velocities, references = np.zeros((n, 2)), np.full((n, 2), np.nan)
        ages, errors = np.full(n, np.nan), np.full(n, np.nan)
        driven, command = self._command(now)
        ages[driven] = command.age
        counts = command.age <= self.settings.silent_s + _ROUNDING
        if counts:
            velocities[driven] = self._of_point(command, now.poses[driven, 2])
        figures: dict[str, Array | float] = {"command_age": ages, "following_error": errors}
        if now.wish is not None:
            figures |= {"wish_epoch": now.wish.epoch, "wish": now.wish.seq}
            if now.wish.kind is WishKind.RESCUE:
                self.carried(driven)
                return Decision(velocities, references=references, figures=figures)
        for k, way in enumerate(self._ways):
            goal = self._place(way, points[k], points[k + 1], now.driving[k : k + 2])
            references[k + 1], errors[k + 1] = goal, np.hypot(*(goal - points[k + 1]))
            if counts:
                velocities[k + 1] = self.settings.follow_rate * (goal - points[k + 1])
        return Decision(velocities, references=references, figures=figures)

    def _command(self, now: Situation) -> "tuple[int, _Command]":
        """Return the robot that is driven, and what it is to do."""
        wish, s = now.wish, self.settings
        if wish is None or wish.kind not in (WishKind.BODY, WishKind.RESCUE):
            return 0, _Command(0.0, 0.0, np.nan)
        out = wish.kind is WishKind.RESCUE
        row = int(wish.told.argmax()) if out else 0
        if not wish.told[row]:
            return row, _Command(0.0, 0.0, np.nan)
        own = float(wish.values[row, 2])
        age = wish.age + max(own, -self.team.tick)  # none is younger than the tick that it echoes
        v, omega = (float(value) for value in wish.values[row, :2])
        most_v, most_omega = min(s.crawl_m_s, s.max_speed_m_s) if out else s.max_speed_m_s, s.max_turn_rad_s
        return row, _Command(min(max(v, -most_v), most_v), min(max(omega, -most_omega), most_omega), age)

    def bounds(self) -> Iterator[Bound]:
        """Yield what must hold: every robot's top speed, and that the barrier lets followers come so near."""
        s, team = self.settings, self.team
        for robot, drive in zip(team.robots, team.drives, strict=True):
            mend = f"{robot} drives no faster"
            yield Bound("settings.max_speed_m_s", "max_speed_m_s", s.max_speed_m_s, drive.max_speed, "m/s", mend)
        for (front, ahead), (other, behind) in itertools.pairwise(zip(team.robots, team.bodies, strict=True)):
            near = (
                apart(team.keepout, ahead, behind)
                + 2 * min(s.max_speed_m_s, behind.drive.max_speed) / team.keepout.rate
            )
            mend = f"the barrier would hold {other} back from {front}, so raise it"
            yield Bound("settings.spacing_m", "spacing_m", s.spacing_m, near, "m", mend, at_least=True)

    def summary(self, past: Past) -> dict[str, Any]:
        """Return the figures that are for people."""
        return {key: value for key, value in super().summary(past).items() if key not in _INNER}

    def _of_point(self, command: "_Command", psi: float) -> Array:
        """Return the velocity of the point ahead [m/s; world]."""
        cos, sin, sideways = np.cos(psi), np.sin(psi), self.team.point_ahead * command.omega
        return np.array([command.v * cos - sideways * sin, command.v * sin + sideways * cos])

    def _place(self, way: deque[Array], ahead: Array, own: Array, driving: Flags) -> Array:
        """Return the place ``spacing_m`` behind a robot on its way; its follower's own where the way is shorter."""
        if not driving.all():
            return own
        if not way:
            way.append(own.copy())
        if np.hypot(*(ahead - way[-1])) >= _WAY_STEP_M:
            way.append(ahead.copy())
        left, newer = self.settings.spacing_m, ahead
        for k in range(len(way) - 1, -1, -1):
            piece = float(np.hypot(*(newer - way[k])))
            if piece >= left:
                for _ in range(k):
                    way.popleft()
                point_at: Array = newer + (way[0] - newer) * (left / piece)
                return point_at
            left, newer = left - piece, way[k]
        return own


class _Command(NamedTuple):
    """What a person commands; it counts while it is fresh."""

    v: float  # [m/s]
    omega: float  # [rad/s]
    age: float  # [s]; NaN: nothing was commanded
