"""A laboratory in which arming runs: plants behind gates that ramp, a controller that obeys, noisy images.

What may be wrong with it is an attribute, or is done to the view before arming sees it.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import ModuleType
from typing import ClassVar

import numpy as np

from robofleet.safety import arming
from robofleet.safety.arming import ArmingSettings, ArmingState, Stage
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import Event, Happening
from robofleet.safety.view import FleetView, RobotView
from robofleet.safety.wiggle import probe_speeds
from robofleet.vehicles.interface import STOP, WheelSpeeds
from robofleet.vehicles.plant import Plant
from tests.robots import GTERNAL, WORN

MS, S = 1_000_000, 1_000_000_000
BUILD, SESSION = 77, 5
BODY_M = 0.055
_STEP_NS, _STATUS_NS, _TICK_NS = 10 * MS, 20 * MS, 30 * MS
_RAMP = 1.5  # a step [rad/s]

Alter = Callable[[FleetView], FleetView]


class Lab:
    """Robots in a row, 0.3 m apart, or where they are put, heading every way."""

    program: ClassVar[ModuleType] = arming

    def __init__(
        self,
        robots: int = 3,
        seed: int = 1,
        faults: Mapping[int, Mapping[str, object]] | None = None,
        places: Sequence[tuple[float, float]] | None = None,
    ) -> None:
        rng = np.random.default_rng(seed)
        self.rng, self.now_ns, self.tick = rng, S, 0
        self.settings = ArmingSettings(
            BUILD, (0.016,) * robots, (0.105,) * robots, (BODY_M,) * robots,
            (0.3 * robots + 0.3, 1.0) if places is None else (99.0, 99.0),
        )  # fmt: skip
        places = places or [(0.3 * (row - (robots - 1) / 2), 0.0) for row in range(robots)]
        self.plants = [
            Plant(
                GTERNAL,
                replace(WORN, **(faults or {}).get(row, {})),  # type: ignore[arg-type]
                (*pose, float(rng.uniform(-math.pi, math.pi))),
                rng,
            )
            for row, pose in enumerate(places)
        ]
        self.tags = list(range(robots))  # whose body carries the tag of this row
        self.bodies = list(range(robots))  # which body the driver of this row reaches
        self.twins: dict[int, int] = {}  # body that also does what the driver of a row says
        self.encoders: dict[int, Callable[[float], float]] = {}  # what the left one makes of the truth
        self.silent_encoders = False
        self.stuck: set[int] = set()
        self.runaway: set[int] = set()  # what it was asked for last goes on
        self.deaf: set[int] = set()  # to the e-stop
        self.stubborn: set[int] = set()  # latched for ever
        self.obeys = True  # the controller
        self.start = True  # is asked for
        self.period_ns = 40 * MS  # of the supervisor
        self.noise = (0.0003, 0.0003, 0.004)
        self.alter: Alter = lambda view: view
        self.outputs = [STOP] * robots
        self.commanded: list[tuple[float, ...]] = [(0.0, 0.0)] * robots
        self.commands = [STOP] * robots
        self.state = self.program.begin(self.now_ns)
        self.stages: list[tuple[Stage, tuple[int, ...]]] = []  # with the strokes, as they came
        self.view = FleetView(
            self.now_ns,
            (RobotView(build=BUILD, session=SESSION),) * robots,
            controller_build=BUILD,
            tracker_build=BUILD,
        )

    def also(self, alter: Alter) -> None:
        """Alter the view once more before arming sees it."""
        before = self.alter
        self.alter = lambda view: alter(before(view))

    def arm(self, within_s: float = 200.0) -> Happening | None:
        """Run until arming has its verdict."""
        return self.run(within_s)

    def run(self, seconds: float, done: Callable[[ArmingState], bool] = lambda _: False) -> Happening | None:
        end_ns = self.now_ns + round(seconds * S)
        while self.now_ns < end_ns and not done(self.state):
            self.now_ns += _STEP_NS
            self._move()
            if self.now_ns % _STATUS_NS == 0:
                self._report()
            if self.now_ns % _TICK_NS == 0:
                self._tick()
            if self.now_ns % self.period_ns == 0:
                seen = self.alter(self.view._replace(now_ns=self.now_ns))
                self.state, happening = self.program.step(self.state, self.settings, seen, self.start)
                now = self.state.stage, self.state.wiggle.strokes
                if not self.stages or self.stages[-1] != now:
                    self.stages.append(now)
                if happening is not None:
                    return happening
        return None

    def _move(self) -> None:
        for row, body in enumerate(self.bodies):
            permitted = self.state.stroke(row) or row in self.runaway
            command = self.commands[row] if permitted else STOP
            self.outputs[row] = WheelSpeeds(*(_ramp(a, b) for a, b in zip(self.outputs[row], command, strict=True)))
            self.commanded[row] = tuple(
                a + 0.01 * b for a, b in zip(self.commanded[row], self.outputs[row], strict=True)
            )
            wheels = self.outputs[row]
            if (other := self.twins.get(body)) is not None and self.outputs[other] != STOP:
                wheels = self.outputs[other]
            self.plants[body].step(wheels, 0.01, blocked=body in self.stuck)

    def _report(self) -> None:
        robots = []
        for row, (body, seen) in enumerate(zip(self.bodies, self.view.robots, strict=True)):
            r = self.plants[body].reading()
            left = self.encoders.get(row, lambda angle: angle)(r.left_angle)
            moving = (r.left_angle, r.right_angle, r.left_speed, r.right_speed)
            moving = (0.0,) * 4 if self.silent_encoders else (left, *moving[1:])
            robots.append(seen._replace(heard_ns=self.now_ns, battery=r.battery, latch=self._latch(row, seen.latch)))
            robots[-1] = robots[-1]._replace(
                left_angle=moving[0], right_angle=moving[1], left_speed=moving[2], right_speed=moving[3],
                left_output=self.outputs[row].left, right_output=self.outputs[row].right,
                left_told=self.commanded[row][0], right_told=self.commanded[row][1],
            )  # fmt: skip
        self.view = self.view._replace(robots=tuple(robots))

    def _latch(self, row: int, latch: int) -> int:
        if self.state.latch and row not in self.deaf:
            return self.state.latch
        return Latch.NONE if self.state.clear and row not in self.stubborn else latch

    def _tick(self) -> None:
        """The controller's tick, and an image that is taken and seen at it."""
        self.tick += 1
        for row in range(len(self.plants)):
            wheels = WheelSpeeds(*probe_speeds(self.state.stroke(row), 0.016)) if self.obeys else STOP
            if wheels != STOP or row not in self.runaway:
                self.commands[row] = wheels
        bodies = [plant.truth()[:3] for plant in self.plants]
        image = self.view.image + 1
        poses = [
            tuple(a + s * self.rng.standard_normal() for a, s in zip(bodies[tag], self.noise, strict=True))
            for tag in self.tags
        ]
        self.view = self.view._replace(
            controller_ns=self.now_ns, tick=self.tick, tracker_ns=self.now_ns, image=image, image_tick=self.tick,
            robots=tuple(
                robot._replace(seen_ns=self.now_ns, image=image, pose=pose)
                for robot, pose in zip(self.view.robots, poses, strict=True)
            ),
        )  # fmt: skip


def _ramp(now: float, to: float) -> float:
    return now + min(_RAMP, max(-_RAMP, to - now))


def one(row: int, **fields: object) -> Alter:
    """Return what changes one robot's view."""

    def alter(view: FleetView) -> FleetView:
        robots = list(view.robots)
        robots[row] = robots[row]._replace(**fields)
        return view._replace(robots=tuple(robots))

    return alter


PROVED = Happening(Event.PROVED)
