"""The platoon, Algorithm 1 of the paper: the leader follows the path on time, every other robot the one ahead of it.

The law itself is ``control/platoon.py``. Here is what a run needs around it: its settings, its places on the path,
what must hold before a run, and what is measured afterwards.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Annotated, Any, Literal

import numpy as np

from robofleet.behaviours import laps
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
    Start,
    Team,
    rounded,
    statistics,
)
from robofleet.behaviours.limits import inside, wheels
from robofleet.behaviours.paths import PathFile
from robofleet.control.platoon import INPUTS, REFERENCES, Column, PlatoonLaw, PlatoonSettings
from robofleet.core.arrays import Array, Flags
from robofleet.core.settings import Model, within
from robofleet.safety import starts
from robofleet.safety.distances import apart, from_edge
from robofleet.safety.starts import MOST_THROUGH, Ways, judge

_DRAWN_POINTS = 400
_START_POINTS_PER_SIDE = 100  # for judging a start
_FIGURES = (
    ("control_error", int(Column.CONTROL_ERROR)),
    ("estimated_path_error", int(Column.PATH_ERROR)),
    ("estimated_spacing", int(Column.SPACING)),
    ("reference_parameter", int(Column.REFERENCE_PARAMETER)),
)
_PLACE_POINTS = 2000  # points of a side, for places: a chord is then 0.1 um off its arc


class Platoon(Behaviour):
    """The robots follow one another on a closed path; the group's first robot leads."""

    class Settings(Model):
        """Settings of a platoon."""

        path: PathFile
        """Path that the leader follows."""
        spacing_m: Annotated[float, within(1e-3, 1000)]
        """Distance along the path from each robot's point p to the point p of the robot ahead (d in the paper)."""
        path_rate: Annotated[float, within(1e-6, 100)]
        """Speed of the leader's reference, in sides of the path per second (gamma in the paper)."""
        track: Literal["point", "centre"] = "point"
        """What follows the path. ``point``: the point p, which is ``point_ahead_m`` ahead of the axle. ``centre``: the
        robot's centre."""

    settings: Settings
    figures = (
        Figure("control_error", "m", "mm", "the controller's residual before its update"),
        Figure("estimated_path_error", "m", "mm", "distance of p from the path, of the estimated pose"),
        Figure("estimated_spacing", "m", "mm", "distance of p from the predecessor's, of the estimated poses"),
        Figure("reference_parameter", "", "", "where on the path the reference is [sides]", live=False),
    )

    def __init__(self, settings: Settings, team: Team) -> None:
        super().__init__(settings, team)
        self._path = settings.path.path()
        flow = team.flow
        self._law = PlatoonLaw(
            self._path,
            PlatoonSettings(
                flow.alpha, flow.horizon, team.point_ahead, settings.spacing_m, settings.path_rate, team.tick,
                flow.integrator, settings.track,
            ),
            team.drives,
        )  # fmt: skip

    # At each tick

    def decide(self, now: Situation) -> Decision:
        """Return Algorithm 1's inputs."""
        law_row = self._law.tick(now.t, now.poses, now.driving, now.disturbance)
        figures = {name: law_row[:, column] for name, column in _FIGURES}
        return Decision(law_row[:, INPUTS], references=law_row[:, REFERENCES], figures=figures)

    def restart(self) -> None:
        self._law.restart()

    def by_point_flow(self) -> bool:
        return True

    def changed(self, velocities: Array) -> None:
        """Predict by what the robots do, not by what was asked."""
        self._law.changed(velocities)

    def carried(self, robot: int) -> None:
        """Search the whole path for it."""
        self._law.carried(robot)

    # Before a run

    def places(self) -> Sequence[Pose]:
        """Return the places on the path, the leader's first, to 0.1 mm; fewer where it is too short."""
        sigma, found = 0.0, []
        for _ in self.team.robots:
            if not math.isfinite(sigma):
                break
            at, along = self._path.position(sigma), self._path.derivative(sigma)
            if not (length := math.hypot(*along)) > 0.0:
                break
            x, y = at - self._ahead * along / length
            heading = round(math.degrees(math.atan2(along[1], along[0])), 2)
            found.append((round(float(x), 4), round(float(y), 4), math.radians(heading)))
            sigma = self._back(sigma)
        return found

    def start(self, poses: Sequence[Pose]) -> Start:
        """Judge whether the robots come from these poses to their places without jamming."""
        ways = self.ways()
        found, why = judge(ways, tuple(poses)), starts.reason(ways, tuple(poses))
        k = max(range(len(poses)), key=lambda i: (found.arrived_s[i], found.away_m[i]))
        return Start(
            why,
            found.arrived_s,
            (
                (f"the way of {self.team.robots[k]} to its place on the path", f"{found.away_m[k]:.2f} m", "", ""),
                (
                    "how far robots that start would drive through each other, in body widths",
                    f"{found.through:.1f}", f"≤ {MOST_THROUGH:g}", f"{found.through / MOST_THROUGH:.0%}",
                ),
            ),
            tuple(self._slow_starts(found)),
        )  # fmt: skip

    def _slow_starts(self, found: starts.Judgement) -> Iterator[tuple[float, str]]:
        for robot, away_m, late_s in zip(self.team.robots, found.away_m, found.arrived_s, strict=True):
            takes = f"about {late_s:.0f} s" if math.isfinite(late_s) else "more than 25 s"
            yield late_s, f"{robot} starts {away_m:.2f} m from its place and needs {takes} to it"
        if found.through > 0.0 and not found.jams:
            first, other = (self.team.robots[i] for i in found.pair)
            yield (
                math.inf,
                f"the ways of {first} and {other} to their places meet: they may wait for each other, or jam",
            )

    def ways(self) -> Ways:
        """Return what a start is judged by."""
        sides, team, s = self._path.sides, self.team, self.settings
        points = self._path.position(np.arange(sides * _START_POINTS_PER_SIDE) / _START_POINTS_PER_SIDE)
        gaps = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
        k = np.arange(len(points))
        far = gaps[k[:, None], k[:, None] - k[None]] >= s.spacing_m  # [point, steps back]
        return Ways(
            points, (k - far.argmax(axis=1)) % len(points), sides, s.spacing_m, s.path_rate, team.flow.horizon,
            self._ahead, tuple(d.max_speed for d in team.drives), tuple(b.radius for b in team.bodies),
        )  # fmt: skip

    def bounds(self) -> Iterator[Bound]:
        """Yield what must hold: the path inside the arena, the wheels' speeds on it, the spacing, room beside it."""
        s, team = self.settings, self.team
        mend = "the point must be much closer to its robot than the next robot is, so lower it or raise spacing_m"
        half = s.spacing_m / 2
        yield Bound("controller.point_ahead_m", "point_ahead_m", team.point_ahead, half, "m", mend)
        lap = laps.drive_lap(self._path, s.path_rate, team.point_ahead, centre_tracked=s.track == "centre")
        cusp = laps.no_cusp(lap, "settings.path")
        yield cusp
        widest = max(range(len(team)), key=lambda row: from_edge(team.keepout, team.bodies[row]))
        yield from inside(
            team, widest, "settings.path", lap.position, lambda k: f"at parameter {lap.sigma[k]:.2f}",
            who="the path", mend="move its knots inwards",
        )  # fmt: skip
        for drive in dict.fromkeys(team.drives) if cusp.holds else ():
            first = team.drives.index(drive)
            yield from wheels(team, first, "settings.path_rate", (lap.v, lap.omega), partial(_where, lap), self._slower)
        yield from self._spacing(lap)
        yield from self._clear_of_the_path(lap)

    def _slower(self, share: float) -> str:
        return f"path_rate {laps.rounded_down(share * self.settings.path_rate):g} fits"

    def _spacing(self, lap: laps.Lap) -> Iterator[Bound]:
        team, spacing, length = self.team, self.settings.spacing_m, self._path.length()
        key = "settings.spacing_m"
        if len(team) > 1:
            far = lap.position[:: laps.STEPS // 100]
            reach = np.linalg.norm(far[:, None] - far[None], axis=-1).max(axis=1)
            k = int(reach.argmin())
            fits = laps.rounded_down(float(reach[k]))
            mend = f"no point of the path is so far from parameter {k / 100:.2f}, so a spacing of {fits:g} fits"
            yield Bound(key, "spacing_m on this path", spacing, float(reach[k]), "m", mend, strict=True)
        mend = f"a spacing of {laps.rounded_down(length / len(team)):g} fits"
        what = "the platoon with a gap behind it, spacing_m a robot,"
        yield Bound(key, what, len(team) * spacing, length, "m", mend, strict=True)
        for (front, ahead), (other, behind) in itertools.pairwise(zip(team.robots, team.bodies, strict=True)):
            fastest = min(float(np.abs(lap.v).max()), behind.drive.max_speed)
            near = apart(team.keepout, ahead, behind) + 2 * fastest / team.keepout.rate
            mend = f"the barrier would hold {other} back from {front}, so raise it"
            yield Bound(key, "spacing_m", spacing, near, "m", mend, at_least=True)

    def _clear_of_the_path(self, lap: laps.Lap) -> Iterator[Bound]:
        """A robot in no group stands where the barrier lets every robot pass on its lap."""
        for robot, body, start in self.team.bystanders:
            if start is not None:
                distances = np.hypot(lap.centre[:, 0] - start[0], lap.centre[:, 1] - start[1])
                k = int(distances.argmin())
                near = max(apart(self.team.keepout, member, body) for member in self.team.bodies)
                mend = f"the robots pass it at path parameter {lap.sigma[k]:.2f}, so park {robot} further away"
                what = "the distance of a robot that is not in the group from the path"
                yield Bound(f"{robot}.start", what, float(distances[k]), near, "m", mend, at_least=True)

    def refusals(self) -> Iterator[Refusal]:
        """Yield a start that would jam: who is in whose way, and what to do."""
        poses = [pose for pose in self.team.starts if pose is not None]
        if len(poses) < len(self.team) or (why := starts.reason(self.ways(), tuple(poses))) is None:
            return
        ids = self.team.robots
        first, other = ids[why.behind], ids[why.other]
        if why.order is not None:
            order = ", ".join(ids[i] for i in why.order)
            yield Refusal(
                "robots",
                f"{first} stands ahead of {other}, and the group's order is {', '.join(ids)}: exchange their starts, "
                f"or write `robots: [{order}]`",
            )
            return
        x, y, psi = self.places()[why.other]
        yield Refusal(
            f"{other}.start",
            f"{other} and {first} are in each other's way to their places on the path: leave `start` out, or bring "
            f"{other} to x_m {x:g}, y_m {y:g}, heading_deg {round(math.degrees(psi), 2):g}",
        )

    def shapes(self) -> Sequence[Line]:
        lap = self._path.position(np.linspace(0.0, self._path.sides, _DRAWN_POINTS, endpoint=False))
        return (Line("path", lap, closed=True, directed=True),)

    # After a run

    def measures(self, past: Past) -> Sequence[Measure]:
        """Return the paper's errors, of the true poses, and the distances between successive points."""
        robots = self.team.robots
        pairs = tuple(f"{front} to {other}" for front, other in itertools.pairwise(robots))
        spacing = np.linalg.norm(np.diff(past.points, axis=1), axis=-1)
        unknown = np.full(past.points.shape[:2], np.nan)
        path, timed, centre = (unknown,) * 3
        if past.known.any() and len(past.t):
            at = self._nearest(past.points)
            path = np.where(past.known, self._off(past.points, at), np.nan)
            timed = np.where(self._followed(past), self._timed(past, at), np.nan)
            centre = np.where(past.known, self._off(past.poses[..., :2], self._nearest(past.poses[..., :2])), np.nan)
        errors = (
            Measure("timed_error", "m", timed, robots, "mm", "true distance of p from where it should be now"),
            Measure("path_error", "m", path, robots, "mm", "true distance of p from the path"),
            Measure("centre_error", "m", centre, robots, "mm", "true distance of the centre from the path"),
            Measure(
                "spacing", "m", spacing, pairs, "mm", "distance of p from the predecessor's: true, else as estimated",
                asked=self.settings.spacing_m,
            ),
        )  # fmt: skip
        return tuple(measure._replace(counts=past.spaced) for measure in errors)

    def summary(self, past: Past) -> dict[str, Any]:
        """Return the errors as the paper states them; true errors and the spacing count after a longer time."""
        timed, path, centre, spacing = (measure.values[past.spaced] for measure in self.measures(past))
        known = np.isfinite(spacing)
        deviation = np.abs(spacing - self.settings.spacing_m)
        gaps = {
            "mean": [
                rounded(column[np.isfinite(column)].mean(), 5) if np.isfinite(column).any() else None
                for column in spacing.T
            ],
            "max_deviation_mm": rounded(deviation[known].max() * 1e3) if known.any() else None,
        }
        return {
            "control_error_mm": statistics(past.figures["control_error"][past.settled] * 1e3),
            "timed_error_mm": statistics(timed * 1e3),
            "path_error_mm": statistics(path * 1e3),
            "centre_error_mm": statistics(centre * 1e3),
            "spacing_m": gaps if known.any() else None,
        }

    def _followed(self, past: Past) -> Flags:
        """Return of whom the truth is known, and of the robot ahead as well (N,)."""
        return np.asarray(past.known & np.concatenate([[True], past.known[:-1]]))

    def _timed(self, past: Past, at: Array) -> Array:
        """Return the distances (K, N) of p from where it should be now: r(gamma t), or d back from the one ahead [m].

        The leader's recorded parameter is where it should be a horizon after the tick's commands act; it tells also
        from where on the lap the run counts. ``at`` (K, N): the parameters nearest to the points.
        """
        s, team = self.settings, self.team
        centre_tracked = s.track == "centre"
        if centre_tracked:
            at = self._nearest(past.poses[..., :2])
        should = np.empty(past.points.shape[:2])
        ahead_s = team.flow.horizon + team.delay
        should[:, 0] = (past.figures["reference_parameter"][:, 0] - s.path_rate * ahead_s) % self._path.sides
        for i in range(1, len(self.team)):
            should[:, i] = self._path.back(at[:, i - 1], s.spacing_m)
        target = self._path.position(should)
        if centre_tracked:
            target = target + team.point_ahead * self._path.tangent(should)
        return np.asarray(np.linalg.norm(past.points - target, axis=-1))

    def _nearest(self, points: Array) -> Array:
        return self._path.nearest(points.reshape(-1, 2)).reshape(points.shape[:2])

    def _off(self, points: Array, at: Array) -> Array:
        return np.asarray(np.linalg.norm(points - self._path.position(at), axis=-1))

    @property
    def _ahead(self) -> float:
        """What follows the path is so far ahead of the centre [m]."""
        return self.team.point_ahead if self.settings.track == "point" else 0.0

    def _back(self, sigma: float) -> float:
        """Return the first parameter going back whose point is ``spacing_m`` away; infinite where there is none."""
        spacing = self.settings.spacing_m
        back = sigma - np.arange(1 + self._path.sides * _PLACE_POINTS) / _PLACE_POINTS
        points = self._path.position(back)
        gaps = np.hypot(*(points - points[0]).T)
        k = int((gaps >= spacing).argmax())
        if k == 0:
            return -math.inf
        share = (spacing - gaps[k - 1]) / (gaps[k] - gaps[k - 1])
        return float(back[k - 1] + share * (back[k] - back[k - 1]))


def _where(lap: laps.Lap, k: int) -> str:
    return f"at path parameter {lap.sigma[k]:.2f}"
