"""One robot behind its gate: what arrives, what is written to the wheels, what is measured, what is kept."""

import math
from collections.abc import Callable

from robofleet.clock import MS, S
from robofleet.comms.bus import Bus, Inbox, Publish, Request, Wake
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
from robofleet.processes.health import Health
from robofleet.processes.keeping import Keeping, Kept, kept
from robofleet.safety import gate
from robofleet.safety.gate import GateOutput, GateState, GateStatus, Inputs, Latch, LeaseAction
from robofleet.vehicles.interface import STOP, Driver, DriverContext, DriverError, SimulatedDriver, WheelSpeeds

_TURNING_RAD_S = 0.05  # a wheel that is measured faster than this is not at rest
# In health a gate lives on nonces of up to 60 ms: a status every 20 ms, an enable every 40 ms.
_BAD_LINK_NS = 70 * MS
_NO_LINK_NS = S // 2  # it is not a bad one
_HURRY_NS = 60 * S
_LATCHES = {int(latch): latch for latch in Latch}
_ACTIONS = tuple(LeaseAction)
_LOOK_NS = gate.VALID_NS // 2  # so often a gate is stepped while it changes: twice that, and it was held up

Witness = Callable[[str, int, Inputs, GateState, GateOutput], None]  # robot, instant, what its gate got and decided


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
        self._kept = keeping.load(context.robot)
        self._unsaved: Kept | None = None
        self._lost = False  # what is kept was made to count as lost
        self._gate = GateState(boot_id, *self._kept)
        self._settled: GateState | None = None  # the newest one of which nothing is left to be kept
        self._commands = Inbox(bus.newest(COMMAND, context.robot, wake), WHEEL_COMMAND)
        self._enables = Inbox(bus.newest(ENABLE, context.robot, wake), ENABLE_LAYOUT)
        self._lease = bus.serve(LEASE, context.robot, wake)
        self._publish_status = bus.publisher(STATUS, context.robot)
        self._publish_truth: Publish | None = None
        if isinstance(driver, SimulatedDriver):
            self._publish_truth, self._truth = bus.publisher(TRUTH, context.robot), driver.truth
        self._health = Health(context.robot, context.now_ns())
        self._written: WheelSpeeds | None = None
        self._told, self._told_ns, self._telling = (0.0, 0.0), 0, STOP
        self._status = GateStatus.NO_LEASE
        self.deadline_ns: int | None = 0
        self._accepted_exposure_ns: int | None = None  # of a command that has not reached the wheels yet
        self._applied = (0, 0)  # the newest one that has: its exposure, and when
        self._unreadable = 0  # lease requests
        self._seq = 0
        self._opened = False  # the gate was open: before, late messages are those of processes that start
        self._hurry_until_ns = 0
        self._closed = False
        self._told_latch = (self._gate.latch, self._gate.latch_id)  # in the newest status
        self._retry = False  # what the robot was told last may not have reached it
        self.look(context.now_ns())

    @property
    def hurries(self) -> bool:
        """Whether its link was bad a short while ago: then its status goes out in every loop."""
        return self._gate.at_ns < self._hurry_until_ns

    def look(self, now_ns: int) -> None:
        """Read the robot, and tell it again what may have been lost on its way: to stand, or what failed."""
        self._retry = self._health.look(self._driver, self._gate.latch, self._gate.output, now_ns)
        if self._status is not GateStatus.OPEN and self._gate.output == STOP:
            self._retry = False
            self._write(STOP)

    def pass_on(self, now_ns: int) -> None:
        """Let the gate decide on what arrived, and write the wheels."""
        command, enable = self._commands.take(), self._enables.take()
        quiet = command is None and enable is None and self._health.latch <= self._gate.latch
        due = self.deadline_ns is not None and now_ns >= min(self.deadline_ns, self._gate.at_ns + _LOOK_NS)
        if quiet and not due and not self._retry and now_ns >= self._gate.at_ns:
            return  # the gate's output changes by a message, by the robot's own stop, at its deadline
        self._opened = self._opened or self._status is GateStatus.OPEN
        age_ns = now_ns - min(self._gate.command_nonce, self._gate.enabled[0])
        if self._opened and _BAD_LINK_NS < age_ns < _NO_LINK_NS:
            self._hurry_until_ns = now_ns + _HURRY_NS
        seq = self._gate.seq
        inputs = self._inputs(
            None if command is None else _command(command), None if enable is None else _permission(enable)
        )
        state, output = gate.step(self._gate, self._drive, inputs, now_ns)
        self._adopt(inputs, state, output, now_ns, again=command is not None or self._retry)
        self._retry = False
        said_anew = command is not None and command.exposure_ns != self._applied[0]
        if command is not None and said_anew and self._gate.seq != seq:
            self._accepted_exposure_ns = command.exposure_ns
        if self._accepted_exposure_ns is not None and self._status is GateStatus.OPEN:
            self._applied, self._accepted_exposure_ns = (self._accepted_exposure_ns, now_ns), None

    @property
    def latch_is_new(self) -> bool:
        """Whether the newest status does not tell of the gate's latch yet."""
        return (self._gate.latch, self._gate.latch_id) != self._told_latch

    def announce(self, now_ns: int) -> None:
        """Publish a latch that is new: before the disk, and before anything is said in the log."""
        self._seq += 1
        self._tell(now_ns)

    def settle(self, now_ns: int, *, due: bool) -> None:
        """Answer a lease request and keep what must be kept: the disk is slow, so every robot's wheels went before."""
        request = self._lease()
        if request is not None:
            self._answer(request, now_ns)
        if self._gate is self._settled:
            return
        memory = kept(self._gate)
        if memory != self._kept and (due or memory != self._unsaved) and not self._save(memory):
            self._lose(memory)
        if memory == self._kept:
            self._settled = self._gate

    def publish(self, now_ns: int, *, status: bool) -> None:
        """Publish the robot's status, and the truth of a simulated one."""
        self._seq += 1
        if self._publish_truth is not None:
            self._publish_truth(TRUTH_LAYOUT.encode(Truth(self._gate.epoch, self._seq, now_ns, *self._truth())))
        if status:
            self._tell(now_ns)

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

    def _inputs(
        self,
        command: gate.Command | None = None,
        permission: gate.Permission | None = None,
        lease: tuple[int, LeaseAction] | None = None,
    ) -> Inputs:
        reading = self._health.reading
        turning = max(abs(reading.left_speed), abs(reading.right_speed)) > _TURNING_RAD_S
        return Inputs(command, permission, lease, self._health.latch, turning)

    def _adopt(self, inputs: Inputs, state: GateState, output: GateOutput, now_ns: int, *, again: bool = False) -> None:
        """Do what the gate decided; ``again`` tells the robot also what it was told before."""
        self._gate, self._status, self.deadline_ns = state, output.status, output.deadline_ns
        if self._witness is not None:
            self._witness(self._robot, now_ns, inputs, state, output)
        if again or output.output != self._written:
            self._told, self._told_ns, self._telling = self._told_until(now_ns), now_ns, output.output
            self._write(output.output)
        if self._health.latch > state.latch:  # just now
            inputs = self._inputs()
            self._adopt(inputs, *gate.step(state, self._drive, inputs, now_ns), now_ns)

    def _told_until(self, now_ns: int) -> tuple[float, float]:
        """Return how far the wheels were told to turn [rad]."""
        (left, right), (told_left, told_right), since_s = self._telling, self._told, (now_ns - self._told_ns) * 1e-9
        return told_left + left * since_s, told_right + right * since_s

    def _write(self, wheels: WheelSpeeds) -> None:
        try:
            self._driver.write(wheels)
            self._written = wheels
        except Exception as error:  # noqa: BLE001 - whatever a driver does, it is its own robot that stops
            self._health.fail(error)
            self._written = None

    def _answer(self, request: Request, now_ns: int) -> None:
        asked = LEASE_REQUEST.decode(request.payload)
        if asked is None or asked.action not in _ACTIONS:
            self._unreadable += 1
            return
        lease = asked.session, LeaseAction(asked.action)
        inputs = self._inputs(lease=lease)
        state, output = gate.step(self._gate, self._drive, inputs, now_ns)
        granted = bool(output.granted)
        if state.epoch != self._gate.epoch and not self._save(kept(state)):
            granted = False  # an epoch that a restart would give out again is not given out: nothing has happened
        else:
            self._adopt(inputs, state, output, now_ns)
        request.reply(LEASE_ANSWER.encode(LeaseAnswer(int(granted), self._gate.epoch, self._gate.session)))

    def _save(self, memory: Kept) -> bool:
        try:
            self._keeping.save(self._robot, memory)
        except OSError as error:
            self._unsaved = memory
            self._health.complain(f"its lease and its latch cannot be written to disk: {error}")
            return False
        self._kept, self._unsaved, self._lost = memory, None, False
        return True

    def _lose(self, memory: Kept) -> None:
        """A latch that cannot be kept must not be forgotten by a restart: nothing is known then."""
        if memory.latch and not (self._kept.latch or self._lost):
            try:
                self._keeping.lose(self._robot)
                self._lost = True
            except OSError as error:
                self._health.complain(f"after a restart its latch is lost: {error}")

    def _tell(self, now_ns: int) -> None:
        self._told_latch = (self._gate.latch, self._gate.latch_id)
        self._publish_status(ROBOT_STATUS.encode(self._message(now_ns)))

    def _message(self, now_ns: int) -> RobotStatus:
        state, reading = self._gate, self._health.reading
        rejected = state.refused + self._commands.rejected + self._enables.rejected + self._unreadable
        battery = reading.battery if math.isfinite(reading.battery) else -1.0
        return RobotStatus(
            state.epoch, self._seq, self._build, state.session, state.boot_id, now_ns, now_ns,
            *self._applied, rejected, self._status, state.latch, state.latch_id,
            int(self.hurries), self._health.faults(state.latch), state.target_after_ns, state.output_after_ns,
            reading.left_angle, reading.right_angle, reading.left_speed, reading.right_speed, *state.output,
            *self._told_until(now_ns), battery,
        )  # fmt: skip


def _command(message: WheelCommand) -> gate.Command:
    epoch, seq, session, boot_id, nonce, _, left, right = message
    return gate.Command(epoch, session, seq, boot_id, nonce, WheelSpeeds(left, right))


def _permission(message: Enable) -> gate.Permission:
    epoch, seq, boot_id, nonce, _, latch, clear, limit = message
    known = _LATCHES.get(latch, Latch.EMERGENCY_STOP)  # one of another version: stop
    return gate.Permission(epoch, seq, boot_id, nonce, known, clear, limit)
