"""The processes of a run, in one table: what each is called, how it is put together, its priority, who starts it.

Lockstep and the real processes are put together by the same functions, between other edges. Faults on purpose are
wrapped around what a process touches here: no process knows of them.

A row imports what its process is made of when that is made. So a driver process loads neither numba nor OpenCV, and
commands can list the processes without loading any.
"""

import os
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

from robofleet.core.clock import S, epoch_ns, stopwatch_ns
from robofleet.core.refusal import RefusedError
from robofleet.nodes.node import HIGHEST_PRIORITY, LineWaker, Node, Waker

if TYPE_CHECKING:
    import numpy as np

    from robofleet.bus.bus import Bus, Wake
    from robofleet.config.tree import Config
    from robofleet.core.clock import Clock
    from robofleet.core.compiling import Say
    from robofleet.nodes.unit.drivers import Drivers
    from robofleet.nodes.unit.gated_robot import Probe
    from robofleet.nodes.unit.state_store import StateStore
    from robofleet.simulation.faults import Schedule

Starter = Literal["run", "systemd", "daemon", "operator", "service"]
_PLENTY_BYTES = 1 << 40  # of a disk that does not fill up


@dataclass(frozen=True)
class Edges:
    """What a process touches: the same code runs between those of lockstep and those of a real run."""

    config: "Config"
    bus: "Bus"
    clock: "Clock"
    wake: "Wake"
    rng: "np.random.Generator"
    state_store: "StateStore"  # what a driver remembers after a restart
    progress: "Say"  # told how far it is, while kernels are compiled
    robots: tuple[str, ...] = ()  # a driver's
    faults: "Schedule | None" = None  # on purpose; bus and clock are wrapped in theirs already
    real_time: bool = False  # it shares this machine with others, and may have an operator
    folder: Path | None = None  # in which the run is recorded; None: in lockstep no disk fills up
    last_word: Callable[[], bytes] = bytes  # that the launcher said to its recorder
    probe: "Probe | None" = None  # told what each gate decides
    take_over: bool = False  # the robots of a controller that still has them


class Row(NamedTuple):
    """One kind of process."""

    name: str  # of its command; its log, place on the bus and faults are named so too, a driver's after its first robot
    make: Callable[[Edges], Node] | None  # None: it has no steps, and a main function of its own
    priority: int | None  # real-time; 0: nice alone, before what else the machine does; None: it goes before nobody
    starter: Starter | None = "run"  # None: bus.router or drivers.started_by says it
    first: bool = False  # it starts before the others, and ends after them
    turn: int | None = None  # in lockstep, among those that are due at one instant; None: lockstep has none of it
    injectable: bool = True  # timed faults may name it
    waker: type[Waker] = Waker
    precise: bool = False  # it meets each instant within microseconds, and no message wakes it
    ends_within_s: float = 0.8  # of its lifeline's end
    missing: str = ""  # what a configuration lacks that has no such process, and how to mend it

    @property
    def command(self) -> tuple[str, ...]:
        """The words behind ``robofleet``."""
        return (self.name,) if self is PAGE else ("node", self.name)

    def instances(self, config: "Config") -> "Sequence[Process]":
        """Return the processes of this kind that a run of a configuration has."""
        if self is DRIVER:
            return [Process(name, self, robots) for name, robots in config.driven.items()]
        if self is TRACKER and len(config.trackers) > 1:
            return [Process(name, self, camera=view.camera.name) for name, view in config.trackers.items()]
        none = self is PAGE or (self is TWINS and not config.twins)
        return [] if none else [Process(self.name, self)]


class Process(NamedTuple):
    """One process of a configuration."""

    name: str
    row: Row
    robots: tuple[str, ...] = ()  # a driver's
    camera: str = ""  # a tracker's, where there are several

    @property
    def command(self) -> tuple[str, ...]:
        """What ``robofleet`` is called with, before the configuration."""
        options = (
            ("--camera", self.camera) if self.camera else ("--robots", ",".join(self.robots)) if self.robots else ()
        )
        return *self.row.command, *options

    def config(self, config: "Config") -> "Config":
        """Return the configuration as this process has it: a tracker's camera is its own."""
        return config.trackers[self.name] if self.row is TRACKER else config


