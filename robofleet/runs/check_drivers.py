"""What is refused of robots before a run: their drivers, settings and ports; and those that do not answer."""

import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Iterator, Mapping, Sequence
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

from robofleet.config import slices
from robofleet.config.faults import Complaint, no_errors
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.core.clock import Clock, S, WallClock
from robofleet.core.plugins import PluginError, blamed, lacks, load
from robofleet.nodes.unit import driver_settings
from robofleet.runs.children import ended_by
from robofleet.vehicles.interface import DriverError, SimulatedDriver, is_concurrent

_OWN_SIMULATION = "simulated"
_WARN_AFTER_S, _AT_MOST_S = 1.0, 15.0


def complaints(config: Config, *, lockstep: bool = False) -> Iterator[Complaint]:
    """Return what cannot work: (dotted path, what is wrong and how to mend it). Nothing is opened."""
    ports: dict[str, str] = {}
    for i, robot in enumerate(config.robots):
        wrong = list(of_robot(config, i, lockstep=lockstep))
        yield from wrong
        if not wrong and (port := driver_settings.port(config, robot)) is not None:
            other = ports.setdefault(os.path.realpath(port), robot.id)
            if other != robot.id:
                yield f"robots.{i}.settings.port", f"{other} has this port: each robot needs its own"


def of_robot(config: Config, i: int, *, lockstep: bool = False) -> Iterator[Complaint]:
    """Return what cannot work with one robot."""
    robot = config.robots[i]
    try:
        kind = load("robofleet.drivers", robot.driver)
    except PluginError as error:
        yield f"robots.{i}.driver", str(error)
        return
    if missing := lacks(kind, "write", "read", "close"):
        yield f"robots.{i}.driver", f"{robot.driver!r} has {missing}: write what drivers/YOUR_OWN.md describes"
        return
    if lockstep and not issubclass(kind, SimulatedDriver):
        yield f"robots.{i}.driver", f"{robot.driver!r} keeps real time, and lockstep does not: run without --lockstep"
    if robot.start is None and (robot.twin is not None or issubclass(kind, SimulatedDriver)):
        yield (
            f"robots.{i}.start",
            f"is missing: {robot.id} is in no group and stands nowhere by itself: "
            "write start: {x_m: ..., y_m: ..., heading_deg: ...}",
        )
    if robot.vehicle.simulated is None and issubclass(kind, SimulatedDriver):
        yield no_errors(i)
    if robot.twin is not None:
        try:
            firmware = load("robofleet.twins", robot.twin)
            if hasattr(firmware, "refusal") and (why := firmware.refusal()) is not None:
                yield f"robots.{i}.twin", why
        except PluginError as error:
            yield f"robots.{i}.twin", str(error)
    if wrong := driver_settings.complaints(config, i):
        yield from wrong
    elif hasattr(kind, "refusals"):
        try:
            refused = kind.refusals(driver_settings.of(config, robot), slices.drive(robot))
            yield from [(f"robots.{i}.{path}", words) for path, words in refused]
        except Exception as error:  # noqa: BLE001 - a class of the user's raises anything
            yield f"robots.{i}.driver", f"the refusals of {robot.driver!r} {blamed(error)}"


def unreachable(config: Config) -> list[Complaint]:
    """Open every robot but twins' and close it again; returns which do not answer. Nothing moves.

    A process of its own opens them: a driver may be anybody's, and ends that process alone if it crashes. Drivers that
    say ``concurrent`` are opened at once, the others in order. Simulated ones are opened too, except this project's,
    which open nothing. Drivers that systemd has started have their ports already.
    """
    if config.drivers.started_by == "systemd":
        return []
    here = [robot for robot in config.robots if config.unit_of[robot.id] not in config.daemons]
    robots = [robot for robot in here if robot.twin is None and robot.driver != _OWN_SIMULATION]
    if not robots:
        return []
    context = multiprocessing.get_context("fork")  # the drivers are loaded here already: a fork costs no start-up time
    news, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_open_all, args=(config, robots, news, theirs))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # that this process may have threads: the fork needs none
        process.start()
    theirs.close()
    try:
        wrong = _complaints_of(news, process, robots, WallClock())
    finally:
        process.kill()
        process.join()
        news.close()
    return [(driver_settings.place(config, robot), wrong[robot.id]) for robot in robots if robot.id in wrong]


def _complaints_of(news: Connection, process: BaseProcess, robots: Sequence[Robot], clock: Clock) -> dict[str, str]:
    """Return what is wrong with robots, by id, as the process that opens them reports."""
    complaints: dict[str, str] = {}
    waiting = {robot.id: False for robot in robots}  # whether it is being opened
    warned, deadline_ns = False, clock.now_ns() + round(_WARN_AFTER_S * S)
    while waiting:
        if not news.poll(max(0.0, (deadline_ns - clock.now_ns()) / S)):
            if warned:
                slow = f"its driver did not finish opening it within {_AT_MOST_S:.0f} s: mend the driver"
                return complaints | dict.fromkeys(_opening(waiting), slow)
            names = ", ".join(_opening(waiting))
            print(
                f"waiting for {names} to answer: a board that starts when its port is opened takes seconds",
                file=sys.stderr,
            )
            warned, deadline_ns = True, clock.now_ns() + round(_AT_MOST_S * S)
            continue
        try:
            robot, complaint = news.recv()
        except EOFError:  # the process is gone
            process.join()
            crash = f"the process that opened it {ended_by(process.exitcode or 0)}: mend its driver"
            return complaints | dict.fromkeys(_opening(waiting), crash)
        if complaint is None:
            waiting[robot] = True
        else:
            del waiting[robot]
            complaints |= {robot: complaint} if complaint else {}
            if warned:
                deadline_ns = clock.now_ns() + round(_AT_MOST_S * S)
    return complaints


def _opening(waiting: Mapping[str, bool]) -> list[str]:
    """Return the robots that are being opened; where none is, all that are left: none of them has answered."""
    return [robot for robot, begun in waiting.items() if begun] or [*waiting]


def _open_all(config: Config, robots: Sequence[Robot], theirs: Connection, news: Connection) -> None:
    """Open and close every robot, and report of each that it begins and what came of it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal's Ctrl-C is the command's to answer
    theirs.close()
    clock, world, reporting = WallClock(), slices.world(config), threading.Lock()

    def report(robot: Robot, complaint: str | None) -> None:
        with reporting:
            news.send((robot.id, complaint))

    def attempt(robots: Sequence[Robot]) -> None:
        for robot in robots:
            report(robot, None)
            try:
                kind = load("robofleet.drivers", robot.driver)
                kind(driver_settings.context(config, robot, clock.now_ns, world)).close()
            except Exception as error:  # noqa: BLE001 - a robot that cannot be opened cannot drive, whatever the reason
                report(robot, str(error) if isinstance(error, DriverError) else f"{robot.driver!r} {blamed(error)}")
            else:
                report(robot, "")

    at_once = {robot.id for robot in robots if is_concurrent(load("robofleet.drivers", robot.driver))}
    threads = [threading.Thread(target=attempt, args=([robot],)) for robot in robots if robot.id in at_once]
    for thread in threads:
        thread.start()
    attempt([robot for robot in robots if robot.id not in at_once])
    for thread in threads:
        thread.join()
