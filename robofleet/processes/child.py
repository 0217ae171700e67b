"""The main function of every process of a run: ``robofleet controller CONFIG`` and its siblings.

A driver process loads neither numba nor OpenCV: each process imports what it is made of when it starts.
"""

import os
import shutil
import sys
import threading
from collections.abc import Callable
from pathlib import Path

from robofleet.clock import Clock, WallClock, epoch_ns
from robofleet.comms.bus import Bus
from robofleet.comms.keys import driver_role
from robofleet.comms.living import RoleTakenError
from robofleet.comms.zenoh_bus import ZenohBus, open_router
from robofleet.config.slices import entropy
from robofleet.config.tree import Config
from robofleet.processes.log_lines import never_raise
from robofleet.processes.node import Lifeline, LineWaker, Node, Waker, ahead_of_others, realtime_priority, run
from robofleet.processes.refusal import RefusedError
from robofleet.simulation.faults import Schedule
from robofleet.simulation.faulty_bus import FaultyBus
from robofleet.vehicles.interface import DriverError

_CONTROLLER_PRIORITY = 20
_TWINS_PRIORITY = 18  # a robot's own processor waits for nobody
_DRIVER_PRIORITY = 15
_SUPERVISOR_PRIORITY = 12
_TRACKER_PRIORITY = 10

Make = Callable[[Config, Bus, Clock, Waker, Schedule | None], Node]


def router(config: Config, lifeline: Lifeline) -> None:
    """Zenoh's router, until the lifeline is cut."""
    never_raise(stdout=True)
    ahead_of_others()
    session = open_router(config.bus.endpoint)
    try:
        lifeline.ready()
        while not lifeline.cut:
            threading.Event().wait(0.05)
    finally:
        session.close()  # type: ignore[no-untyped-call]


def controller(config: Config, lifeline: Lifeline, *, take_over: bool) -> None:
    """The controller at its tick."""

    def make(config: Config, bus: Bus, clock: Clock, *_: object) -> Node:
        from robofleet.processes.controller import Controller, compile_kernels  # noqa: PLC0415

        compile_kernels(config)
        return Controller(config, bus, clock, entropy(config.run.seed, "controller"), take_over=take_over)

    _run("controller", config, lifeline, make, _CONTROLLER_PRIORITY, precise=True)


def tracker(config: Config, lifeline: Lifeline) -> None:
    """The tracker and its camera."""

    def make(config: Config, bus: Bus, clock: Clock, waker: Waker, faults: Schedule | None) -> Node:
        import cv2  # noqa: PLC0415

        from robofleet.processes.tracker import Tracker  # noqa: PLC0415
        from robofleet.tracking.sources import CameraError  # noqa: PLC0415

        cv2.setNumThreads(1)
        try:
            return Tracker(config, bus, clock, waker, entropy(config.run.seed, "tracker"), faults=faults)
        except CameraError as error:
            raise SystemExit(f"camera: {error}") from error

    _run("tracker", config, lifeline, make, _TRACKER_PRIORITY)


def driver(config: Config, lifeline: Lifeline, robots: tuple[str, ...]) -> None:
    """The drivers of some robots; RefusedError where one does not answer."""
    from robofleet.processes.driver import DriverProcess  # noqa: PLC0415
    from robofleet.processes.keeping import FaultyKeeping, FileKeeping, Keeping  # noqa: PLC0415

    def make(config: Config, bus: Bus, clock: Clock, waker: Waker, faults: Schedule | None) -> DriverProcess:
        files = FileKeeping(config.arena.name)
        try:
            files.prove(robots)
        except OSError as error:
            raise RefusedError(
                f"{error.filename}: {error.strerror}: what robots must remember is kept there: "
                "make room, make it writable, or name another folder in XDG_STATE_HOME"
            ) from error
        keeping: Keeping = files if faults is None else FaultyKeeping(files, faults)
        rng = entropy(config.run.seed, *robots)
        try:
            return DriverProcess(config, robots, bus, clock, waker, rng, keeping, faults=faults)
        except DriverError as error:
            raise RefusedError(str(error)) from error

    roles = tuple(driver_role(robot) for robot in robots)
    _run(roles[0], config, lifeline, make, _DRIVER_PRIORITY, roles=roles)


