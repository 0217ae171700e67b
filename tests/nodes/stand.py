"""A supervisor on a bench: drivers with gates, a controller and a tracker that talk unless they are silenced."""

from collections.abc import Callable
from typing import Any

import numpy as np

from robofleet.bus.bus import Answer, Inbox
from robofleet.bus.keys import CAMERA, ENABLE, NEWS, POSES, REQUEST, STATE, STATUS, TICK
from robofleet.bus.messages import FleetPoses, RobotTick, RunState, TagPose, TickRecord, TrackerNews
from robofleet.config import slices
from robofleet.core.clock import MS, S
from robofleet.nodes.supervisor import Supervisor
from robofleet.safety import arming
from robofleet.safety.arming import ArmingSettings, ArmingState, Stage
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import Event, Happening, Phase
from robofleet.safety.view import FleetView, Machine, Turns
from robofleet.tracking.events import NO_TAG, TrackerEvent
from tests.bus.alone import ENABLE as ENABLE_LAYOUT
from tests.bus.alone import Enable, RobotStatus

ROBOTS = ("r1", "r2", "r3", "r4")
PLACES = ((-1.0, 0.0, 0.0), (-0.5, 0.0, 0.0), (0.0, 0.0, 0.0), (0.5, 0.0, 0.0))


def proved(
    state: ArmingState, _settings: ArmingSettings, view: FleetView, start: bool
) -> tuple[ArmingState, Happening | None]:
    """Stand in for the checks before a start: everybody is there."""
    if not (view.controller_ns and view.tracker_ns and all(r.heard_ns and r.seen_ns for r in view.robots)):
        return state, None
    return state._replace(stage=Stage.DONE), Happening(Event.PROVED) if start else None


class Robot:
    """A driver with a gate that latches and is cleared as it is told, unless it is deaf."""

    def __init__(self, boot_id: int) -> None:
        self.boot_id, self.nonce = boot_id, 0
        self.latch = Latch.NONE
        self.latch_id = 0
        self.deaf = False
        self.clock_ns = 0  # when its clock began
        self.says: dict[str, Any] = {}  # fields of its status

    def hear(self, enable: Enable) -> None:
        if self.deaf or enable.boot_id != self.boot_id:
            return
        if enable.latch > self.latch:
            self.latch, self.latch_id = Latch(enable.latch), self.latch_id + 1
        elif self.latch and not enable.latch and enable.clear == self.latch_id:
            self.latch = Latch.NONE

    def status(self, now_ns: int, build: int) -> RobotStatus:
        self.nonce = now_ns - self.clock_ns
        healthy = RobotStatus(
            1, 1, build, 5, self.boot_id, self.nonce, self.nonce, 0, 0, 0, 0, self.latch, self.latch_id, 0, 0, -1, -1,
            *(0.0,) * 8, 1.0,
        )  # fmt: skip
        return healthy._replace(**self.says)


