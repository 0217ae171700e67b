"""script: what a script of the user's own wishes, from a process of its own, tick by tick.

The newest wish is done for as long as it is fresh. A script that says nothing for longer is taken for dead, hung or
stopped: its robots stand at once, and the run is held. A script that was started, or started again, is waited for.
``robofleet.Fleet`` is what the script uses.
"""

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np

from robofleet.behaviours.go_to import Goal, GoTo
from robofleet.behaviours.interface import Behaviour, Decision, Figure, Past, Pose, Situation, Team, Wish, WishKind
from robofleet.core.arrays import Array, Flags
from robofleet.core.settings import Model, within
from robofleet.safety.supervisor import Event

_INNER = "wish_epoch", "wish", "arrived"  # figures for the script, not for people
_ROUNDING = 1e-9


class Script(Behaviour):
    """What a script wishes."""

    class Settings(Model):
        """How long a script may say nothing."""

        fresh_s: Annotated[float, within(0.05, 10)] = 0.1
        """Age at which a wish is too old: the group stands, and the run is held. The age counts from the controller's
        tick by which the script decided. A script whose loop takes longer than two ticks needs more."""

    settings: Settings
    takes_wishes = True
    figures = (
        Figure("wish_epoch", meaning="number of the script that drives the group", live=False),
        Figure("wish", meaning="number of the wish that is done", live=False),
        Figure("wish_age", "s", meaning="time since the tick by which the script decided"),
        Figure("arrived", meaning="number of the journey whose goals are reached; 0: none", live=False),
        Figure("distance_to_goal", "m", "mm", "distance of the centre from the goal of a journey"),
    )

    def __init__(self, settings: Settings, team: Team) -> None:
        super().__init__(settings, team)
        self._rehearsed = False
        self._done = False
        self._journey: _Journey | None = None
        self._stand = np.zeros((len(team), 2))

    def restart(self) -> None:
        self._done = False
        self._journey = None

    def carried(self, robot: int) -> None:
        if self._journey is not None:
            self._journey.carried(robot)

    def changed(self, velocities: Array) -> None:
        if self._journey is not None:
            self._journey.changed(velocities)

    @property
    def arrived(self) -> bool:
        """Whether the script said that it has done all."""
        return self._done

    def decide(self, now: Situation) -> Decision:
        if not self._rehearsed:
            self._rehearsed = True
            journey(self.team, dict.fromkeys(self.team.robots, (0.0, 0.0, 0.0))).rehearse()
        wish = now.wish
        if wish is None:
            self._journey = None
            return Decision(self._stand, "body")
        self._done = wish.kind is WishKind.DONE
        figures: dict[str, Array | float] = {
            "wish_epoch": wish.epoch, "wish": wish.seq, "wish_age": wish.age, "arrived": 0.0
        }  # fmt: skip
        if wish.kind is not WishKind.POSES:
            self._journey = None
        if wish.kind is WishKind.FAILED:
            return Decision(self._stand, "body", figures=figures, hold=Event.SCRIPT_FAILED)
        if wish.kind in (WishKind.STAND, WishKind.DONE):
            return Decision(self._stand, "body", figures=figures)
        if wish.age > self.settings.fresh_s + _ROUNDING:
            self._journey = None
            return Decision(self._stand, "body", figures=figures, hold=Event.SCRIPT_SILENT)
        if wish.kind is WishKind.POSES:
            return self._travel(now, wish, figures)
        return Decision(wish.values[:, :2], "body" if wish.kind is WishKind.BODY else "point", figures=figures)

    def _travel(self, now: Situation, wish: Wish, figures: dict[str, Array | float]) -> Decision:
        """Go on with a journey, or begin another one."""
        if self._journey is None or self._journey.name != (wish.epoch, wish.order):
            self._journey = _Journey(self.team, wish)
        decision, arrived = self._journey.decide(now)
        figures |= decision.figures
        figures["arrived"] = float(wish.order) if arrived else 0.0
        return decision._replace(figures=figures)

    def summary(self, past: Past) -> dict[str, Any]:
        """Return the figures that are for people."""
        return {key: value for key, value in super().summary(past).items() if key not in _INNER}


class _Journey:
    """A wish to go to poses: ``go_to`` of the robots that it is about; all others stand in their way."""

    def __init__(self, team: Team, wish: Wish) -> None:
        self.name = wish.epoch, wish.order
        self._rows: Flags = wish.told
        self._radii = np.array([body.radius for body in team.bodies])
        rows = np.flatnonzero(wish.told).tolist()
        x, y, psi = wish.values.T
        self._go_to = journey(team, {team.robots[k]: (float(x[k]), float(y[k]), float(psi[k])) for k in rows})
        self._go_to.rehearsed = True

    def carried(self, robot: int) -> None:
        if self._rows[robot]:
            self._go_to.carried(int(self._rows[:robot].sum()))

    def changed(self, velocities: Array) -> None:
        self._go_to.changed(velocities[self._rows])

    def decide(self, now: Situation) -> tuple[Decision, bool]:
        """Return what all robots of the group do, and whether those that travel are there."""
        rows, n = self._rows, len(self._rows)
        standing = np.column_stack([now.poses[~rows, :2], self._radii[~rows]])
        others = np.concatenate([standing, now.others])
        own = dataclasses.replace(
            now, poses=now.poses[rows], driving=now.driving[rows], disturbance=now.disturbance[rows], others=others
        )
        decision = self._go_to.decide(own)
        velocities, references, away = np.zeros((n, 2)), np.full((n, 2), np.nan), np.full(n, np.nan)
        velocities[rows] = decision.velocities
        away[rows] = decision.figures["distance_to_goal"]
        if decision.references is not None:
            references[rows] = decision.references
        return Decision(velocities, "body", references, {"distance_to_goal": away}), self._go_to.arrived


def journey(team: Team, goals: Mapping[str, Pose]) -> GoTo:
    """Return what brings robots of a team to poses x, y [m], psi [rad]; in the order of the team.

    ValueError where a goal is beyond what a configuration may say.
    """
    rows = [row for row, robot in enumerate(team.robots) if robot in goals]
    part = dataclasses.replace(
        team,
        robots=tuple(team.robots[row] for row in rows),
        drives=tuple(team.drives[row] for row in rows),
        bodies=tuple(team.bodies[row] for row in rows),
        starts=tuple(team.starts[row] for row in rows),
    )
    wanted = {
        robot: Goal(x_m=goals[robot][0], y_m=goals[robot][1], heading_deg=float(np.degrees(goals[robot][2])))
        for robot in part.robots
    }
    return GoTo(GoTo.Settings(goals=wanted), part)
