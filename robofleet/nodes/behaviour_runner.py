"""What the groups decide in a tick; each group's failures are kept from all others."""

import sys
import traceback
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.behaviours import described
from robofleet.behaviours.interface import Behaviour, Decision, Situation, Wish
from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.safety.supervisor import Event, Phase

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Judge = Callable[[int, Callable[[], Decision]], tuple[Decision, bool]]

_BEHAVIOUR_ERRORS = Exception, SystemExit  # whatever a behaviour raises is its own failure
_BEYOND = 1e6  # [m/s, rad/s] no robot is asked for so much
_NOBODY = np.empty((0, 3))


def timed_by(stopwatch_ns: Callable[[], int], share_ns: float) -> Judge:
    """Return what calls a group's behaviour and judges by a stopwatch [ns] whether it took longer than its share."""

    def judge(group: int, decide: Callable[[], Decision]) -> tuple[Decision, bool]:
        began_ns = stopwatch_ns()
        decision = decide()
        return decision, stopwatch_ns() - began_ns > share_ns

    return judge


def untimed(group: int, decide: Callable[[], Decision]) -> tuple[Decision, bool]:
    """Call a group's behaviour where computing takes no time: in lockstep."""
    return decide(), False


class Decisions(NamedTuple):
    """What all groups decided in a tick, of N members."""

    velocities: Array  # (N, 2) as behaviours' ``Decision`` has them
    of_body: Flags  # (N,) whose are v [m/s] and omega [rad/s]; else the points' [m/s; world]
    driving: Flags  # (N,) who may drive, and whose behaviour has not failed
    numbers: Array  # references and figures, as ``behaviours.described`` reads them; the next tick writes them over


