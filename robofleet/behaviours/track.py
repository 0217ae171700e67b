"""Track: each robot follows a reference in time of its own, by the Newton-Raphson flow.

``point_ahead`` is eq. 31: the point ahead moves as it is asked, so its prediction is p + T (u + w). ``unicycle`` is the
general law (eqs 8 to 14) with the unicycle's own prediction, an arc: the centre follows; v and omega are the inputs.
Both predict with w, what the filter estimates that the wheels do beyond what they are asked, so that no offset is left
where it is constant.
"""

import math
from collections.abc import Iterator
from functools import partial
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from robofleet.behaviours.interface import (
    Behaviour,
    Bound,
    Decision,
    Figure,
    Line,
    Measure,
    Past,
    Pose,
    Refusal,
    Situation,
    Team,
)
from robofleet.behaviours.limits import inside, wheels
from robofleet.behaviours.references import Reference, fastest_along
from robofleet.control.flow import FlowSettings, NewtonRaphsonFlow
from robofleet.control.point import PointFlow
from robofleet.control.trajectory import demanded
from robofleet.control.unicycle import unicycle_plant
from robofleet.core.arrays import Array
from robofleet.core.settings import ROBOTS, Model, Name
from robofleet.vehicles.differential_drive import DifferentialDrive, arc, body_from_point

_CHECK_STEP_S = 0.01  # between the instants of a reference that are looked at before a run
_SLOWEST_SHARE = 0.05  # of the top speed: a unicycle's flow keeps v above that, where it can still choose its way
_TRUSTED_SHARE = 0.5  # of the way that is driven in a horizon: so far from its end a Newton step may lead
_TURN = 0.9 * math.pi  # over a horizon, at most: what lies behind is not on an arc [rad]


class Track(Behaviour):
    """Robots that follow their references."""

    class Settings(Model):
        """The law, and each robot's reference."""

        law: Literal["point_ahead", "unicycle"] = "point_ahead"
        """``point_ahead``: the point ahead follows the reference. ``unicycle``: the robot's centre follows it."""
        references: Annotated[dict[Name, Reference], Field(min_length=1, max_length=ROBOTS)]
        """Reference of each robot, by its id."""

    figures = (Figure("control_error", "m", "mm", "Distance of the prediction from the reference (|r - g|)."),)

    def __init__(self, settings: Settings, team: Team) -> None:
        super().__init__(settings, team)
        self._ahead = team.point_ahead if settings.law == "point_ahead" else 0.0
        refused = any(self.refusals())
        given = [] if refused else [(settings.references[name], team.drives[i]) for i, name in enumerate(team.robots)]
        self._ways = [reference.trajectory(drive, self._ahead) for reference, drive in given]
        self._law = _Points(team) if settings.law == "point_ahead" else _Unicycles(team)

    def restart(self) -> None:
        self._law.restart()

    def by_point_flow(self) -> bool:
        return bool(self.settings.law == "point_ahead")

    def changed(self, velocities: Array) -> None:
        self._law.changed(velocities)

    def decide(self, now: Situation) -> Decision:
        here, ahead = (np.array([way.at(t) for way in self._ways]) for t in (now.t, now.t + self.team.flow.horizon))
        velocities, error = self._law.update(now, ahead)
        return Decision(velocities, self._law.of, here, {"control_error": error})

    def places(self) -> list[Pose] | None:
        """Return centres from which what follows is at the reference's beginning, and moves ahead."""
        if not self._ways:
            return None  # refused
        begins, headings = self._at(np.zeros(1))[:, 0], np.array([way.heading() for way in self._ways])
        centres = begins - self._ahead * np.column_stack([np.cos(headings), np.sin(headings)])
        return [(x, y, psi) for (x, y), psi in zip(centres.tolist(), headings.tolist(), strict=True)]

    def refusals(self) -> Iterator[Refusal]:
        """Yield robots without a reference, references without a robot, and what is wrong with one."""
        given = self.settings.references
        for i, robot in enumerate(self.team.robots):
            if robot not in given:
                yield Refusal(f"robots.{i}", f"{robot} has no reference: add {robot} to settings.references")
        for robot, reference in given.items():
            key = f"settings.references.{robot}"
            if robot not in self.team.robots:
                yield Refusal(key, f"{robot} is not in the group: remove its reference, or add {robot} to robots")
            yield from reference.refusals(key)

    def bounds(self) -> Iterator[Bound]:
        """Yield whether each reference is in the arena, and slow enough for the wheels."""
        for i, way in enumerate(self._ways):
            robot = self.team.robots[i]
            reference, key = self.settings.references[robot], f"settings.references.{robot}"
            t, v, omega, _ = demanded(way, self._ahead, _CHECK_STEP_S)
            where = partial(_where, t)
            yield from inside(self.team, i, f"{key}.{reference.kind}", way.position(t), where)
            yield from self._bends(i, reference, key)
            yield from wheels(self.team, i, f"{key}.{reference.speed_key}", (v, omega), where, reference.slower)

    def shapes(self) -> list[Line]:
        lines = []
        for robot, way in zip(self.team.robots, self._ways, strict=True):
            points = way.position(np.concatenate([way.instants(0.1, 1000), [way.end - way.begin]]))
            lines.append(Line(robot, points, way.closed, directed=True))
        return lines

    def measures(self, past: Past) -> list[Measure]:
        """Return how far what follows was in truth from where it was to be at that instant."""
        followed = past.points if self._ahead else past.poses[:, :, :2]
        off = followed - self._at(past.t).transpose(1, 0, 2)
        error = np.where(past.known, np.linalg.norm(off, axis=-1), np.nan)
        meaning = "Distance of the true robot from its reference at the same instant."
        return [Measure("timed_error", "m", error, self.team.robots, "mm", meaning, counts=past.spaced)]

    def _at(self, t: Array) -> Array:
        """Return every robot's reference at instants (M,), shape (N, M, 2) [m]."""
        return np.array([way.position(t) for way in self._ways])

    def _bends(self, robot: int, reference: Reference, key: str) -> Iterator[Bound]:
        """Yield whether a way through way points is slow enough, and its bends are wide enough."""
        if reference.speed_m_s is None or (tightest := reference.tightest_m()) is None:
            return
        drive = self.team.drives[robot]
        mend = "the law needs the rest of the wheels' speed to steer, so lower it"
        yield Bound(f"{key}.speed_m_s", "speed_m_s", reference.speed_m_s, fastest_along(drive), "m/s", mend)
        mend = "that is half the wheel base, tighter a wheel turns backwards; so move the way points apart, or add some"
        what = "the radius of the sharpest bend"
        yield Bound(f"{key}.waypoints_m", what, tightest, drive.wheel_base / 2, "m", mend, at_least=True)


