"""One robot behind its gate: what arrives, what is written to the wheels, what is measured, what is kept.

It is a robot that exists, or one of a simulation that somebody else wrote. ``simulated_robots.py`` has those of
``drivers/simulated.py``, many at once.
"""

import math
from collections.abc import Callable, Sequence
from copy import copy
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.bus import sensors
from robofleet.bus.messages import (
    UNIT_STATUS,
    UNIT_TRUTH,
    LeaseAnswer,
    RobotStatus,
    Truth,
    UnitCommand,
    UnitEnable,
)
from robofleet.bus.sensors import SensorsSaid
from robofleet.core.clock import MS, S
from robofleet.nodes.unit.health import Health
from robofleet.nodes.unit.keeping import RobotState, StateStore, kept
from robofleet.safety import gate
from robofleet.safety.gate import GateState, Inputs, LeaseAction
from robofleet.safety.latches import GateStatus, Latch
from robofleet.vehicles.interface import STOP, Driver, DriverContext, DriverError, SimulatedDriver, WheelSpeeds
from robofleet.vehicles.readings import SensorReading

TURNING_RAD_S = 0.05  # a wheel that is measured faster than this is not at rest
# In health a gate lives on nonces of up to 60 ms: a status every 20 ms, an enable every 40 ms.
BAD_LINK_NS = 70 * MS
NO_LINK_NS = S // 2  # it is not a bad one
HURRY_NS = 60 * S
LOOK_NS = gate.VALID_NS // 2  # so often a gate is stepped while it changes: twice that, and it was held up

Probe = Callable[[str, int, Inputs, GateState], None]  # robot, instant, what its gate got and decided


class GatedRobots:
    """The robots of a unit, each behind its gate; ``now_ns`` is asked again for each: the one before may block."""

    def __init__(
        self, contexts: Sequence[DriverContext], drivers: Sequence[Driver], boot_id: int, keeping: StateStore,
        probe: Probe | None, now_ns: Callable[[], int],
    ) -> None:  # fmt: skip
        self._now_ns = now_ns
        self._robots = [
            GatedRobot(context, driver, boot_id, keeping, probe)
            for context, driver in zip(contexts, drivers, strict=True)
        ]
        self._simulated = [index for index, driver in enumerate(drivers) if isinstance(driver, SimulatedDriver)]

    def __len__(self) -> int:
        """Return how many robots these are."""
        return len(self._robots)

    @property
    def boot_id(self) -> int:
        """What was drawn when the unit started, and counted on whenever its clock was set back."""
        return self._robots[0].boot_id

    @property
    def deadline_ns(self) -> int:
        """When a gate must be asked again."""
        return min(robot.deadline_ns for robot in self._robots)

    @property
    def hurries(self) -> bool:
        """Whether the link was bad a short while ago."""
        return any(robot.hurries for robot in self._robots)

    @property
    def newest_nonce_ns(self) -> int:
        """The newest nonce that a command and a permission have echoed."""
        return max(robot.newest_nonce_ns for robot in self._robots)

    @property
    def latch_is_new(self) -> bool:
        """Whether the newest status does not tell of a gate's latch yet."""
        return any(robot.latch_is_new for robot in self._robots)

    @property
    def any_open(self) -> bool:
        """Whether a gate lets a controller's commands through."""
        return any(robot.is_open for robot in self._robots)

    def set_back(self, from_ns: int, now_ns: int) -> None:
        """Let every gate begin anew: the clock was set back."""
        for robot in self._robots:
            robot.set_back(from_ns, now_ns)

    def pass_on(
        self, _now_ns: int, command: tuple[NDArray[Any], NDArray[Any]] | None,
        enable: tuple[NDArray[Any], NDArray[Any]] | None, *, due: bool,
    ) -> None:  # fmt: skip
        """Let the gates decide on what arrived, and write the wheels; read the robots before, if that is due."""
        inputs = [Inputs() for _ in self._robots]
        exposure_ns = 0 if command is None else _put_command(inputs, *command)
        if enable is not None:
            _put_permission(inputs, *enable)
        for robot, given in zip(self._robots, inputs, strict=True):
            if due:
                robot.look(self._now_ns())
            robot.pass_on(self._now_ns(), given, exposure_ns)

    def lease(self, session: int, action: LeaseAction, _now_ns: int) -> tuple[LeaseAnswer, ...]:
        """Answer a request for the leases; an epoch that a restart would give out again is not given out."""
        return tuple(robot.lease(session, action, self._now_ns()) for robot in self._robots)

    def keep(self, *, due: bool) -> None:
        """Keep what must be kept of the gates: a lease's epoch, a latch."""
        for robot in self._robots:
            robot.keep(due=due)

    def statuses(self, now_ns: int, refused: int) -> NDArray[Any]:
        """Return every robot's part of a status; ``refused``: messages of the unit that nobody could read."""
        return np.array([robot.status(now_ns, refused) for robot in self._robots], UNIT_STATUS.item_dtype)

    def truths(self) -> NDArray[Any] | None:
        """Return the part of a truth of each that is simulated; None where all exist."""
        truths = [self._robots[index].truth(index) for index in self._simulated]
        return np.array(truths, UNIT_TRUTH.item_dtype) if truths else None

    def sensors(self) -> SensorsSaid:
        """Return what is said of the sensors of each that tells of them, and answers."""
        readings = ((index, robot.sensors) for index, robot in enumerate(self._robots))
        return sensors.said((index, reading) for index, reading in readings if reading is not None)

    def say(self) -> None:
        """Say in the log what there is to complain about."""
        for robot in self._robots:
            robot.say()

    def close(self) -> None:
        """Motors off, every robot, whatever one of them does."""
        errors = []
        for robot in self._robots:
            try:
                robot.close()
            except Exception as error:  # noqa: BLE001 - the others' motors must go off too
                errors.append(error)
        if errors:
            raise ExceptionGroup("closing the drivers", errors)


