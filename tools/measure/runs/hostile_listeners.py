"""Who listens to a fleet beside its processes, without waiting for anything: all that ``hostile_messages`` attacks.

The recording with what viewers draw, the operator's page, the terminal, Foxglove's and rerun's servers, a script in
real time, the ROS 2 graph. Each hears every message of a lockstep run, and is asked for what its users ask it for.
"""

import os
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

import pytest
from rich.console import Console

from robofleet.behaviours.script import Script
from robofleet.bus.bus import Arrival, Bus
from robofleet.bus.observer import Observer
from robofleet.bus.ticks import TickFollower
from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.core.clock import Clock, S
from robofleet.gateways.place import Served
from robofleet.gateways.viewers import server as viewers_server
from robofleet.gateways.viewers.live import Viewers
from robofleet.gateways.viewers.retained import RetainedMessages
from robofleet.operator.page.hearing import Hearing
from robofleet.operator.terminal.live import LiveView
from robofleet.operator.terminal.terminal import Terminal
from robofleet.recording.channels import Channel
from robofleet.recording.log import FILE, RunLog
from robofleet.recording.run import Recording
from robofleet.reports.after import report
from robofleet.reports.metrics import summary
from robofleet.reports.sampled import look
from robofleet.runs.lockstep import Lockstep
from robofleet.scripts import script_live
from robofleet.scripts.fleet import Fleet, FleetError
from robofleet.scripts.script_live import LiveLink

os.environ.setdefault("ROS_PYTHON_CHECK_FIELDS", "1")  # read where messages are imported: as older ROS 2 always does
EPOCH_NS = 1_700_000_000 * S
_PART_BYTES = 1 << 20  # of a recording, looked at together


class Stream:
    dropped = 0

    def __init__(self, bus: Any, clock: Clock) -> None:
        self._came: list[Arrival] = []
        bus.tap(lambda message: self._came.append(Arrival(clock.now_ns(), *message)))

    def drain(self) -> list[Arrival]:
        came, self._came[:] = [*self._came], []
        return came


class Recorded:
    """A recording of real time, with what viewers draw."""

    def __init__(self, config: Config, stream: Stream, folder: Path, *, whole: bool) -> None:
        self._stream, self._folder, self._whole = stream, folder, whole
        self._log = RunLog(folder / FILE, config, epoch_ns=EPOCH_NS)

    def step(self, now_ns: int) -> None:
        for at_ns, full, payload in self._stream.drain():
            self._log.add(full, payload, at_ns)
        self._log.flush(now_ns)

    def close(self) -> None:
        """End the file, and make what its user looks at."""
        self._log.end(b"")
        assert self._log.failed is None and not self._log.dropped
        parted = look(self._folder, together=_PART_BYTES)
        if self._whole:
            report(self._folder, columns=parted)
        else:
            summary(parted.recording, name="hostile", mode="realtime", outcome="fault", cause=None, run=parted)


class FakeViewer:
    """A viewers' server without a net."""

    address = ""

    def __init__(self) -> None:
        self._kept, self._topics = RetainedMessages(), set[str]()

    def tell(self, topic: str, log_ns: int, message: bytes) -> None:
        self._kept.take(topic, message)
        self._topics.add(topic)

    def step(self, log_ns: int) -> None:
        for topic in self._topics:
            self._kept.of(topic)

    def close(self) -> None:
        pass


def _rerun(config: Config, channels: Sequence[Channel]) -> viewers_server.Server:
    from robofleet.gateways.viewers.rerun.server import Server
    from robofleet.operator.viewer_address import Address
    from robofleet.reports.layouts.rerun_blueprint import blueprint

    return Server("hostile", Address("127.0.0.1", 0), blueprint(Recording(config)), channels, "1MB")


class Scripted:
    """A script of a run in real time, which looks at all it can, and drives."""

    def __init__(self, run: Lockstep, config: Config, group: str) -> None:
        class Passing(LiveLink):
            def _check(self) -> None:
                run.advance(0.01)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(script_live, "joined", lambda *_: run.bus)
            self._link = Passing(config, group, "")
        self._fleet = Fleet("")
        self._fleet._begin(self._link, group)

    def step(self, _now_ns: int) -> None:
        fleet, link = self._fleet, self._link
        with suppress(FleetError):
            if link._has_new_tick():
                fleet._read(link.next_tick())
        assert len(fleet.readings) == len(fleet.robots) == len(fleet.sensors)
        _ = fleet.poses, fleet.points, fleet.time, fleet.phase, fleet._number(fleet._followed)
        with suppress(FleetError):
            fleet.drive([(0.05, 0.1)] * len(fleet.robots))

    def close(self) -> None:
        self._fleet._stand()


