"""The robots of a unit that have a driver each: their gates, what is written to the wheels, what is measured.

These are real robots, and those of a simulation that somebody else wrote. ``simulated_robots.py`` has those of
``drivers/simulated.py``, many at once.
"""

import math
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from copy import copy
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.bus import sensors
from robofleet.bus.messages import (
    UNIT_STATUS,
    UNIT_TRUTH,
    Enable,
    LeaseAnswer,
    RobotStatus,
    Truth,
    UnitCommand,
    UnitEnable,
    WheelCommand,
)
from robofleet.bus.sensors import SensorMessage
from robofleet.nodes.unit import link
from robofleet.nodes.unit.reconnecting_driver import in_words, sound
from robofleet.nodes.unit.state_store import RobotState, StateStore
from robofleet.safety.gate import GateState, Inputs, LeaseAction
from robofleet.safety.latches import GateStatus
from robofleet.vehicles.interface import STOP, Driver, DriverContext, DriverError, SimulatedDriver, WheelSpeeds
from robofleet.vehicles.readings import SensorReading

UnitMessage = tuple[NDArray[Any], NDArray[Any]]  # a message's head (1,) and its items (N,)
Probe = Callable[[str, int, Inputs, GateState], None]  # robot, instant, what its gate got and decided


class Complaints:
    """What the log is to say of a unit's robots, each complaint once."""

    def __init__(self) -> None:
        self._newest: dict[str, str] = {}
        self._lines: list[str] = []

    def add(self, robot: str, complaint: str) -> None:
        if complaint != self._newest.get(robot):
            self._newest[robot] = complaint
            self._lines.append(f"{robot}: {complaint}")

    def say(self) -> None:
        """Write the new ones: a log may be slow, so the wheels and the bus go first."""
        if self._lines:
            lines, self._lines = self._lines, []
            print("\n".join(lines), file=sys.stderr)


class Robots(ABC):
    """The robots of a unit (N,), each behind its gate."""

    def __init__(self) -> None:
        self._complaints = Complaints()
        self._pending = 0  # what is still to do, as bits of ``link.settle``

    @property
    def hurries(self) -> bool:
        """Whether the link was bad a short while ago: then a status goes out in every loop."""
        return bool(self._pending & link.HURRIES)

    @property
    def latch_is_new(self) -> bool:
        """Whether the newest status does not tell of a gate's latch yet."""
        return bool(self._pending & link.NEW_LATCH)

    def say(self) -> None:
        """Say in the log what there is to complain about."""
        self._complaints.say()

    @abstractmethod
    def __len__(self) -> int:
        """Return how many robots these are."""

    @property
    @abstractmethod
    def boot_id(self) -> int:
        """What every message to them must echo: drawn at the unit's start, counted on when its clock is set back."""

    @property
    @abstractmethod
    def deadline_ns(self) -> int:
        """When a gate must be asked again."""

    @property
    @abstractmethod
    def newest_nonce_ns(self) -> int:
        """The newest nonce that a command and a permission have echoed: by it the gates live."""

    @property
    @abstractmethod
    def any_open(self) -> bool:
        """Whether a gate lets a controller's commands through."""

    @abstractmethod
    def set_back(self, from_ns: int, now_ns: int) -> None:
        """Let every gate begin anew: the clock was set back from one instant to another."""

    @abstractmethod
    def pass_on(self, now_ns: int, command: UnitMessage | None, enable: UnitMessage | None, *, due: bool) -> None:
        """Let the gates decide on what arrived, and write the wheels; read the robots before, if that is due."""

    @abstractmethod
    def lease(self, session: int, action: LeaseAction, now_ns: int) -> tuple[LeaseAnswer, ...]:
        """Answer a request for the leases."""

    @abstractmethod
    def keep(self, *, due: bool) -> None:
        """Keep a lease's epoch and a latch of the gates: the disk is slow, so every robot's wheels went before."""

    @abstractmethod
    def statuses(self, now_ns: int, refused: int) -> NDArray[Any]:
        """Return every robot's part of a status; ``refused``: messages of the unit that nobody could read."""

    @abstractmethod
    def truths(self) -> NDArray[Any] | None:
        """Return the part of a truth of each that is simulated; None where all exist."""

    @abstractmethod
    def sensors(self) -> SensorMessage:
        """Return what is said of the sensors of each that tells of them; asked where somebody wants to know."""

    @abstractmethod
    def close(self) -> None:
        """Motors off at once, drivers closed. Idempotent."""


