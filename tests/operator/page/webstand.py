"""The operator's page's server, real, on a real bus on which a test says what a fleet would say."""

import asyncio
import json
import socket
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self
from urllib.parse import urlsplit

import numpy as np
from websockets.sync.client import ClientConnection, connect

from robofleet.behaviours import described
from robofleet.bus import keys, messages
from robofleet.bus.bus import Request
from robofleet.bus.messages import FleetPoses, Picture, RobotState, RobotTick, RunState, TagPose, TickRecord
from robofleet.bus.zenoh_bus import ZenohBus, open_router
from robofleet.config import groups
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import S, WallClock
from robofleet.operator.page.certificate import PageKeys
from robofleet.operator.page.page_address import Addresses
from robofleet.operator.page.server import Served, serve
from robofleet.safety.latches import GateStatus, Latch
from robofleet.safety.supervisor import NOBODY, Event, Phase
from tests.bus.alone import ROBOT_STATUS, RobotStatus
from tests.endpoints import own_endpoint
from tests.runs.realrun import PLATOON, wait

CLOCK = WallClock()
_LOOPBACK = "127.0.0.1"
Frame = dict[str, Any]


def told_numbers(groups: Sequence[described.Group], figures: Mapping[str, Sequence[float]]) -> tuple[float, ...]:
    """Return what groups tell in a tick: figures by their names, and references' ``x`` and ``y``, a value a robot."""
    numbers, first = np.full(described.size(groups), np.nan), 0
    for group, part in zip(groups, described.parts(groups, numbers[None]), strict=True):
        rows = slice(first, first := first + len(group.robots))
        for k, name in enumerate(("x", "y", *(figure.name for figure in group.figures))):
            if name in figures:
                part[0, :, k] = figures[name][rows]
    return tuple(numbers.tolist())


class WebStand:
    """``url`` is what an operator is given; ``asked`` is what came to the supervisor."""

    def __init__(
        self, config: Config, bus: ZenohBus, addresses: Addresses, end: Callable[[], None], over: threading.Event
    ) -> None:
        self.config, self._bus, self.end, self.over = config, bus, end, over
        self.addresses, self.url, self.once = addresses, addresses.page, addresses.once
        self.authority, self.token = urlsplit(self.url).netloc, urlsplit(self.url).query.removeprefix("token=")
        self.robots = [robot.id for robot in config.members]
        self.groups = groups.descriptions(config)
        self.requests: list[bytes] = []
        self.mute = False  # the supervisor does not answer
        topics = keys.REQUEST, keys.SAFE_REQUEST
        self._served = [bus.serve(topic, "supervisor", lambda _: self._answer()) for topic in topics]
        self._tick, self._state = bus.publisher(keys.TICK), bus.publisher(keys.STATE)
        self._showing = bus.publisher(keys.SHOWING)
        self._status = {robot: bus.publisher(keys.STATUS, robot) for robot in self.robots}
        self._poses, self._picture = bus.publisher(keys.POSES, keys.CAMERA), bus.publisher(keys.PICTURE, keys.CAMERA)
        self._seq = 0

    def serves(self) -> bool:
        """Whether somebody listens at the page's port."""
        with socket.socket() as probe:
            host, port = self.authority.split(":")
            return probe.connect_ex((host, int(port))) == 0

    def page(self, **changes: Any) -> "OpenPage":
        """Open the page's WebSocket as a browser does, with what a test changes."""
        scheme = changes.pop("scheme", "http")
        how: dict[str, Any] = {"origin": f"{scheme}://{self.authority}", "compression": None, "open_timeout": 5}
        how |= changes
        token = how.pop("token", self.token)
        live = f"{scheme.replace('http', 'ws')}://{self.authority}/live"
        return OpenPage(lambda: connect(f"{live}?token={token}", **how))

    def say_tick(
        self, run_tick: int = -1, *robots: RobotTick, lateness_ns: int = 0, overruns: int = 7,
        figures: Mapping[str, Sequence[float]] | None = None, phase: Phase = Phase.RUNNING,
    ) -> None:  # fmt: skip
        """Say a tick; ``told``: figures by their names, and ``x`` and ``y`` of the references, a value a robot."""
        self._seq += 1
        items = robots or tuple(placed(0.1 * row, 0.0) for row in range(len(self.robots)))
        timing = overruns, lateness_ns, 250_000
        head = (7, 0, self._seq, run_tick, CLOCK.now_ns(), 0, 0, 0, 0, 0, 0, phase, 0, *timing)
        self._tick(messages.TICK_RECORD.encode(TickRecord(*head, items, told_numbers(self.groups, figures or {}))))

    def say_state(
        self, phase: Phase, cause: Event = Event.NOTHING, robot: int = NOBODY, halted: Event = Event.NOTHING
    ) -> None:
        self._seq += 1
        robots = (RobotState(1, 0, halted), *[RobotState(1, 0, 0)] * (len(self.robots) - 1))
        state = RunState(9, self._seq, phase, cause, robot, 0.0, 0, robots)
        self._state(messages.RUN_STATE.encode(state))

    def say_showing(self, words: str) -> None:
        """Switch what projectors show, as another server's page would."""
        self._showing(words.encode())

    def say_status(
        self, robot: str, gate: GateStatus = GateStatus.OPEN, latch: Latch = Latch.NONE, took_ns: int = 0
    ) -> None:
        self._seq += 1
        now_ns = CLOCK.now_ns()
        status = RobotStatus(
            1, self._seq, 0, 5, 11, now_ns, now_ns, now_ns - took_ns, now_ns, 0, gate, latch, 1, 0, 0, -1, -1,
            0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0, 0.5,
        )  # fmt: skip
        self._status[robot](ROBOT_STATUS.encode(status))

    def say_image(self, seq: int, exposure_ns: int, *poses: TagPose, jpeg: bytes = b"") -> None:
        self._poses(messages.FLEET_POSES.encode(FleetPoses(3, seq, 0, exposure_ns, exposure_ns, 1, 0, 0, 0, poses)))
        if jpeg:
            camera = self.config.camera
            self._picture(messages.PICTURE.encode(Picture(3, seq, exposure_ns, camera.width, camera.height, jpeg)))

    def _answer(self) -> None:
        request: Request | None
        for served in self._served:
            while (request := served()) is not None:
                self.requests.append(request.payload)
                if not self.mute:
                    request.reply(b"refused: the fleet is asleep" if request.payload == b"resume" else b"ok")