def processes(config: "Config") -> list[Process]:
    """Return every process of a configuration's run, in the order of their start."""
    return [process for row in TABLE for process in row.instances(config)]


def started_by(starter: Starter, config: "Config") -> list[Process]:
    return [process for process in processes(config) if _starter(process, config) == starter]


def _starter(process: Process, config: "Config") -> Starter:
    if process.row.starter is not None:
        return process.row.starter
    if process.row is ROUTER:
        return config.bus.router
    if config.drivers.started_by == "daemon":
        return "daemon" if config.unit_of[process.robots[0]] in config.daemons else "run"
    return config.drivers.started_by


def in_lockstep(config: "Config") -> list[Process]:
    """Return those that lockstep steps, in their order."""
    stepped = [(process.row.turn, process) for process in processes(config) if process.row.turn is not None]
    return [process for _, process in sorted(stepped, key=lambda entry: entry[0])]


def injectable(config: "Config") -> tuple[str, ...]:
    """Return the names of the processes that timed faults may strike."""
    return tuple(process.name for process in processes(config) if process.row.injectable)


def free_bytes(folder: int) -> int:
    """Return the room left where a folder is, by its descriptor; none where that is not known: then the fleet holds."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return 0


def _recorder(edges: Edges) -> Node:
    """RefusedError where it cannot write in the run's folder."""
    from robofleet.nodes.recorder import Recorder  # noqa: PLC0415
    from robofleet.recording.log import FILE, RunLog  # noqa: PLC0415

    assert edges.folder is not None
    file = edges.folder / FILE
    log = partial(RunLog, file, edges.config, epoch_ns=epoch_ns())
    try:
        return Recorder(edges.config, edges.bus, edges.rng, log, edges.last_word)
    except OSError as error:
        raise RefusedError(f"{file}: {error.strerror}: a run is recorded in a folder of its own") from error


def _twins(edges: Edges) -> Node:
    """RefusedError where there is no place for their ports."""
    from robofleet.runs.twins import Twins  # noqa: PLC0415

    assert isinstance(edges.wake, LineWaker)
    try:
        return Twins(edges.config, edges.bus, edges.clock, edges.wake, edges.faults)
    except OSError as error:
        raise RefusedError(f"{error.filename or 'a pseudo-terminal'}: {error.strerror or error}") from error


def _supervisor(edges: Edges) -> Node:
    """RefusedError where the folder in which the run is recorded cannot be opened."""
    from robofleet.nodes.machine import MachineProbe  # noqa: PLC0415
    from robofleet.nodes.supervisor import Supervisor, compile_kernels  # noqa: PLC0415

    compile_kernels(edges.progress)
    free = _room(edges.folder)
    if edges.faults is not None:
        from robofleet.simulation import faulty_disk  # noqa: PLC0415

        free = faulty_disk.free_bytes(free, edges.faults)
    return Supervisor(
        edges.config, edges.bus, edges.clock, edges.wake, edges.rng, free_bytes=free,
        attended=edges.real_time and edges.config.run.attended, say=say if edges.real_time else lambda _: None,
        machine=MachineProbe(edges.config.ids) if edges.real_time else lambda _: None,
    )  # fmt: skip


def _room(folder: Path | None) -> Callable[[], int]:
    if folder is None:
        return lambda: _PLENTY_BYTES
    try:
        held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)  # this very folder, whatever it is called later
    except OSError as error:
        raise RefusedError(f"{folder}: {error.strerror}: a run is recorded in a folder of its own") from error
    return lambda: free_bytes(held)