class BehaviourRunner:
    """The groups' behaviours; arrays over the members, group by group.

    On the way to the start and to the park one behaviour, ``go_to``, drives all members. A behaviour that raises,
    returns something of a wrong shape or not finite, or takes longer than its share of the tick is stopped: its robots
    stand, ``failed`` says why, and the traceback goes to stderr. It is asked again when the run is resumed.
    """

    def __init__(self, config: Config, judge: Judge = untimed) -> None:
        self._config, self._judge = config, judge
        self._tick_s = config.controller.tick_s
        self._rows = groups.rows(config.groups)
        self._radii = np.array([robot.vehicle.body_radius_m for robot in config.bodies])
        self.failed = np.zeros(len(config.members))  # Event by which a robot's behaviour failed
        group_descriptions = groups.descriptions(config)
        self._numbers = np.full(described.size(group_descriptions), np.nan)
        self._columns = [{figure.name: 2 + k for k, figure in enumerate(group.figures)} for group in group_descriptions]
        self._figures = [part[0] for part in described.parts(group_descriptions, self._numbers[None])]
        self.begin()

    def begin(self) -> None:
        """Know nothing: the behaviours are made anew."""
        self._behaviours = groups.behaviours(self._config)
        self._crew: list[tuple[Behaviour, slice]] = list(zip(self._behaviours, self._rows, strict=True))
        self._arrived = [False] * len(self._crew)
        self.phase = Phase.RUNNING  # whose behaviours these are
        self._ticks = -1  # of this phase in which somebody might drive
        self._forgive()

    @property
    def arrived(self) -> bool:
        """Whether every behaviour of this phase has done all that it was to do."""
        return self._ticks >= 0 and all(self._arrived)

    def restart(self, phase: Phase) -> None:
        """Begin a phase in which the robots move."""
        self.phase, self._ticks = phase, -1
        self._forgive()
        if phase is Phase.RUNNING:
            self._crew = list(zip(self._behaviours, self._rows, strict=True))
        else:
            self._crew = [(groups.on_the_way(self._config, phase), slice(0, len(self.failed)))]
        self._arrived = [False] * len(self._crew)
        for k, (behaviour, _) in enumerate(self._crew):
            self._notify(k, behaviour.restart)

    def resume(self) -> None:
        """Ask behaviours again that failed."""
        self._forgive()

    def _forgive(self) -> None:
        self._stopped: set[int] = set()  # rows of the crew that failed
        self.failed[:] = Event.NOTHING

    def carried(self, row: int) -> None:
        """Tell the behaviour of a robot that was carried away."""
        for k, (behaviour, own) in enumerate(self._crew):
            if own.start <= row < own.stop:
                self._notify(k, behaviour.carried, row - own.start)

    def changed(self, u: Array) -> Flags | None:
        """Tell what wheels and barrier let through of all velocities.

        Returns whose behaviours (N,) have failed; None where none failed over it.
        """
        u, stopped = u.copy(), len(self._stopped)
        for k, (behaviour, own) in enumerate(self._crew):
            self._notify(k, behaviour.changed, u[own])
        return self.failed != Event.NOTHING if len(self._stopped) > stopped else None

    def decide(
        self, bodies: Array, seen: Flags, driving: Flags, disturbance: Array, *, moving: bool,
        setpoints: Sequence[Wish | None] = (),
    ) -> Decisions:  # fmt: skip
        """Ask every behaviour.

        bodies (M, 3): poses of the members when the commands act, then of the bystanders; seen (M,): which of them ever
        were. driving (N,), disturbance (N, 2): of the members. ``moving``: time goes on for the behaviours.
        ``setpoints``: of the groups' scripts; none where empty.
        """
        self._ticks += moving
        self._numbers.fill(np.nan)
        velocities, of_body = np.zeros((len(driving), 2)), np.zeros(len(driving), dtype=np.bool_)
        situation = self._situations(bodies, seen, driving, disturbance, setpoints)
        for k, (_, own) in enumerate(self._crew):
            if k not in self._stopped and (answer := self._ask(k, situation(k), driving)) is not None:
                decision, velocities[own] = answer
                of_body[own] = decision.of == "body"
                self._keep(k, decision)
                if decision.hold is not None:
                    self._stop(k, 0, decision.hold, "holds the run")
        if self._stopped:
            driving = driving & (self.failed == Event.NOTHING)
        return Decisions(velocities, of_body, driving, self._numbers)

    def _situations(
        self, bodies: Array, seen: Flags, driving: Flags, disturbance: Array, setpoints: Sequence[Wish | None]
    ) -> Callable[[int], Situation]:
        """Return what tells by what each row of the crew decides."""
        poses, may, w = bodies[: len(driving)].copy(), driving.copy(), disturbance.copy()  # a behaviour may write there
        others, t = self._others(bodies, seen), max(0, self._ticks) * self._tick_s
        known = setpoints if self.phase is Phase.RUNNING else ()

        def situation(k: int) -> Situation:
            behaviour, own = self._crew[k]
            return Situation(
                t=t + behaviour.team.delay, poses=poses[own], driving=may[own], disturbance=w[own],
                others=others(own), wish=known[k] if known else None,
            )  # fmt: skip

        return situation

    def _others(self, bodies: Array, seen: Flags) -> Callable[[slice], Array]:
        """Return what tells a group who else is in the arena (M, 3): x, y, body radius [m]."""
        if len(self._crew) == 1 and len(self.failed) == len(bodies):
            return lambda own: _NOBODY
        everybody = np.column_stack([bodies[:, :2], self._radii])[seen]
        before = [0, *np.cumsum(seen).tolist()]  # so many of the first were seen
        return lambda own: np.concatenate([everybody[: before[own.start]], everybody[before[own.stop] :]])

    def _ask(self, k: int, situation: Situation, driving: Flags) -> tuple[Decision, Array] | None:
        """Return what a group decides, and its velocities as an array; None where it failed."""
        behaviour, own = self._crew[k]
        try:
            decision, late = self._judge(k, lambda: behaviour.decide(situation))
            if not isinstance(decision, Decision):
                self._fail(k, 0, Event.BEHAVIOUR_RAISED, f"{type(decision).__name__} instead of a Decision")
                return None
            velocities = np.asarray(decision.velocities, dtype=np.float64)
            if decision.of not in ("point", "body"):
                raise ValueError(f"of={decision.of!r}: must be 'point' or 'body'")
        except _BEHAVIOUR_ERRORS:
            self._raised(k)
            return None
        if velocities.shape != (own.stop - own.start, 2):
            self._fail(k, 0, Event.BEHAVIOUR_SHAPE, f"velocities of shape {velocities.shape}")
            return None
        within = np.vdot(velocities, velocities) < _BEYOND**2  # not so of NaN
        if not within and (unknown := ~(np.abs(velocities) < _BEYOND).all(axis=1) & driving[own]).any():
            row = int(unknown.argmax())
            self._fail(k, row, Event.BEHAVIOUR_NOT_FINITE, f"a velocity {velocities[row]}")
            return None
        if late:
            self._fail(k, 0, Event.BEHAVIOUR_LATE, "its decision after its share of the tick was over")
            return None
        return decision, velocities

    def _keep(self, k: int, decision: Decision) -> None:
        """Keep a decision's references and figures, and whether its behaviour has arrived."""
        try:
            if self.phase is Phase.RUNNING:
                self._keep_figures(k, decision)
            elif decision.references is not None:  # on the way no group decides: there are no figures
                for part, own in zip(self._figures, self._rows, strict=True):
                    part[:, :2] = decision.references[own]
            self._arrived[k] = bool(self._crew[k][0].arrived)
        except _BEHAVIOUR_ERRORS:
            self._raised(k)

    def _keep_figures(self, k: int, decision: Decision) -> None:
        group_figures, columns = self._figures[k], self._columns[k]
        if decision.references is not None:
            group_figures[:, :2] = decision.references
        for name, values in decision.figures.items():
            if name not in columns:
                raise ValueError(f"the figure {name!r} is none of its `figures`")
            group_figures[:, columns[name]] = values

    def _notify(self, k: int, hook: Callable[..., None], *arguments: Any) -> None:
        """Call an optional hook of a behaviour."""
        if k not in self._stopped:
            try:
                hook(*arguments)
            except _BEHAVIOUR_ERRORS:
                self._raised(k)

    def _raised(self, k: int) -> None:
        traceback.print_exc(file=sys.stderr)
        self._fail(k, 0, Event.BEHAVIOUR_RAISED, "nothing but this error")

    def _fail(self, k: int, row: int, why: Event, what: str) -> None:
        self._stop(k, row, why, f"returned {what}")

    def _stop(self, k: int, row: int, why: Event, what: str) -> None:
        """Let a group stand until the run is resumed."""
        behaviour, own = self._crew[k]
        team = behaviour.team
        self._stopped.add(k)
        self.failed[own] = Event.BEHAVIOUR_STANDS
        self.failed[own.start + row] = why
        line = f"group {team.name}, {team.robots[row]}: {type(behaviour).__name__} {what}: the group stands"
        print(line, file=sys.stderr)