class Stand:
    """``run`` lets everybody talk; what a test changes in between is seen by the supervisor as it would be."""

    def __init__(
        self, bench: Any, *, attended: bool = False, prove: Any = proved, contended: float | None = None,
        counted: bool = False,
    ) -> None:  # fmt: skip
        """``contended``: the share of the time in which no core is free; None: nobody measures that.

        ``counted``: the processes' turns are, and who is in ``stuck`` takes none.
        """
        self.bench = bench
        self.build, self._counted = slices.build(bench.config), counted
        self.robots = {robot: Robot(100 + row) for row, robot in enumerate(ROBOTS)}
        self.tags = {robot.id: robot.tag for robot in bench.config.members}
        self.places = dict(zip(ROBOTS, PLACES, strict=True))
        self.silent: set[str] = set()  # of the robots, "controller", "tracker", "operator"
        self.stuck: set[str] = set()
        self._turns = {name: Turns(0, 0) for name in ("supervisor", "controller", "tracker", *ROBOTS)}
        self.hidden: set[str] = set()  # robots whose tags are not seen
        self.stopped: dict[str, float] = {}  # fields of every robot's tick
        self.free_bytes = 1 << 40
        self.lines: list[str] = []
        self.others: list[tuple[int, Callable[[], None]]] = []  # what else happens, and how often [ns]
        self.woken: list[int] = []
        self.tick = self._image = self._news = 0
        self.epoch = 3  # of the controller
        arming.step = prove
        self._enables = {robot: Inbox(bench.bus.newest(ENABLE, robot), ENABLE_LAYOUT.decode) for robot in ROBOTS}
        self.node = Supervisor(
            bench.config, bench.bus, bench.clock, self.woken.append, np.random.default_rng(1),
            free_bytes=lambda: self.free_bytes, attended=attended, say=self.lines.append,
            machine=lambda ns: None if contended is None else Machine(round(contended * ns), 6.1, 2, self._counts(ns)),
        )  # fmt: skip

    def run(self, ns: int) -> None:
        others = [
            *self.others,
            (20 * MS, self._talk),
            (33 * MS, self._control),
            (33 * MS, self._see),
            (200 * MS, self._attend),
        ]
        self.bench.run(self.node, ns, *others)

    def ask(self, text: str, within_ns: int = 0) -> str:
        """Ask, and return the answer."""
        answer: Answer = self.bench.bus.ask(REQUEST, "supervisor", text.encode())
        self.node.step(self.bench.now_ns)
        if within_ns:
            self.run(within_ns)
        return (answer.take() or b"no answer").decode()

    @property
    def state(self) -> RunState:
        newest: RunState = self.bench.heard(STATE)[-1]
        return newest

    @property
    def cause(self) -> tuple[int, int, int]:
        return (self.state.phase, self.state.cause, self.state.robot)

    def enable(self, robot: str) -> Enable:
        newest: Enable = self.bench.heard(ENABLE, robot)[-1]
        return newest

    def limits(self) -> list[float]:
        return [self.enable(robot).limit_rad_s for robot in ROBOTS]

    def running(self) -> None:
        self.run(S // 5)
        assert self.ask("start") == "ok"
        self.run(S // 5)
        assert self.state.phase == Phase.RUNNING
        assert min(self.limits()) > 0.0

    def armed(self) -> None:
        self.run(S // 5)
        assert self.ask("arm") == "ok"
        self.run(2 * S)
        assert (self.state.phase, self.state.stage) == (Phase.ARMED, Stage.DONE)
        assert self.limits() == [0.0] * 4

    def tell_tick(self, robot: dict[str, float], **changes: int) -> None:
        """Let the controller tell of the tick; ``robot``: fields of each robot's part."""
        part = RobotTick(*[0.0] * len(RobotTick._fields))._replace(**robot)
        record = TickRecord(self.epoch, self.build, self.tick, -1, self.bench.now_ns, *[0] * 11, (part,) * 4, ())
        self.bench.say(TICK, record._replace(**changes))  # type: ignore[arg-type]

    def tell_image(self, *strange: TagPose, coasted_ns: int = 0, **changes: int) -> None:
        """Let the tracker tell of an image of the tags that are not hidden; ``coasted_ns``: that of r2."""
        self._image += 1
        now_ns = self.bench.now_ns
        seen = (r for r in ROBOTS if r not in self.hidden)
        poses = tuple(TagPose(self.tags[r], 0, coasted_ns * (r == "r2"), *self.places[r]) for r in seen)
        image = FleetPoses(4, self._image, self.build, now_ns, now_ns, 0, 0, 0, 0, (*strange, *poses))
        self.bench.say(POSES, image._replace(**changes), CAMERA)  # type: ignore[arg-type]

    def tell(self, event: TrackerEvent | int, robot: str | None = None, value: float = 0.0) -> None:
        """Let the tracker tell something."""
        self._news += 1
        tag = NO_TAG if robot is None else self.tags[robot]
        self.bench.say(NEWS, TrackerNews(1, self._news, 0, event, tag, value), CAMERA)

    def _counts(self, now_ns: int) -> tuple[Turns, ...]:
        """Return the turns of all: of those that are not stuck one every 10 ms, in half of which they wait."""
        now = Turns(now_ns // 2, now_ns // (10 * MS))
        self._turns |= dict.fromkeys(self._turns.keys() - self.stuck, now)
        return tuple(self._turns.values()) if self._counted else ()

    def _talk(self) -> None:
        for name, robot in self.robots.items():
            if (enable := self._enables[name].take()) is not None:
                robot.hear(enable)
            if name not in self.silent:
                self.bench.say(STATUS, robot.status(self.bench.now_ns, self.build), name)

    def _control(self) -> None:
        if "controller" not in self.silent:
            self.tick += 1
            self.tell_tick(self.stopped)

    def _see(self) -> None:
        if "tracker" not in self.silent:
            self.tell_image(echo_tick=self.tick)

    def _attend(self) -> None:
        if "operator" not in self.silent:
            self.bench.bus.ask(REQUEST, "supervisor", b"attended")