class GatedRobot:
    """One robot: what arrives passes the gate, what passes moves the wheels, what is measured is published."""

    def __init__(
        self, context: DriverContext, driver: Driver, boot_id: int, keeping: StateStore, probe: Probe | None
    ) -> None:
        self._robot, self._driver, self._drive = context.robot, driver, context.drive
        self._probe = probe
        self._health = Health(context.robot, context.now_ns())
        self._memory = RobotState(context.robot, keeping, self._health.complain)
        self._gate = GateState(boot_id=boot_id, **self._memory.kept._asdict())
        self._written: WheelSpeeds | None = None
        self._last_command, self._told_ns, self._reported_wheels = (0.0, 0.0), 0, STOP
        self._accepted_exposure_ns: int | None = None  # of a command that has not reached the wheels yet
        self._applied = (0, 0)  # the newest one that has: its exposure, and when
        self._opened = False  # the gate was open: before, late messages are those of processes that start
        self._hurry_until_ns = 0
        self._closed = False
        self._told_latch = (self._gate.latch, self._gate.latch_id)  # in the newest status
        self._retry = False  # what the robot was told last may not have reached it
        self.look(context.now_ns())

    @property
    def boot_id(self) -> int:
        """What every message to it must echo."""
        return self._gate.boot_id

    @property
    def deadline_ns(self) -> int:
        """When its gate must be asked again."""
        return self._gate.deadline_ns

    @property
    def newest_nonce_ns(self) -> int:
        """The newest nonce that a command and a permission have echoed."""
        return min(self._gate.command_nonce, self._gate.enabled_nonce)

    @property
    def is_open(self) -> bool:
        """Whether its gate lets a controller's commands through."""
        return self._gate.status == GateStatus.OPEN

    def set_back(self, from_ns: int, now_ns: int) -> None:
        """Let the gate begin anew: the clock was set back."""
        self._gate.at_ns = from_ns
        self.pass_on(now_ns, Inputs(), 0)

    @property
    def hurries(self) -> bool:
        """Whether its link was bad a short while ago: then its status goes out in every loop."""
        return self._gate.at_ns < self._hurry_until_ns

    def look(self, now_ns: int) -> None:
        """Read the robot, and tell it again what may have been lost on its way: to stand, or what failed."""
        self._retry = self._health.look(self._driver, self._gate.latch, self._gate.output, now_ns)
        if not self.is_open and self._gate.output == STOP:
            self._retry = False
            self._write(STOP)

    def pass_on(self, now_ns: int, inputs: Inputs, exposure_ns: int) -> None:
        """Let the gate decide on what arrived, and write the wheels; ``exposure_ns``: of the image behind a command."""
        state = self._gate
        quiet = not inputs.command and not inputs.permission and self._health.latch <= state.latch
        timed = state.deadline_ns != gate.NEVER_NS and now_ns >= min(state.deadline_ns, state.at_ns + LOOK_NS)
        if quiet and not timed and not self._retry and now_ns >= state.at_ns:
            return  # the gate's output changes by a message, by the robot's own stop, at its deadline
        self._opened = self._opened or self.is_open
        age_ns = now_ns - self.newest_nonce_ns
        if self._opened and BAD_LINK_NS < age_ns < NO_LINK_NS:
            self._hurry_until_ns = now_ns + HURRY_NS
        seq = state.seq
        self._step(inputs, now_ns)
        self._adopt(inputs, now_ns, again=inputs.command or self._retry)
        self._retry = False
        if inputs.command and exposure_ns != self._applied[0] and state.seq != seq:
            self._accepted_exposure_ns = exposure_ns
        if self._accepted_exposure_ns is not None and self.is_open:
            self._applied, self._accepted_exposure_ns = (self._accepted_exposure_ns, now_ns), None

    @property
    def latch_is_new(self) -> bool:
        """Whether the newest status does not tell of the gate's latch yet."""
        return (self._gate.latch, self._gate.latch_id) != self._told_latch

    def keep(self, *, due: bool) -> None:
        """Keep what must be kept of the gate."""
        self._memory.keep(kept(self._gate), due=due)

    def lease(self, session: int, action: LeaseAction, now_ns: int) -> LeaseAnswer:
        """Answer a request for the lease."""
        inputs, before = Inputs(lease=True, lease_session=session, lease_action=action), copy(self._gate)
        granted = self._step(inputs, now_ns)
        if self._gate.epoch != before.epoch and not self._memory.save(kept(self._gate)):
            # an epoch that a restart would give out again is not given out: nothing has happened
            self._gate, granted = before, 0
        else:
            self._adopt(inputs, now_ns)
        return LeaseAnswer(granted, self._gate.epoch, self._gate.session)

    def truth(self, index: int) -> Truth:
        """Return where the robot really is, if it is simulated; ``place``: in its unit."""
        assert isinstance(self._driver, SimulatedDriver)
        return Truth(index, *self._driver.truth())

    @property
    def sensors(self) -> SensorReading | None:
        """What its sensors say; None where they say nothing, and where its driver has lost it."""
        return None if self._health.failed else self._health.reading.sensors

    def say(self) -> None:
        """Say in the log what there is to complain about."""
        self._health.say()

    def close(self) -> None:
        """Motors off at once, driver closed. Idempotent."""
        if not self._closed:
            self._closed = True
            try:
                self._driver.write(STOP)
            except DriverError as error:
                self._health.complain(f"its wheels did not get the last stop command: {error}")
            finally:
                self._driver.close()
                self._health.say()

    def _step(self, inputs: Inputs, now_ns: int) -> int:
        """Let the gate take what arrived, and the robot's own state; return its answer to a lease request."""
        reading = self._health.reading
        inputs.latch = self._health.latch
        inputs.turning = max(abs(reading.left_speed), abs(reading.right_speed)) > TURNING_RAD_S
        return gate.step(self._gate, self._drive, inputs, now_ns)

    def _adopt(self, inputs: Inputs, now_ns: int, *, again: bool = False) -> None:
        """Do what the gate decided; ``again`` tells the robot also what it was told before."""
        if self._probe is not None:
            self._probe(self._robot, now_ns, inputs, copy(self._gate))
        output = self._gate.output
        if again or output != self._written:
            self._last_command, self._told_ns, self._reported_wheels = self._told_until(now_ns), now_ns, output
            self._write(output)
        if self._health.latch > self._gate.latch:  # just now
            inputs = Inputs()
            self._step(inputs, now_ns)
            self._adopt(inputs, now_ns)

    def _told_until(self, now_ns: int) -> tuple[float, float]:
        """Return how far the wheels were told to turn [rad]."""
        (left, right), (told_left, told_right), since_s = (
            self._reported_wheels,
            self._last_command,
            (now_ns - self._told_ns) * 1e-9,
        )
        return told_left + left * since_s, told_right + right * since_s

    def _write(self, wheels: WheelSpeeds) -> None:
        try:
            self._driver.write(wheels)
            self._written = wheels
        except Exception as error:  # noqa: BLE001 - whatever a driver does, it is its own robot that stops
            self._health.fail(error)
            self._written = None

    def status(self, now_ns: int, refused: int) -> RobotStatus:
        """Return its part of a status; ``refused``: messages of the unit that nobody could read."""
        state, reading = self._gate, self._health.reading
        self._told_latch = (state.latch, state.latch_id)
        battery = reading.battery if math.isfinite(reading.battery) else -1.0
        return RobotStatus(
            state.epoch, state.session, *self._applied, state.refused + refused, state.status, state.latch,
            state.latch_id, self._health.faults(state.latch), state.target_after_ns, state.output_after_ns,
            reading.left_angle, reading.right_angle, reading.left_speed, reading.right_speed, *state.output,
            *self._told_until(now_ns), battery,
        )  # fmt: skip


