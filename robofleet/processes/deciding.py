"""What the groups decide in a tick; each group's failures are kept from all others."""

import sys
import traceback
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from robofleet.behaviours import described
from robofleet.behaviours.interface import Behaviour, Decision, Situation
from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.control import wheels as wheel_limits
from robofleet.processes.fleet import drives
from robofleet.safety.supervisor import Event, Phase

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Judge = Callable[[int, Callable[[], Decision]], tuple[Decision, bool]]

_RAISED = Exception, SystemExit  # whatever a behaviour raises is its own failure
_BEYOND = 1e6  # [m/s, rad/s] no robot is asked for so much
SHARE = 0.5  # of a tick, for all groups together; the rest is the filter's, the barrier's and the bus's


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


class Deciding:
    """The groups' behaviours, and what they decided in the newest tick; arrays over the members, group by group.

    On the way to the start and to the park one behaviour, ``go_to``, drives all members. A behaviour that raises,
    returns something of a wrong shape or not finite, or takes longer than its share of the tick is stopped: its robots
    stand, ``failed`` says why, and the traceback goes to stderr. It is asked again when the run is resumed.
    """

    def __init__(self, config: Config, judge: Judge = untimed) -> None:
        self._config, self._judge = config, judge
        self._tick_s, self._l = config.controller.tick_s, config.controller.point_ahead_m
        self._rows = groups.rows(config.groups)
        self._limits = wheel_limits.limits(drives(config))
        self._radii = np.array([robot.vehicle.body_radius_m for robot in config.bodies])
        n = len(self._limits)
        self.u, self.wheels = np.zeros((n, 2)), np.zeros((n, 2))  # [m/s], [rad/s]
        self.points = np.zeros((n, 2))  # p when the commands act [m]
        self.saturated, self.failed = np.zeros(n), np.zeros(n)
        self._velocities, self._of_body = np.zeros((n, 2)), np.zeros(n, dtype=np.bool_)
        said = groups.descriptions(config)
        self.numbers = np.full(described.size(said), np.nan)  # as behaviours.described reads them
        self._names = [[figure.name for figure in group.figures] for group in said]
        self._told = [part[0] for part in described.parts(said, self.numbers[None])]
        self.begin()

    def begin(self) -> None:
        """Know nothing: the behaviours are made anew."""
        self._behaviours = groups.behaviours(self._config)
        self._crew: list[tuple[Behaviour, slice]] = list(zip(self._behaviours, self._rows, strict=True))
        self._arrived = [False] * len(self._crew)
        self.phase = Phase.RUNNING  # whose behaviours these are
        self._ticks = -1  # of this phase in which somebody might drive
        self.failed[:] = Event.NOTHING

    @property
    def arrived(self) -> bool:
        """Whether every behaviour of this phase has done all that it was to do."""
        return self._ticks >= 0 and all(self._arrived)

    def restart(self, phase: Phase) -> None:
        """Begin a phase in which the robots move."""
        self.phase, self._ticks = phase, -1
        self.failed[:] = Event.NOTHING
        if phase is Phase.RUNNING:
            self._crew = list(zip(self._behaviours, self._rows, strict=True))
        else:
            self._crew = [(groups.on_the_way(self._config, phase), slice(0, len(self.u)))]
        self._arrived = [False] * len(self._crew)
        for k, (behaviour, _) in enumerate(self._crew):
            self._heard(k, behaviour.restart)

    def resume(self) -> None:
        """Ask behaviours again that failed."""
        self.failed[:] = Event.NOTHING

    def carried(self, row: int) -> None:
        """Tell the behaviour of a robot that was carried away."""
        for k, (behaviour, own) in enumerate(self._crew):
            if own.start <= row < own.stop:
                self._heard(k, partial(behaviour.carried, row - own.start))

    def changed(self) -> None:
        """Tell what the barrier let through: ``u`` as it was changed."""
        for k, (behaviour, own) in enumerate(self._crew):
            self._heard(k, partial(behaviour.changed, self.u[own].copy()))

    def tick(self, bodies: Array, seen: Flags, driving: Flags, disturbance: Array, *, moving: bool) -> None:
        """Ask every behaviour; then find what the wheels can do of it.

        bodies (M, 3): poses of the members when the commands act, then of the bystanders; seen (M,): which of them ever
        were. driving (N,), disturbance (N, 2): of the members. ``moving``: time goes on for the behaviours.
        """
        n = len(self.u)
        self._ticks += moving
        self.numbers[:] = np.nan
        for k, (behaviour, own) in enumerate(self._crew):
            if not self.failed[own.start]:
                t = max(0, self._ticks) * self._tick_s + behaviour.team.delay
                others = self._others(bodies, seen, own)
                poses, may, w = bodies[own].copy(), driving[own].copy(), disturbance[own].copy()  # it may write there
                self._ask(k, Situation(t, poses, may, w, others))
        wheel_limits.commanded(
            self._velocities, self._of_body, bodies[:n], self._l, self._limits, driving & (self.failed == 0.0),
            self.u, self.wheels, self.saturated, self.points,
        )  # fmt: skip

    def _others(self, bodies: Array, seen: Flags, own: slice) -> Array:
        """Return who else is in the arena (M, 3): x, y, body radius [m]."""
        if own.stop - own.start == len(bodies):
            return np.empty((0, 3))
        other = seen.copy()
        other[own] = False
        return np.column_stack([bodies[:, :2], self._radii])[other]

    def _ask(self, k: int, now: Situation) -> None:
        behaviour, own = self._crew[k]
        try:
            decision, late = self._judge(k, lambda: behaviour.decide(now))
            velocities = np.asarray(decision.velocities, dtype=np.float64)
            if decision.of not in ("point", "body"):
                raise ValueError(f"of={decision.of!r}: must be 'point' or 'body'")
            if velocities.shape != (own.stop - own.start, 2):
                return self._fail(k, 0, Event.BEHAVIOUR_SHAPE, f"velocities of shape {velocities.shape}")
            known = np.abs(velocities) < _BEYOND
            if not known.all() and (unknown := ~known.all(axis=1) & now.driving).any():
                row = int(unknown.argmax())
                return self._fail(k, row, Event.BEHAVIOUR_NOT_FINITE, f"a velocity {velocities[row]}")
            if late:
                return self._fail(k, 0, Event.BEHAVIOUR_LATE, "its decision after its share of the tick was over")
            self._tell(k, decision)
            self._arrived[k] = bool(behaviour.arrived)
        except _RAISED:
            return self._raised(k)
        self._velocities[own], self._of_body[own] = velocities, decision.of == "body"
        return None

    def _tell(self, k: int, decision: Decision) -> None:
        """Keep a decision's references and figures; on the way, where no group decides, the references."""
        if self.phase is not Phase.RUNNING:
            for part, own in zip(self._told, self._rows, strict=True):
                if decision.references is not None:
                    part[:, :2] = decision.references[own]
            return
        told, names = self._told[k], self._names[k]
        if decision.references is not None:
            told[:, :2] = decision.references
        for name, values in decision.figures.items():
            if name not in names:
                raise ValueError(f"the figure {name!r} is none of its `figures`")
            told[:, 2 + names.index(name)] = values

    def _heard(self, k: int, hear: Callable[[], None]) -> None:
        """Let a behaviour hear something that it need not answer."""
        if not self.failed[self._crew[k][1].start]:
            try:
                hear()
            except _RAISED:
                self._raised(k)

    def _raised(self, k: int) -> None:
        traceback.print_exc(file=sys.stderr)
        self._fail(k, 0, Event.BEHAVIOUR_RAISED, "nothing but this error")

    def _fail(self, k: int, row: int, why: Event, what: str) -> None:
        behaviour, own = self._crew[k]
        team = behaviour.team
        self.u[own], self.wheels[own] = 0.0, 0.0
        self.failed[own] = Event.BEHAVIOUR_STANDS
        self.failed[own.start + row] = why
        said = f"group {team.name}, {team.robots[row]}: {type(behaviour).__name__} returned {what}: the group stands"
        print(said, file=sys.stderr)