class _Publisher:
    """Somebody listens: each message is put in the form in which it is sent."""

    def __init__(self) -> None:
        from rclpy.serialization import serialize_message

        self._serialize = serialize_message

    def get_subscription_count(self) -> int:
        return 1

    def publish(self, message: Any) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of ROS's own packages, which are loaded now
            self._serialize(message)


class Ros:
    """All that the ROS 2 gateway says."""

    def __init__(self, config: Config, bus: Bus, clock: Clock) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of ROS's own packages
            from robofleet.gateways.ros2 import topics
            from robofleet.gateways.ros2.camera import Camera
            from robofleet.gateways.ros2.graph import Messages
            from robofleet.gateways.ros2.node_graph import stamped
            from robofleet.gateways.ros2.robots import Robots
            from robofleet.gateways.ros2.run import Run
            from robofleet.gateways.ros2.sensing import Sensing

        class Graph:
            frames, messages, has_transforms = topics.Frames(), Messages(), False

            def publisher(self, *_: object) -> _Publisher:
                return _Publisher()

            def stamp(self, instant_ns: int) -> Any:
                return stamped(instant_ns + EPOCH_NS)

        graph: Any = Graph()
        self._ticks = TickFollower(bus, round(config.controller.tick_s * S), lambda _: None)
        names = topics.ros_names(config.ids)
        observer = self._observer = Observer(bus)
        args = graph, config, names, observer
        robots = Robots(*args, self._ticks)
        served = Served(lambda: False, clock.now_ns())
        self._parts: list[Any] = [robots, Sensing(*args), Run(graph, config, observer, served)]
        self._parts += [Camera(graph, n, view, robots, bus, observer) for n, view in config.trackers.items()]

    def step(self, now_ns: int) -> None:
        self._ticks.update()
        updated = self._observer.update(now_ns)
        for part in self._parts:
            part.step(now_ns, updated)

    def close(self) -> None:
        pass


class Watched:
    """The operator's page and the terminal."""

    def __init__(self, run: Lockstep, config: Config) -> None:
        self._run, self._page = run, Hearing(config, run.bus, run.clock, lambda _: None)
        self._view = LiveView(config, run.clock, Terminal(), quiet=False)

    def step(self, _now_ns: int) -> None:
        self._page.hear()
        self._page.hear_the_rest()

    def close(self) -> None:
        with Path(os.devnull).open("w") as nowhere:
            Console(file=nowhere, width=120).print(self._view.picture(self._run.recording, "running"))


class Listener(Protocol):
    """One of them."""

    def step(self, now_ns: int) -> None:
        """Take what came."""

    def close(self) -> None:
        """Show what was left to the end."""


class Shown:
    """Viewers that hear what the recording has, by a server."""

    def __init__(
        self, config: Config, stream: Stream, opened: Callable[[Sequence[Channel]], viewers_server.Server]
    ) -> None:
        self._viewers = Viewers(config, stream, Served(lambda: False, 0), opened, EPOCH_NS)
        self.step = self._viewers.step

    def close(self) -> None:
        self._viewers.rest(0)
        self._viewers.close()


def listeners(run: Lockstep, config: Config, folder: Path, *, whole: bool) -> list[Listener]:
    """Return all of them, of a run that goes on; ``whole``: with the report in a folder, and rerun, which take long."""
    bus, clock = run.bus, run.clock
    found: list[Listener] = [
        Watched(run, config), Recorded(config, Stream(bus, clock), folder, whole=whole),
        Shown(config, Stream(bus, clock), lambda _: FakeViewer()),
    ]  # fmt: skip
    if whole and find_spec("rerun"):
        found.append(Shown(config, Stream(bus, clock), partial(_rerun, config)))
    if find_spec("rclpy"):
        found.append(Ros(config, bus, clock))
    return [*found, *(Scripted(run, config, group) for group in groups.taking_setpoints(config, Script))]