class OpenPage:
    """One page. It acknowledges nothing by itself."""

    socket: ClientConnection

    def __init__(self, connected: Callable[[], Any]) -> None:
        self._connected = connected

    def __enter__(self) -> Self:
        self._opened = self._connected()
        self.socket = self._opened.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._opened.__exit__(None, None, None)

    def say(self, **message: Any) -> None:
        self.socket.send(json.dumps(message))

    def next(self, kind: str, fits: Callable[[Frame], Any] = lambda _: True, within_s: float = 3.0) -> Frame:
        """Return the next frame of a kind that fits; ticks on the way are acknowledged. TimeoutError."""
        deadline_ns = CLOCK.now_ns() + round(within_s * S)
        while True:
            frame: Frame = json.loads(self.socket.recv(max(0.0, (deadline_ns - CLOCK.now_ns()) / S)))
            if frame["type"] == "tick":
                self.say(ack=frame["seq"])
            if frame["type"] == kind and fits(frame):
                return frame

    def heard_one(self) -> Frame:
        """Return the next frame."""
        frame: Frame = json.loads(self.socket.recv(3.0))
        return frame

    def heard(self, for_ns: int) -> list[Frame]:
        """Return what comes in a while, without acknowledging anything."""
        frames, end_ns = [], CLOCK.now_ns() + for_ns
        while (left_ns := end_ns - CLOCK.now_ns()) > 0:
            try:
                frames.append(json.loads(self.socket.recv(left_ns / S)))
            except TimeoutError:
                break
        return frames


def placed(x: float, y: float, **changes: float) -> RobotTick:
    """Return a robot's part of a tick: seen, and standing."""
    return (
        RobotTick(*[0.0] * len(RobotTick._fields))
        ._replace(x_m=x, y_m=y, point_x_m=x + 0.08, point_y_m=y, measured=1.0)
        ._replace(**changes)
    )


@contextmanager
def web_stand(
    folder: Path, *overrides: str, console: Callable[[], str] = str, file: Path = PLATOON, host: str = _LOOPBACK,
    keys: PageKeys | None = None, launcher_lives: Callable[[], bool] = bool,
) -> Iterator[WebStand]:  # fmt: skip
    """Start a router, the server and the stand; nothing is left of them."""
    config = load_config(file, ["drivers.robots_per_process=1", f"bus.endpoint={own_endpoint()}", *overrides])
    router = open_router(config.bus.endpoint)
    roles = {"test": ("supervisor", "tracker"), "web": ()}  # what the test stands for
    buses = [ZenohBus(config.arena.name, config.bus.endpoint, name, CLOCK, roles=has) for name, has in roles.items()]
    urls: list[Addresses] = []
    cut, over = threading.Event(), threading.Event()
    served = Served(
        config=config,
        folder=folder,
        bus=buses[1],
        clock=CLOCK,
        name=host,
        over=over.is_set,
        keys=keys,
        line=console,
        launcher_lives=launcher_lives,
    )
    thread = threading.Thread(
        target=lambda: asyncio.run(serve(served, socket.create_server((host, 0)), urls.append, cut.is_set))
    )
    thread.start()

    def end() -> None:
        cut.set()
        thread.join(5)

    try:
        assert wait(lambda: urls, 30), "the server is not ready"
        yield WebStand(config, buses[0], urls[0], end, over)
    finally:
        end()
        for bus in buses:
            bus.close()
        router.close()  # type: ignore[no-untyped-call]
    assert not thread.is_alive()