def _put_command(inputs: Sequence[Inputs], head: NDArray[Any], items: NDArray[Any]) -> int:
    """Tell each robot what a unit's command says to it; return the exposure behind it."""
    whole = UnitCommand._make([*head[0].item()[1:-1], ()])
    for i, (epoch, left, right) in zip(inputs, items.tolist(), strict=True):
        if epoch:
            i.command, i.command_epoch, i.command_session, i.command_seq = True, epoch, whole.session, whole.seq
            i.command_boot_id, i.command_nonce = whole.boot_id, whole.nonce
            i.command_left, i.command_right = left, right
    return whole.exposure_ns


def _put_permission(inputs: Sequence[Inputs], head: NDArray[Any], items: NDArray[Any]) -> None:
    """Tell each robot its permission; a latch of another version is the emergency stop."""
    whole = UnitEnable._make([*head[0].item()[1:-1], ()])
    for i, (epoch, latch, clear, limit) in zip(inputs, items.tolist(), strict=True):
        i.permission, i.permission_epoch, i.permission_seq = True, epoch, whole.seq
        i.permission_boot_id, i.permission_nonce = whole.boot_id, whole.nonce
        i.permission_latch = latch if latch <= max(Latch) else Latch.EMERGENCY_STOP
        i.permission_clear, i.permission_limit = clear, limit