def say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _tracker(edges: Edges) -> Node:
    """CameraError where its camera cannot be used."""
    import cv2  # noqa: PLC0415

    from robofleet.bus.ticks import TickFollower  # noqa: PLC0415
    from robofleet.nodes.pose_sources import compiling, pose_source  # noqa: PLC0415
    from robofleet.nodes.tracker import SeenLog, Tracker, WatchedPoses  # noqa: PLC0415
    from robofleet.simulation.faulty_poses import FaultyFeed, FaultyPoses  # noqa: PLC0415
    from robofleet.tracking.sources import PoseContext  # noqa: PLC0415

    cv2.setNumThreads(1)  # parts of an image are too small to share
    config, bus, clock, wake, rng, faults = edges.config, edges.bus, edges.clock, edges.wake, edges.rng, edges.faults
    ticks = TickFollower(bus, round(config.controller.tick_s * S), wake)
    charge_ns = 0 if edges.real_time else round(config.lockstep.tracker_delay_s * S)
    context = PoseContext(
        config=config, clock=clock, bus=bus, ticks=ticks, rng=rng, extra_delay_ns=charge_ns,
        wake=wake, real_time=edges.real_time,
        around=(lambda feed: feed) if faults is None else (lambda feed: FaultyFeed(feed, faults)),
    )  # fmt: skip
    with compiling(config, edges.progress):
        source = pose_source(context)
        if faults is not None:
            source = FaultyPoses(source, faults, config)
        if config.tracker.own_times:
            source = WatchedPoses(source, clock.now_ns())
        seen = SeenLog(config, say) if edges.real_time else None
        return Tracker(config, bus, clock, wake, rng, ticks, source, seen)


def _controller(edges: Edges) -> Node:
    from robofleet.behaviours.interface import SHARE_OF_TICK  # noqa: PLC0415
    from robofleet.nodes.behaviour_runner import timed_by, untimed  # noqa: PLC0415
    from robofleet.nodes.controller import Controller, compile_kernels  # noqa: PLC0415

    compile_kernels(edges.config, edges.progress)
    share_ns = SHARE_OF_TICK * edges.config.controller.tick_s * S / len(edges.config.groups)
    judge = timed_by(stopwatch_ns, share_ns) if edges.real_time else untimed
    return Controller(edges.config, edges.bus, edges.clock, edges.rng, take_over=edges.take_over, judge=judge)


def _driver(edges: Edges) -> Node:
    """DriverError where a robot does not answer."""
    from robofleet.config.slices import drawn_id  # noqa: PLC0415
    from robofleet.nodes.unit.driver import LOOP_NS, DriverProcess  # noqa: PLC0415
    from robofleet.nodes.unit.drivers import ConfiguredDrivers, in_arrays  # noqa: PLC0415

    config = edges.config
    unit = config.unit_of[edges.robots[0]]
    drivers: Drivers = ConfiguredDrivers(config, edges.clock.now_ns)
    if in_arrays(config, edges.robots):
        from robofleet.nodes.unit.simulated_robots import compile_kernels  # noqa: PLC0415 - it needs numba

        compile_kernels(edges.progress)
    state_store = edges.state_store
    if edges.faults is not None:
        from robofleet.simulation.faulty_disk import FaultyStore  # noqa: PLC0415
        from robofleet.simulation.faulty_driver import FaultyDrivers  # noqa: PLC0415

        drivers, state_store = FaultyDrivers(drivers, edges.faults), FaultyStore(state_store, edges.faults)
    return DriverProcess(
        config, unit, edges.bus, edges.clock, edges.wake, drawn_id(edges.rng, 64), int(edges.rng.integers(LOOP_NS)),
        state_store, drivers, edges.probe,
    )  # fmt: skip


ROUTER = Row("router", None, 0, starter=None, first=True)
RECORDER = Row(
    "recorder", _recorder, None,
    first=True, injectable=False, ends_within_s=5.0,  # what is left is written, and the file's index
)  # fmt: skip
TWINS = Row(
    "twins", _twins, 18,
    first=True, waker=LineWaker,  # a robot's own processor waits for nobody
    missing="no robot has a twin: name one in robots[].twin",
)  # fmt: skip
PAGE = Row("web", None, None, "operator", injectable=False)
SUPERVISOR = Row("supervisor", _supervisor, 12, turn=3)
TRACKER = Row("tracker", _tracker, 10, turn=2)
CONTROLLER = Row("controller", _controller, HIGHEST_PRIORITY, turn=4, precise=True)
DRIVER = Row("driver", _driver, 15, starter=None, turn=1)

TABLE = (ROUTER, RECORDER, TWINS, PAGE, SUPERVISOR, TRACKER, CONTROLLER, DRIVER)