class GatedRobots(Robots):
    """The robots of a unit, each behind its gate; ``now_ns`` is asked again for each: the one before may block."""

    def __init__(
        self, contexts: Sequence[DriverContext], drivers: Sequence[Driver], boot_id: int, state_store: StateStore,
        probe: Probe | None, now_ns: Callable[[], int],
    ) -> None:  # fmt: skip
        super().__init__()
        self._now_ns = now_ns
        self._robots = [
            GatedRobot(context, driver, boot_id, state_store, probe, self._complaints)
            for context, driver in zip(contexts, drivers, strict=True)
        ]
        self._simulated = [index for index, driver in enumerate(drivers) if isinstance(driver, SimulatedDriver)]

    def __len__(self) -> int:
        return len(self._robots)

    @property
    def boot_id(self) -> int:
        return self._robots[0].gate.boot_id

    @property
    def deadline_ns(self) -> int:
        return min(robot.gate.deadline_ns for robot in self._robots)

    @property
    def newest_nonce_ns(self) -> int:
        return max(min(robot.gate.command_nonce, robot.gate.enabled_nonce) for robot in self._robots)

    @property
    def any_open(self) -> bool:
        return any(robot.gate.status == GateStatus.OPEN for robot in self._robots)

    def set_back(self, from_ns: int, now_ns: int) -> None:
        for robot in self._robots:
            robot.gate.at_ns = from_ns
            self._pending |= robot.pass_on(now_ns, Inputs(), 0)

    def pass_on(self, _now_ns: int, command: UnitMessage | None, enable: UnitMessage | None, *, due: bool) -> None:
        inputs = [Inputs() for _ in self._robots]
        exposure_ns = 0
        if command is not None:
            message = UnitCommand._make([*command[0][0].item()[1:-1], ()])
            exposure_ns = message.exposure_ns
            for i, item in zip(inputs, command[1].tolist(), strict=True):
                link.put_command(i, message, WheelCommand(*item))
        if enable is not None:
            permission = UnitEnable._make([*enable[0][0].item()[1:-1], ()])
            for i, item in zip(inputs, enable[1].tolist(), strict=True):
                link.put_permission(i, permission, Enable(*item))
        self._pending = 0
        for robot, given in zip(self._robots, inputs, strict=True):
            if due:
                robot.look(self._now_ns())
            self._pending |= robot.pass_on(self._now_ns(), given, exposure_ns)

    def lease(self, session: int, action: LeaseAction, _now_ns: int) -> tuple[LeaseAnswer, ...]:
        return tuple(robot.lease(session, action, self._now_ns()) for robot in self._robots)

    def keep(self, *, due: bool) -> None:
        if self._pending & link.TO_STORE:
            for robot in self._robots:
                robot.keep(due=due)

    def statuses(self, now_ns: int, refused: int) -> NDArray[Any]:
        self._pending &= ~link.NEW_LATCH
        return np.array([robot.status(now_ns, refused) for robot in self._robots], UNIT_STATUS.item_dtype)

    def truths(self) -> NDArray[Any] | None:
        truths = [self._robots[index].truth(index) for index in self._simulated]
        return np.array(truths, UNIT_TRUTH.item_dtype) if truths else None

    def sensors(self) -> SensorMessage:
        readings = ((index, robot.sensors) for index, robot in enumerate(self._robots))
        return sensors.said((index, reading) for index, reading in readings if reading is not None)

    def close(self) -> None:
        errors = []
        for robot in self._robots:
            try:
                robot.close()
            except Exception as error:  # noqa: BLE001 - the others' motors must go off too
                errors.append(error)
        self.say()
        if errors:
            raise ExceptionGroup("closing the drivers", errors)