def twins(config: Config, lifeline: Lifeline) -> None:
    """The firmware twins; RefusedError where there is none, or no place for their ports."""
    from robofleet.processes.twins import Twins  # noqa: PLC0415

    if not config.twins:
        raise RefusedError("no robot has a twin: name one in robots[].twin")
    waker = LineWaker()

    def make(config: Config, bus: Bus, clock: Clock, _: Waker, faults: Schedule | None) -> Twins:
        try:
            return Twins(config, bus, clock, waker, faults)
        except OSError as error:
            raise RefusedError(f"{error.filename or 'a pseudo-terminal'}: {error.strerror or error}") from error

    _run("twins", config, lifeline, make, _TWINS_PRIORITY, waker=waker)


def supervisor(config: Config, lifeline: Lifeline, folder: Path) -> None:
    """The supervisor; ``folder`` is where the run is recorded; RefusedError where it is not there."""
    from robofleet.processes.supervisor import Supervisor  # noqa: PLC0415

    try:
        held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)  # this very folder, whatever it is called later
    except OSError as error:
        raise RefusedError(f"{folder}: {error.strerror}: a run is recorded in a folder of its own") from error

    def make(config: Config, bus: Bus, clock: Clock, waker: Waker, faults: Schedule | None) -> Supervisor:
        def room() -> int:
            return 0 if faults is not None and faults.disk_is_full() else free_bytes(held)

        return Supervisor(
            config, bus, clock, waker, entropy(config.run.seed, "supervisor"), free_bytes=room,
            attended=config.run.attended, say=lambda line: print(line, file=sys.stderr, flush=True),
        )  # fmt: skip

    _run("supervisor", config, lifeline, make, _SUPERVISOR_PRIORITY)


def free_bytes(folder: int) -> int:
    """Return the room left where a folder is, by its descriptor; none where that is not known: then the fleet holds."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return 0


def recorder(config: Config, lifeline: Lifeline, folder: Path) -> None:
    """The recorder, which goes before nobody; RefusedError where it may not or cannot write in the folder."""
    from robofleet.processes.recorder import Recorder  # noqa: PLC0415
    from robofleet.recording.log import FILE, RunLog  # noqa: PLC0415

    never_raise(stdout=True)
    clock = WallClock()
    try:
        log = RunLog(folder / FILE, config, epoch_ns=epoch_ns())
    except OSError as error:
        raise RefusedError(f"{folder / FILE}: {error.strerror}: a run is recorded in a folder of its own") from error
    try:
        bus = _joined(config, "recorder", clock, ("recorder",))
    except RefusedError:
        log.close()
        (folder / FILE).unlink()
        raise
    try:
        rng = entropy(config.run.seed, "recorder")
        run(Recorder(config, bus, rng, log, lambda: lifeline.last_word), clock, lifeline, Waker())
    finally:
        bus.close()


def _run(
    name: str,
    config: Config,
    lifeline: Lifeline,
    make: Make,
    priority: int,
    *,
    precise: bool = False,
    waker: Waker | None = None,
    roles: tuple[str, ...] = (),
) -> None:
    """Take the process's place on the bus, then make it: who is refused has cost the others nothing."""
    never_raise(stdout=True)
    clock, waker = WallClock(), waker or Waker()
    ahead_of_others()
    bus = _joined(config, name, clock, roles or (name,))
    try:
        faults = Schedule(config, clock) if config.faults else None
        seen: Bus = bus if faults is None else FaultyBus(bus, faults, name, clock)
        node = make(config, seen, clock, waker, faults)
        realtime_priority(priority)
        run(node, clock, lifeline, waker, precise=precise)
    finally:
        bus.close()


def _joined(config: Config, name: str, clock: Clock, roles: tuple[str, ...]) -> ZenohBus:
    """Join the bus; RefusedError where another process is there in its place."""
    try:
        return ZenohBus(config.arena.name, config.bus.endpoint, name, clock, roles=roles)
    except RoleTakenError as error:
        raise RefusedError(str(error)) from error
