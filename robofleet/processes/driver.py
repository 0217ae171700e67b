"""A driver process: one robot or several, each behind its gate. It owns the gates; the drivers know no bus."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from robofleet.clock import MS, Clock, S
from robofleet.comms.bus import Bus, Inbox, Publish, Wake
from robofleet.comms.keys import COMMAND, ENABLE, LEASE, STATUS, TRUTH
from robofleet.comms.messages import (
    ENABLE as ENABLE_LAYOUT,
)
from robofleet.comms.messages import (
    LEASE_ANSWER,
    LEASE_REQUEST,
    ROBOT_STATUS,
    WHEEL_COMMAND,
    Enable,
    LeaseAnswer,
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
from robofleet.processes.keeping import Keeping, kept
from robofleet.safety import gate
from robofleet.safety.gate import GateOutput, GateState, GateStatus, Inputs, Latch, LeaseAction
from robofleet.simulation.faults import Schedule
from robofleet.vehicles.interface import (
    STOP,
    WIRED_STOP,
    Driver,
    DriverContext,
    DriverReading,
    SimulatedDriver,
    Simulation,
    WheelSpeeds,
)

_LOOP_NS = 10 * MS
# In health what holds a gate open echoes a nonce of up to 60 ms: a status a 20 ms, an enable a 40 ms.
_BAD_LINK_NS = 70 * MS
_NO_LINK_NS = S // 2  # it is not a bad one
_HURRY_NS = 60 * S
_TURNING_RAD_S = 0.05  # a wheel that is measured faster than this is not at rest
_LATCHES = tuple(Latch)
_ACTIONS = tuple(LeaseAction)

Witness = Callable[[str, int, GateState, GateOutput], None]  # robot, instant, and what its gate decided


@dataclass
class _Applied:
    """The newest command that reached the wheels."""

    exposure_ns: int = 0
    at_ns: int = 0


class GatedRobot:
    """One robot: what arrives passes the gate, what passes moves the wheels, what is measured is published."""

    def __init__(
        self,
        context: DriverContext,
        driver: Driver,
        boot_id: int,
        build: int,
        bus: Bus,
        wake: Wake,
        keeping: Keeping,
        witness: Witness | None,
    ) -> None:
        self._robot, self._driver, self._drive = context.robot, driver, context.drive
        self._build, self._keeping, self._witness = build, keeping, witness
        known = keeping.load(context.robot)
        self._gate = GateState(boot_id, known.epoch, known.latch, known.latch_id)
        self._commands = Inbox(bus.newest(COMMAND, context.robot, wake), WHEEL_COMMAND)
        self._enables = Inbox(bus.newest(ENABLE, context.robot, wake), ENABLE_LAYOUT)
        self._lease = bus.serve(LEASE, context.robot, wake)
        self._publish_status = bus.publisher(STATUS, context.robot)
        self._publish_truth: Publish | None = None
        if isinstance(driver, SimulatedDriver):
            self._publish_truth, self._truth = bus.publisher(TRUTH, context.robot), driver.truth
        self._reading = driver.read()
        self._written: WheelSpeeds | None = None
        self._status = GateStatus.NO_LEASE
        self._deadline_ns: int | None = 0
        self._applied = _Applied()
        self._seq = 0
        self._hurry_until_ns = 0
        self._closed = False

    @property
    def hurries(self) -> bool:
        """Whether its link was bad a short while ago: then its status goes out in every loop."""
        return self._gate.at_ns < self._hurry_until_ns

    def pass_on(self, now_ns: int, *, due: bool) -> int | None:
        """Let the gate decide on what arrived, write the wheels, and return the gate's own deadline [ns]."""
        command, enable, request = self._commands.take(), self._enables.take(), self._lease()
        quiet = command is None and enable is None and request is None and not due
        if quiet and (self._deadline_ns is None or now_ns < self._deadline_ns):
            return self._deadline_ns  # the gate's output changes by a message or at its deadline
        asked = None if request is None else LEASE_REQUEST.decode(request.payload)
        inputs = Inputs(
            None if command is None else _command(command),
            None if enable is None else _permission(enable),
            (asked.session, LeaseAction(asked.action)) if asked is not None and asked.action in _ACTIONS else None,
            Latch.WIRED_STOP if self._reading.faults & WIRED_STOP else Latch.NONE,
            max(abs(self._reading.left_speed), abs(self._reading.right_speed)) > _TURNING_RAD_S,
        )
        if _BAD_LINK_NS < now_ns - min(self._gate.command_nonce, self._gate.enabled[0]) < _NO_LINK_NS:
            self._hurry_until_ns = now_ns + _HURRY_NS
        self._gate, output = gate.step(self._gate, self._drive, inputs, now_ns)
        if output.output != self._written or command is not None:
            self._driver.write(output.output)
            self._written = output.output
        if output.applied and command is not None and command.exposure_ns != self._applied.exposure_ns:
            self._applied = _Applied(command.exposure_ns, now_ns)
        if output.keep:
            self._keeping.save(self._robot, kept(self._gate))
        if request is not None and output.granted is not None:
            answer = LeaseAnswer(int(output.granted), self._gate.epoch, self._gate.session)
            request.reply(LEASE_ANSWER.encode(answer))
        self._status, self._deadline_ns = output.status, output.deadline_ns
        if self._witness is not None:
            self._witness(self._robot, now_ns, self._gate, output)
        return output.deadline_ns

    def publish(self, now_ns: int, *, status: bool) -> None:
        """Publish the robot's status, and the truth of a simulated one."""
        self._seq += 1
        if self._status is not GateStatus.OPEN and self._gate.output == STOP:
            self._driver.write(STOP)  # again and again: on its way to a real robot one may get lost
        if self._publish_truth is not None:
            self._publish_truth(TRUTH_LAYOUT.encode(Truth(self._gate.epoch, self._seq, now_ns, *self._truth())))
        if status:
            self._reading = self._driver.read()
            self._publish_status(ROBOT_STATUS.encode(self._message(self._reading, now_ns)))

    def close(self) -> None:
        """Motors off, driver closed. Idempotent."""
        if not self._closed:
            self._closed = True
            try:
                self._driver.write(STOP)
            finally:
                self._driver.close()

    def _message(self, reading: DriverReading, now_ns: int) -> RobotStatus:
        state = self._gate
        rejected = state.refused + self._commands.rejected + self._enables.rejected
        battery = -1.0 if reading.battery != reading.battery else reading.battery
        return RobotStatus(
            state.epoch, self._seq, self._build, state.session, state.boot_id, now_ns, now_ns,
            self._applied.exposure_ns, self._applied.at_ns, rejected, self._status, state.latch, state.latch_id,
            int(self.hurries), reading.faults, state.target_after_ns, state.output_after_ns,
            reading.left_angle, reading.right_angle, reading.left_speed, reading.right_speed, *state.output, battery,
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
        keeping: Keeping,
        witness: Witness | None = None,
        faults: Schedule | None = None,
    ) -> None:
        self._clock, self._faults = clock, faults
        self._keeping, self._witness = keeping, witness
        self._robots: list[GatedRobot] = []
        try:
            self._open(config, robot_ids, bus, wake, rng)
        except BaseException:
            self.close()
            raise
        self._loop_ns = clock.now_ns() + int(rng.integers(_LOOP_NS))  # loops of several processes are not in phase
        self._loops = 0

    def _open(self, config: Config, robot_ids: tuple[str, ...], bus: Bus, wake: Wake, rng: np.random.Generator) -> None:
        faults = self._faults
        for robot_id in robot_ids:
            robot = config.robot(robot_id)
            context = DriverContext(
                robot_id,
                slices.drive(robot),
                Simulation(
                    slices.vehicle_drive(robot.vehicle),
                    slices.imperfections(robot.vehicle),
                    slices.start_pose(robot),
                    None if faults is None else faults.body_trouble(robot_id),
                    slices.generator(config.run.seed, "plant", robot_id),
                ),
                self._clock.now_ns if faults is None else faults.now_ns,
            )
            make: Callable[[], Driver] = partial(load("robofleet.drivers", robot.driver), context)
            driver = make() if faults is None else faults.driver(robot_id, make)
            boot_id = slices.drawn_id(rng, 64)
            build = slices.build(config)
            self._robots.append(GatedRobot(context, driver, boot_id, build, bus, wake, self._keeping, self._witness))

    def step(self, now_ns: int) -> int:
        """Pass on what arrived; every 10 ms read and publish."""
        due = now_ns >= self._loop_ns
        if due:
            self._loop_ns += _LOOP_NS * (1 + (now_ns - self._loop_ns) // _LOOP_NS)
            self._loops += 1
        next_ns = self._loop_ns
        for robot in self._robots:
            now_ns = self._clock.now_ns()  # the robot before may have kept us: no gate decides by an old instant
            deadline_ns = robot.pass_on(now_ns, due=due)
            if deadline_ns is not None and deadline_ns < next_ns:
                next_ns = deadline_ns
            if due:
                robot.publish(now_ns, status=self._loops % 2 == 1 or robot.hurries)
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
    epoch, seq, session, boot_id, nonce, _, left, right = message
    return gate.Command(epoch, session, seq, boot_id, nonce, WheelSpeeds(left, right))


def _permission(message: Enable) -> gate.Permission:
    epoch, seq, boot_id, nonce, _, latch, clear, limit = message
    known = Latch(latch) if latch in _LATCHES else Latch.EMERGENCY_STOP  # of another version: stop
    return gate.Permission(epoch, seq, boot_id, nonce, known, clear, limit)
