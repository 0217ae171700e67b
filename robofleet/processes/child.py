"""The main function of every process of a run: ``robofleet controller CONFIG`` and its siblings.

A driver process loads neither numba nor OpenCV: each process imports what it is made of when it starts.
"""

import threading
from collections.abc import Callable

from robofleet.clock import Clock, WallClock
from robofleet.comms.zenoh_bus import ZenohBus, open_router
from robofleet.config.slices import entropy
from robofleet.config.tree import Config
from robofleet.processes.node import Lifeline, Node, Waker, ahead_of_others, realtime_priority, run

_CONTROLLER_PRIORITY = 20
_DRIVER_PRIORITY = 15
_SUPERVISOR_PRIORITY = 12
_TRACKER_PRIORITY = 10

Make = Callable[[Config, ZenohBus, Clock, Waker], Node]


def router(config: Config, lifeline: Lifeline) -> None:
    """Zenoh's router, until the lifeline is cut."""
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
    from robofleet.processes.controller import Controller, compile_kernels  # noqa: PLC0415

    compile_kernels(config)
    _run(
        "controller", config, lifeline,
        lambda c, bus, clock, _: Controller(c, bus, clock, entropy(c.run.seed, "controller"), take_over=take_over),
        _CONTROLLER_PRIORITY, precise=True,
    )  # fmt: skip


def tracker(config: Config, lifeline: Lifeline) -> None:
    """The tracker and its camera."""
    import cv2  # noqa: PLC0415

    from robofleet.processes.tracker import Tracker  # noqa: PLC0415
    from robofleet.tracking.sources import CameraError  # noqa: PLC0415

    def make(config: Config, bus: ZenohBus, clock: Clock, waker: Waker) -> Tracker:
        try:
            return Tracker(config, bus, clock, waker, entropy(config.run.seed, "tracker"))
        except CameraError as error:
            raise SystemExit(f"camera: {error}") from error

    cv2.setNumThreads(1)
    _run("tracker", config, lifeline, make, _TRACKER_PRIORITY)


def driver(config: Config, lifeline: Lifeline, robots: tuple[str, ...]) -> None:
    """The drivers of some robots."""
    from robofleet.processes.driver import DriverProcess  # noqa: PLC0415
    from robofleet.processes.keeping import FileKeeping  # noqa: PLC0415

    _run(
        "driver-" + "-".join(robots), config, lifeline,
        lambda c, bus, clock, waker: DriverProcess(
            c, robots, bus, clock, waker, entropy(c.run.seed, *robots), FileKeeping(c.arena.name)
        ),
        _DRIVER_PRIORITY,
    )  # fmt: skip


def supervisor(config: Config, lifeline: Lifeline) -> None:
    """The supervisor."""
    from robofleet.processes.supervisor import Supervisor  # noqa: PLC0415

    _run(
        "supervisor", config, lifeline,
        lambda c, bus, clock, _: Supervisor(c, bus, clock, entropy(c.run.seed, "supervisor")), _SUPERVISOR_PRIORITY,
    )  # fmt: skip


def _run(name: str, config: Config, lifeline: Lifeline, make: Make, priority: int, *, precise: bool = False) -> None:
    clock, waker = WallClock(), Waker()
    ahead_of_others()
    bus = ZenohBus(config.arena.name, config.bus.endpoint, name, clock)
    try:
        node = make(config, bus, clock, waker)
        realtime_priority(priority)
        run(node, clock, lifeline, waker, precise=precise)
    finally:
        bus.close()