def _where(t: Array, k: int) -> str:
    return f"at {t[k]:.4g} s"


class _Points:
    """Eq. 31 for the points ahead."""

    of: Literal["point"] = "point"

    def __init__(self, team: Team) -> None:
        self._ahead = team.point_ahead
        self._flow = PointFlow(len(team), team.flow.alpha, team.flow.horizon, team.tick, team.flow.integrator)

    def restart(self) -> None:
        self._flow.u[:] = 0.0

    def changed(self, velocities: Array) -> None:
        self._flow.u[:] = velocities

    def update(self, now: Situation, references: Array) -> tuple[Array, Array]:
        return self._flow.update(now.points(self._ahead), references, now.driving, now.disturbance)


class _Unicycles:
    """Eq. 14 for the bodies."""

    of: Literal["body"] = "body"

    def __init__(self, team: Team) -> None:
        self._ahead, self._horizon = team.point_ahead, team.flow.horizon
        self._psi = np.zeros(len(team))
        self._slowest = [_SLOWEST_SHARE * drive.max_speed for drive in team.drives]
        self._flows = [
            self._made(team, drive, slowest) for drive, slowest in zip(team.drives, self._slowest, strict=True)
        ]

    @staticmethod
    def _made(team: Team, drive: DifferentialDrive, slowest: float) -> NewtonRaphsonFlow:
        fastest = min(_TURN / team.flow.horizon, 2 * drive.wheel_radius * drive.max_wheel_speed / drive.wheel_base)
        settings = FlowSettings(
            team.flow.alpha, team.flow.horizon, team.tick, team.flow.integrator,
            lower=(slowest, -fastest), upper=(drive.max_speed, fastest),
        )  # fmt: skip
        return NewtonRaphsonFlow(unicycle_plant(), settings, (slowest, 0.0))

    def restart(self) -> None:
        for flow, slowest in zip(self._flows, self._slowest, strict=True):
            flow.applied((slowest, 0.0))

    def changed(self, velocities: Array) -> None:
        for i, flow in enumerate(self._flows):
            v, omega = self._body(i, velocities)
            flow.applied((max(v, self._slowest[i]), omega))

    def update(self, now: Situation, references: Array) -> tuple[Array, Array]:
        """Return v and omega (N, 2), and |r - g| (N,) [m].

        A robot stands where its reference at the horizon is nearer than it would drive at its slowest.
        """
        inputs, error = np.zeros((len(self._flows), 2)), np.zeros(len(self._flows))
        self._psi = now.poses[:, 2].copy()
        for i, flow in enumerate(self._flows):
            distance = math.dist(references[i], now.poses[i, :2])
            if not now.driving[i] or distance < self._slowest[i] * self._horizon:
                error[i] = distance
                continue
            (v, omega), (slip, spin) = flow.u.tolist(), self._body(i, now.disturbance)
            x, y, psi = now.poses[i].tolist()
            end = np.array(arc(x, y, psi, v + slip, omega + spin, self._horizon)[:2])
            missing = references[i] - end
            error[i] = math.hypot(*missing)
            trusted = min(1.0, _TRUSTED_SHARE * abs(v) * self._horizon / max(error[i], 1e-9))
            inputs[i] = flow.update(np.array([x, y, psi, slip, spin]), end + trusted * missing)
        return inputs, error

    def _body(self, i: int, velocities: Array) -> tuple[float, float]:
        """Return v and omega of a robot, from its point's velocity."""
        return body_from_point(float(velocities[i, 0]), float(velocities[i, 1]), float(self._psi[i]), self._ahead)