class GatedRobot:
    """One robot: what arrives passes the gate, what passes moves the wheels, what is measured is published."""

    def __init__(
        self, context: DriverContext, driver: Driver, boot_id: int, state_store: StateStore, probe: Probe | None,
        complaints: Complaints,
    ) -> None:  # fmt: skip
        self._robot, self._driver, self._drive = context.robot, driver, context.drive
        self._probe, self._complaints = probe, complaints
        self._memory = RobotState(context.robot, state_store, self._complain)
        self.gate = GateState(boot_id=boot_id, **self._memory.kept._asdict())
        self._link = link.new_link(self.gate, context.now_ns())
        self._sensors: SensorReading | None = None
        self._away = False  # its driver failed, and has not reconnected yet
        self._closed = False
        self.look(context.now_ns())

    def look(self, now_ns: int) -> None:
        """Read the robot, and command it again what may have been lost on its way: to stand, or what failed."""
        l = self._link
        l.retry, l.failed = l.failed, False
        try:
            reading = sound(self._driver.read())
        except Exception as error:  # noqa: BLE001 - whatever a driver does, it is its own robot that stops
            self._fail(error)
        else:
            l.left_angle, l.right_angle, l.left_speed, l.right_speed, l.battery, l.faults, self._sensors = reading
            if self._away and not l.retry:
                self._away = False
                self._complain("its driver has reconnected: look at the robot, then reset")
        stop_again = link.look(self.gate, l, now_ns)
        if l.runaway == 1:
            self._complain(link.runaway_complaint(l))
        if stop_again:
            l.retry = False
            self._write(STOP)

    def pass_on(self, now_ns: int, inputs: Inputs, exposure_ns: int) -> int:
        """Let the gate decide on what arrived, and write the wheels; return what is still to do, as ``link.settle``."""
        self._decide(inputs, exposure_ns, now_ns)
        return link.settle(self.gate, self._link, now_ns)

    def _decide(self, inputs: Inputs, exposure_ns: int, now_ns: int) -> None:
        write = link.pass_on(self.gate, self._link, self._drive, inputs, exposure_ns, now_ns)
        if self._link.stepped:
            self._obey(inputs, now_ns, write=write)

    def _obey(self, inputs: Inputs, now_ns: int, *, write: bool) -> None:
        if self._probe is not None:
            self._probe(self._robot, now_ns, inputs, copy(self.gate))
        if write:
            self._write(self.gate.output)
        if self._link.latch > self.gate.latch:  # it failed just now
            self._decide(Inputs(), 0, now_ns)

    def keep(self, *, due: bool) -> None:
        link.store(self.gate, self._link, self._memory, due=due)

    def lease(self, session: int, action: LeaseAction, now_ns: int) -> LeaseAnswer:
        l = self._link
        inputs, after, answer = link.take_lease(self.gate, l, self._drive, self._memory, session, action, now_ns)
        if after is not self.gate:
            self.gate = after
            self._obey(inputs, now_ns, write=link.take_output(after, l, False, now_ns))
        return answer

    def status(self, now_ns: int, refused: int) -> RobotStatus:
        """Return its part of a status; ``refused``: messages of the unit that nobody could read."""
        status = SimpleNamespace()
        link.fill_status(status, self.gate, self._link, now_ns, refused)
        return RobotStatus(**vars(status))

    def truth(self, index: int) -> Truth:
        """Return where the robot really is, if it is simulated; ``place``: in its unit."""
        assert isinstance(self._driver, SimulatedDriver)
        return Truth(index, *self._driver.truth())

    @property
    def sensors(self) -> SensorReading | None:
        """What its sensors say; None where they say nothing, and where its driver has lost it."""
        return None if self._link.failed else self._sensors

    def close(self) -> None:
        """Motors off at once, driver closed. Idempotent."""
        if not self._closed:
            self._closed = True
            try:
                self._driver.write(STOP)
            except DriverError as error:
                self._complain(f"its wheels did not get the last stop command: {error}")
            finally:
                self._driver.close()

    def _write(self, wheels: WheelSpeeds) -> None:
        l = self._link
        try:
            self._driver.write(wheels)
            l.left_written, l.right_written = wheels
        except Exception as error:  # noqa: BLE001 - whatever a driver does, it is its own robot that stops
            self._fail(error)
            l.left_written = l.right_written = math.nan

    def _fail(self, error: Exception) -> None:
        self._away = True
        link.fail(self._link)
        self._complain(f"its driver failed: {in_words(error)}")

    def _complain(self, complaint: str) -> None:
        self._complaints.add(self._robot, complaint)
