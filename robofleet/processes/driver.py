"""A driver process: one robot or several, each behind its gate. It owns the gates; the drivers know no bus."""

from dataclasses import dataclass

import numpy as np

from robofleet.clock import MS, Clock
from robofleet.comms.bus import Bus, Inbox, Publish, Wake
from robofleet.comms.keys import COMMAND, ENABLE, STATUS, TRUTH
from robofleet.comms.messages import (
    ENABLE as ENABLE_LAYOUT,
)
from robofleet.comms.messages import (
    ROBOT_STATUS,
    WHEEL_COMMAND,
    Enable,
    RobotStatus,
    Truth,
    WheelCommand,
)
from robofleet.comms.messages import (
    TRUTH as TRUTH_LAYOUT,
)
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.plugins import load
from robofleet.safety import gate
from robofleet.safety.gate import GateState, GateStatus
from robofleet.safety.supervisor import Phase
from robofleet.vehicles.interface import (
    STOP,
    Driver,
    DriverContext,
    DriverReading,
    SimulatedDriver,
    Simulation,
    WheelSpeeds,
)

_LOOP_NS = 10 * MS
_EPOCH = 1


@dataclass
class _Applied:
    """The newest command that reached the wheels."""

    exposure_ns: int = 0
    at_ns: int = 0


class GatedRobot:
    """One robot: what arrives passes the gate, what passes moves the wheels, what is measured is published."""

    def __init__(
        self, robot_id: str, context: DriverContext, driver: Driver, boot_id: int, bus: Bus, wake: Wake
    ) -> None:
        self._driver, self._drive = driver, context.drive
        self._gate = GateState(boot_id)
        self._commands = Inbox(bus.newest(COMMAND, robot_id, wake), WHEEL_COMMAND)
        self._enables = Inbox(bus.newest(ENABLE, robot_id, wake), ENABLE_LAYOUT)
        self._publish_status = bus.publisher(STATUS, robot_id)
        self._publish_truth: Publish | None = None
        if isinstance(driver, SimulatedDriver):
            self._publish_truth, self._truth = bus.publisher(TRUTH, robot_id), driver.truth
        self._written: WheelSpeeds | None = None
        self._status = GateStatus.NO_ENABLE
        self._deadline_ns: int | None = 0
        self._applied = _Applied()
        self._seq = 0
        self._closed = False

    def pass_on(self, now_ns: int) -> int | None:
        """Let the gate decide on what arrived, write the wheels, and return the gate's own deadline [ns]."""
        command, permission = self._commands.take(), self._enables.take()
        if command is None and permission is None and (self._deadline_ns is None or now_ns < self._deadline_ns):
            return self._deadline_ns  # the gate's output changes by a message or at its deadline
        asked = None if command is None else _command(command)
        allowed = None if permission is None else _permission(permission)
        self._gate, output = gate.step(self._gate, self._drive, asked, allowed, now_ns)
        self._status = output.status
        if command is not None or output.target != self._written:
            self._driver.write(output.target)
            self._written = output.target
            if command is not None and asked is not None and output.target is asked.wheels:  # it was not refused
                self._applied = _Applied(command.exposure_ns, now_ns)
        self._deadline_ns = output.deadline_ns
        return output.deadline_ns

    def publish(self, now_ns: int, *, status: bool) -> None:
        """Publish the robot's status, and the truth of a simulated one."""
        self._seq += 1
        if self._status is not GateStatus.OPEN:
            self._driver.write(STOP)  # again and again: on its way to a real robot one may get lost
        if self._publish_truth is not None:
            self._publish_truth(TRUTH_LAYOUT.encode(Truth(_EPOCH, self._seq, now_ns, *self._truth())))
        if status:
            self._publish_status(ROBOT_STATUS.encode(self._message(self._driver.read(), now_ns)))

    def close(self) -> None:
        """Motors off, driver closed. Idempotent."""
        if not self._closed:
            self._closed = True
            try:
                self._driver.write(STOP)
            finally:
                self._driver.close()

    def _message(self, reading: DriverReading, now_ns: int) -> RobotStatus:
        rejected = self._gate.refused + self._commands.rejected + self._enables.rejected
        battery = -1.0 if reading.battery != reading.battery else reading.battery
        return RobotStatus(
            _EPOCH, self._seq, self._gate.boot_id, now_ns, now_ns, self._applied.exposure_ns, self._applied.at_ns,
            rejected, self._status, reading.faults, reading.left_angle, reading.right_angle,
            reading.left_speed, reading.right_speed, battery,
        )  # fmt: skip


class DriverProcess:
    """The robots of one driver process: a 100 Hz loop that also wakes for a message and for a gate's deadline."""

    def __init__(
        self,
        config: Config,
        robot_ids: tuple[str, ...],
        bus: Bus,
        clock: Clock,
        wake: Wake,
        rng: np.random.Generator,
    ) -> None:
        self._clock = clock
        self._robots: list[GatedRobot] = []
        try:
            self._open(config, robot_ids, bus, wake, rng)
        except BaseException:
            self.close()
            raise
        self._loop_ns = clock.now_ns() + int(rng.integers(_LOOP_NS))  # loops of several processes are not in phase
        self._loops = 0

    def _open(self, config: Config, robot_ids: tuple[str, ...], bus: Bus, wake: Wake, rng: np.random.Generator) -> None:
        for robot_id in robot_ids:
            robot = config.robot(robot_id)
            context = DriverContext(
                robot_id,
                slices.drive(robot),
                Simulation(
                    slices.vehicle_drive(robot.vehicle),
                    slices.imperfections(robot.vehicle),
                    slices.start_pose(robot),
                    slices.stalls(config, robot_id),
                    slices.generator(config.run.seed, "plant", robot_id),
                ),
                self._clock.now_ns,
            )
            driver: Driver = load("robofleet.drivers", robot.driver)(context)
            boot_id = int(rng.integers(1, 2**63))
            self._robots.append(GatedRobot(robot_id, context, driver, boot_id, bus, wake))

    def step(self, now_ns: int) -> int:
        """Pass on what arrived; every 10 ms read and publish."""
        due = now_ns >= self._loop_ns
        if due:
            self._loop_ns += _LOOP_NS * (1 + (now_ns - self._loop_ns) // _LOOP_NS)
            self._loops += 1
        next_ns = self._loop_ns
        for robot in self._robots:
            now_ns = self._clock.now_ns()  # the robot before may have kept us: no gate decides by an old instant
            deadline_ns = robot.pass_on(now_ns)
            if deadline_ns is not None and deadline_ns < next_ns:
                next_ns = deadline_ns
            if due:
                robot.publish(now_ns, status=self._loops % 2 == 1)
        return next_ns

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


def _command(message: WheelCommand) -> gate.Command:
    return gate.Command(message.boot_id, message.nonce, WheelSpeeds(message.left_rad_s, message.right_rad_s))


def _permission(message: Enable) -> gate.Permission:
    return gate.Permission(message.boot_id, message.nonce, message.phase == Phase.RUNNING)
