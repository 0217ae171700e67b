"""What is refused of robots before a run: their drivers, settings and ports; and those that do not answer."""

import os
import sys
import threading
from collections.abc import Iterator, Sequence

from robofleet.clock import Clock, S, WallClock
from robofleet.config import slices
from robofleet.config.faults import Complaint, no_errors
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.plugins import PluginError, load
from robofleet.processes import driver_settings
from robofleet.processes.attached import in_words
from robofleet.vehicles.interface import SimulatedDriver

_TOLD_AFTER_S, _AT_MOST_S = 1.0, 15.0


def complaints(config: Config, *, lockstep: bool = False) -> Iterator[Complaint]:
    """Return what cannot work: (dotted path, what is wrong and how to mend it). Nothing is opened."""
    ports: dict[str, str] = {}
    for i, robot in enumerate(config.robots):
        wrong = list(of_robot(config, i, lockstep=lockstep))
        yield from wrong
        if not wrong and robot.twin is None and (port := driver_settings.port(config, robot)) is not None:
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
            load("robofleet.twins", robot.twin)
        except PluginError as error:
            yield f"robots.{i}.twin", str(error)
    if wrong := driver_settings.complaints(config, i):
        yield from wrong
    elif hasattr(kind, "refusals"):
        refused = kind.refusals(driver_settings.of(config, robot), slices.drive(robot))
        yield from ((f"robots.{i}.{path}", words) for path, words in refused)


def unreachable(config: Config) -> list[Complaint]:
    """Open every robot but twins', all at once, and close them again; returns which do not answer. Nothing moves.

    Simulated ones are opened too: their drivers may be anybody's. Drivers that systemd has started have their ports
    already.
    """
    if config.drivers.started_by == "systemd":
        return []
    clock = WallClock()
    here = [robot for robot in config.robots if config.unit_of[robot.id] not in config.daemons]
    attempts = [_Attempt(config, robot, clock) for robot in here if robot.twin is None]
    if slow := _unfinished(attempts, clock.now_ns() + round(_TOLD_AFTER_S * S), clock):
        names = ", ".join(attempt.robot.id for attempt in slow)
        print(
            f"waiting for {names} to answer: a board that starts when its port is opened takes seconds", file=sys.stderr
        )
    for attempt in _unfinished(slow, clock.now_ns() + round(_AT_MOST_S * S), clock):
        attempt.complaint = f"its driver did not finish opening it within {_AT_MOST_S:.0f} s: mend the driver"
    return [(driver_settings.place(config, a.robot), a.complaint) for a in attempts if a.complaint]


class _Attempt(threading.Thread):
    """One robot that is opened and closed."""

    def __init__(self, config: Config, robot: Robot, clock: Clock) -> None:
        super().__init__(daemon=True)
        self.robot, self.complaint = robot, ""
        self._kind = load("robofleet.drivers", robot.driver)
        self._context = driver_settings.context(config, robot, clock.now_ns)
        self.start()

    def run(self) -> None:
        try:
            self._kind(self._context).close()
        except Exception as error:  # noqa: BLE001 - a robot that cannot be opened cannot drive, whatever the reason
            self.complaint = in_words(error)


def _unfinished(attempts: Sequence[_Attempt], deadline_ns: int, clock: Clock) -> list[_Attempt]:
    for attempt in attempts:
        attempt.join(max(0.0, (deadline_ns - clock.now_ns()) / S))
    return [attempt for attempt in attempts if attempt.is_alive()]
