"""The main function of every process of a run: ``robofleet controller CONFIG`` and its siblings."""

import os
import sys
import threading
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import zenoh

from robofleet.bus.living import RoleTakenError
from robofleet.bus.zenoh_bus import Network, ZenohBus, open_router
from robofleet.config.faults import did_you_mean
from robofleet.config.slices import entropy
from robofleet.config.tree import Config
from robofleet.core.clock import MS, Clock, S, WallClock
from robofleet.core.log_lines import never_raise
from robofleet.core.patterns import driver_role
from robofleet.core.refusal import RefusedError, unkept
from robofleet.hosts.link_log import FewLines, say_linked, say_refused
from robofleet.hosts.network import Keys, network
from robofleet.nodes.node import Lifeline, Node, ahead_of_others, realtime_priority, run
from robofleet.nodes.unit.state_store import FileStateStore
from robofleet.runs.table import RECORDER, ROUTER, TRACKER, Edges, Row, say
from robofleet.tracking.sources import CameraError
from robofleet.vehicles.interface import DriverError

_ROUTER_RESTARTS_WITHIN_NS = 5 * S


def main(
    row: Row, config: Config, folder: Path, lifeline: int | None, robots: tuple[str, ...] = (), camera: str = "", *,
    take_over: bool = False,
) -> None:  # fmt: skip
    """Run one process of a run until its lifeline is cut. ``folder``: where the run is recorded.

    ``camera``: whose tracker this is, where there are several.

    RefusedError where the process's place is taken, or where what it needs is not there.
    """
    if not row.instances(config):
        raise RefusedError(row.missing)
    name = _tracker_of(config, camera) if row is TRACKER else row.name
    never_raise(stdout=True)
    held = Lifeline(lifeline, exit_within_s=row.ends_within_s)
    roles = tuple(driver_role(robot) for robot in robots) or (name,)
    with held.logged(", ".join(roles), config.arena.name):
        if row.priority is not None:
            ahead_of_others()
        if row is ROUTER:
            _route(config, held)
            return
        if row is RECORDER:
            _new(folder)
        clock, waker = WallClock(), row.waker()
        # Take the process's place on the bus, then put it together: who is refused has cost the others nothing.
        state_store = FileStateStore(config.arena.name, simulated=config.simulated)
        with closing(_joined(config, roles, clock)) as bus:
            edges = Edges(
                config.trackers.get(name, config), bus, clock, waker, entropy(config.run.seed, roles[0]),
                state_store, lambda progress: held.say(progress.encode()), robots, real_time=True,
                folder=folder, last_word=lambda: held.last_word, take_over=take_over,
            )  # fmt: skip
            try:
                state_store.prove(robots)
            except OSError as error:
                raise unkept(error) from error
            node = _put_together(row, _injected(edges, roles[0]) if config.faults and row.injectable else edges)
            if row.priority:
                realtime_priority(row.priority)
            run(node, clock, held, waker, precise=row.precise)


def _tracker_of(config: Config, camera: str) -> str:
    """Return the name of a camera's tracker; RefusedError where there is no such camera."""
    names = {view.camera.name: name for name, view in config.trackers.items()}
    if not camera and len(names) == 1:
        return next(iter(names.values()))
    if camera not in names:
        raise RefusedError(f"--camera: there is no camera '{camera}': {did_you_mean(camera, names)}")
    return names[camera]


def _new(folder: Path) -> None:
    """Refuse a folder that has a recording, without waiting for a router."""
    file = folder / "run.mcap"
    if file.exists():
        raise RefusedError(f"{file}: File exists: a run is recorded in a folder of its own")


def _route(config: Config, lifeline: Lifeline) -> None:
    """Be Zenoh's router; it begins anew, within the same process, where the keys of its arena have changed.

    All links end with it, so who is revoked is gone, and the others are back as soon as they try again.
    """
    keys = Keys(config)
    beyond = network(config, all_units=config.bus.router != "service")  # a unit's revocation does not end it
    say_rarely = FewLines(say, WallClock().now_ns)
    if beyond is not None:
        _log_refused(say_rarely)
    router = open_router(config.bus.endpoint, beyond)
    try:
        if beyond is not None:
            router.info.declare_link_events_listener(say_linked(beyond.permitted, say_rarely), history=True)
        lifeline.ready()
        while not lifeline.cut:
            if beyond is not None and keys.changed(beyond.permitted):
                say("the keys have changed: the router begins anew")
                beyond = network(config, all_units=False)
                assert beyond is not None
                router.close()  # type: ignore[no-untyped-call]
                router = _opened_again(config, beyond)
                router.info.declare_link_events_listener(say_linked(beyond.permitted, say_rarely), history=True)
            threading.Event().wait(0.05)
    finally:
        router.close()  # type: ignore[no-untyped-call]


def _opened_again(config: Config, beyond: Network) -> zenoh.Session:
    """Open a router where one has just been closed: a QUIC socket is there for a moment longer."""
    clock = WallClock()
    end_ns = clock.now_ns() + _ROUTER_RESTARTS_WITHIN_NS
    while True:
        try:
            return open_router(config.bus.endpoint, beyond)
        except zenoh.ZError:
            if clock.now_ns() > end_ns:
                raise
        clock.sleep_until(clock.now_ns() + 10 * MS)


def _log_refused(say_rarely: FewLines) -> None:
    """Log which links Zenoh refuses, at a limited rate: it writes them to stdout as often as peers try."""
    sys.stdout.flush()
    read, write = os.pipe()
    os.set_blocking(write, False)  # a log that nobody takes up costs lines, and holds up none of Zenoh's threads
    os.dup2(write, sys.__stdout__.fileno() if sys.__stdout__ is not None else 1)
    os.close(write)
    lines = os.fdopen(read, errors="replace")
    threading.Thread(target=say_refused, args=(lines, say_rarely), daemon=True).start()
    zenoh.init_log_from_env_or("warn")


def _joined(config: Config, roles: tuple[str, ...], clock: Clock) -> ZenohBus:
    """Join the bus; RefusedError where another process is there in its place."""
    try:
        return ZenohBus(config.arena.name, config.bus.endpoint, roles[0], clock, roles=roles)
    except RoleTakenError as error:
        raise RefusedError(str(error)) from error


def _injected(edges: Edges, name: str) -> Edges:
    """Return the edges of a process that the configuration's faults may strike."""
    from robofleet.simulation.faults import Schedule  # noqa: PLC0415
    from robofleet.simulation.faulty_bus import FaultyBus  # noqa: PLC0415

    faults = Schedule(edges.config, edges.clock)
    return replace(edges, bus=FaultyBus(edges.bus, faults, name, edges.clock), faults=faults)


def _put_together(row: Row, edges: Edges) -> Node:
    """Return the process; RefusedError or SystemExit with a line where a robot or a camera is not there."""
    assert row.make is not None
    try:
        return row.make(edges)
    except DriverError as error:
        raise RefusedError(str(error)) from error
    except CameraError as error:
        raise SystemExit(f"camera: {error}") from error
