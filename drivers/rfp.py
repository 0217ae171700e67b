"""Robots with this project's firmware (``drivers/firmware``): rfp/1 on a serial line or a network.

The firmware has a gate of its own, the same as the one before this driver. The driver holds its lease. With each
``write`` it sends a command and a permission, which echo the newest nonce that the robot has sent: the permission is
for no motion while the wheels are to stand, which is all that a driver hears of the gate before it. Whatever dies or
is cut between here and there, the robot's target is zero 120 ms after that nonce.

A command that finds the line busy waits for the next call; the newest one counts. ``read`` renews nothing.
"""

import math
import zlib
from collections.abc import Callable
from typing import Annotated, ClassVar

from pydantic import BaseModel, ConfigDict, Field

from robofleet.drivers import rfp_frames
from robofleet.drivers.rfp_frames import (
    MAX_GAIN,
    PER_RAD_S,
    VERSION,
    Command,
    Gains,
    Health,
    Hello,
    Identity,
    Lease,
    LeaseAnswer,
    Message,
    Permission,
    Status,
)
from robofleet.drivers.serial_port import SerialPort
from robofleet.drivers.udp_port import SCHEME, UdpPort, host_and_port
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import (
    DriverContext,
    DriverError,
    DriverReading,
    MisfitError,
    RobotFault,
    WheelSpeeds,
)

_BOOT_NS = 6_000_000_000  # of patience: opening the port may reset the board; a lease of before lapses in a second
_ASK_AGAIN_S = 0.2
_BUSY_NS = 200_000_000  # what is sent at once takes less, at any baud rate
_AGAIN_NS = 20_000_000  # the same command is not sent more often
_SILENT_NS = 500_000_000
_ACQUIRE, _RELEASE = 1, 3
_MEMORY_LOST = 5  # as a latch
_ROBOT_FAULTS = (3, 6)  # latches that follow from a fault which the robot tells as such
_FASTEST = 63.0  # [rad/s] that the line can say
_RADIUS_OFF = 0.05  # that a calibrated radius may differ from the built-in one, relative
_COUNTS_OFF = _ROUNDED = 1e-3
_RESETS = {1: "was switched on", 2: "was reset", 4: "had too little voltage", 8: "hung, and its watchdog reset it"}
_Gain = Annotated[int, Field(ge=0, le=MAX_GAIN)]
_Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class Rfp:
    """One robot with this firmware."""

    concurrent: ClassVar[bool] = True

    class Settings(BaseModel):
        """What the robot is connected to, and what its firmware must have been built with."""

        model_config = ConfigDict(frozen=True, extra="forbid", strict=True, use_attribute_docstrings=True)

        port: Annotated[str, Field(min_length=1)]
        """The serial port of its board; or ``udp://HOST:PORT``, of a board on a network."""
        baud: Annotated[int, Field(ge=9600, le=2_000_000)] = 57600
        """Of a serial port: as built into its firmware (``RFP_BAUD``)."""
        counts_per_turn: _Positive
        """Encoder counts in one turn of a wheel, gear included, as built in (``RFP_COUNTS_PER_TURN``)."""
        board: Annotated[str, Field(min_length=1, max_length=12)] | None = None
        """The board that it must be: ``uno``, ``mega``, ``pico``, ``teensy``, ``esp32`` or one of yours; null: any."""
        gains: Annotated[tuple[_Gain, _Gain, _Gain] | None, Field(strict=False)] = None
        """kp, ki, kff of the wheels' speed loops, sent at opening; null: those that are built in."""
        battery_v: Annotated[tuple[_Positive, _Positive] | None, Field(strict=False)] = None
        """Voltages of an empty and of a full battery; null: its charge is not told."""

    def __init__(self, context: DriverContext) -> None:
        settings: Rfp.Settings = context.settings
        self._settings, self._now_ns, self._name = settings, context.now_ns, settings.port
        self._limit = min(math.ceil(context.drive.max_wheel_speed * PER_RAD_S), 32767)
        # another one for each opening, and the same where a run is repeated
        self._session = zlib.crc32(f"{context.robot} {self._now_ns()}".encode()) or 1
        self._receiver = rfp_frames.Receiver()
        self._identity: Identity | None = None
        self._built: rfp_frames.Settings | None = None
        self._status: Status | None = None
        self._health: Health | None = None
        self._epoch: int | None = None  # of the lease that it holds
        self._status_ns = 0  # the newest status
        self._answered = False  # anything at all
        self._sent = self._seq = 0
        self._target, self._sent_target, self._sent_ns, self._free_ns = (0, 0), (0, 0), 0, 0
        self._waits = False  # the target has not been sent yet
        self._counts: tuple[int, int] | None = None
        self._turned = [0, 0]
        self._restarted = False
        self._latched = 0  # faults by which the firmware latched itself, not told yet
        self._closed = False
        self._line = (
            UdpPort(settings.port) if settings.port.startswith(SCHEME) else SerialPort(settings.port, settings.baud)
        )
        try:
            self._meet(context.drive)
        except BaseException:
            self._line.close()
            raise

    @staticmethod
    def refusals(settings: Settings, drive: DifferentialDrive) -> list[tuple[str, str]]:
        """Return why this protocol and these values cannot drive this robot."""
        found = []
        if drive.max_wheel_speed > _FASTEST:
            found.append(("vehicle.max_wheel_speed_rad_s", f"rfp/{VERSION} can say {_FASTEST:g} at most: lower it"))
        if settings.port.startswith(SCHEME):
            try:
                host_and_port(settings.port)
            except DriverError as error:
                found.append(("settings.port", str(error)))
        if settings.battery_v is not None and settings.battery_v[0] >= settings.battery_v[1]:
            found.append(("settings.battery_v", "an empty battery must have less than a full one: exchange them"))
        return found

    def write(self, wheels: WheelSpeeds) -> None:
        """Command the wheels [rad/s]; what is the same is sent 50 times a second at most."""
        now_ns = self._listen()
        self._target = _speed(wheels.left), _speed(wheels.right)
        again = 0 <= now_ns - self._sent_ns < _AGAIN_NS
        self._waits = not again or self._target != self._sent_target
        self._command(now_ns)

    def read(self) -> DriverReading:
        """Return angles, speeds, charge and faults."""
        now_ns = self._listen()
        status, health = self._status, self._health
        assert status is not None
        assert health is not None
        if now_ns - self._status_ns > _SILENT_NS:
            raise self._error(f"it said nothing for {_SILENT_NS * 1e-9:.1f} s: {self._line.silence}")
        if 0 < (health.epoch - (self._epoch or 0)) % 65536 < 32768:  # an older one comes late
            raise self._error("another program has taken its lease: end that one")
        self._command(now_ns)
        per_count = math.tau / self._settings.counts_per_turn
        latched, self._latched = self._latched, 0
        lasting = _own(_MEMORY_LOST) if health.memory_lost else 0
        return DriverReading(
            self._turned[0] * per_count, self._turned[1] * per_count, status.left_speed / PER_RAD_S,
            status.right_speed / PER_RAD_S, self._charge(health.battery_mv), status.faults | lasting | latched,
        )  # fmt: skip

    def close(self) -> None:
        """Let the wheels stand, and give the lease back."""
        if self._closed:
            return
        try:
            self._target = 0, 0
            self._send(*self._motion(), Lease(self._session, _RELEASE))
        except DriverError:
            pass  # its line is gone: it stops by itself
        finally:
            self._closed = True
            self._line.close()

    def _meet(self, drive: DifferentialDrive) -> None:
        """Find out who is there, get the lease, which is granted at rest, and give it its gains."""
        self._until(
            lambda: self._identity is not None and self._built is not None and self._status is not None, Hello()
        )
        if self._identity is None or self._built is None or self._status is None:
            if self._answered:
                raise self._error("what answers there does not speak rfp: flash drivers/firmware, or mend port or baud")
            raise self._error(f"nothing answers there: {self._line.silence}")
        self._fit(self._identity, self._built, drive)
        self._until(lambda: self._epoch is not None, Lease(self._session, _ACQUIRE))
        if self._epoch is None:
            raise self._error(
                "it gave its lease to another program, or a wheel turns: end that one, or hold the wheels"
            )
        gains = None if self._settings.gains is None else Gains(*self._settings.gains)
        if gains is not None:
            self._until(lambda: self._built is not None and self._built[-3:] == gains, gains)
            if self._built[-3:] != gains:
                raise self._error("it does not take its gains")
        self._health = None  # it may be of before
        self._until(lambda: self._health is not None, Hello())
        if self._health is None:
            raise self._error(f"it answers no more: {self._line.silence}")

    def _until(self, done: Callable[[], bool], request: Message) -> None:
        """Send a request again and again until that is done, or patience ends."""
        until_ns = self._now_ns() + _BOOT_NS
        while not done() and self._now_ns() < until_ns:
            self._send(request)
            again_ns = self._now_ns() + round(_ASK_AGAIN_S * 1e9)
            while not done() and (left_s := (again_ns - self._now_ns()) * 1e-9) > 0.0 and self._line.wait(left_s):
                self._listen()

    def _fit(self, identity: Identity, built: rfp_frames.Settings, drive: DifferentialDrive) -> None:
        """Refuse a firmware that was built for another robot."""
        board = _text(identity.board)
        if self._settings.board not in (None, board):
            raise MisfitError(
                f"{self._name}: its board is {board!r}, not {self._settings.board!r}: mend settings.port or board"
            )
        misfits = (
            ("counts a turn", built.counts_per_turn / 256.0, self._settings.counts_per_turn, _COUNTS_OFF),
            ("m of a wheel's radius", built.wheel_radius_um * 1e-6, drive.wheel_radius, _RADIUS_OFF),
            ("rad/s of a wheel at most", built.max_wheel / PER_RAD_S, drive.max_wheel_speed, None),
            ("m/s at most", built.max_sum / PER_RAD_S * drive.wheel_radius / 2.0, drive.max_speed, None),
            ("rad/s^2 of a wheel at most", built.max_ramp * 1000.0 / 65536.0, drive.max_wheel_acceleration, None),
        )
        for what, has, configured, off in misfits:
            # of a limit the firmware may have more than is configured
            if not has >= configured * (1.0 - (off or _ROUNDED)) or (off and has > configured * (1.0 + off)):
                raise MisfitError(
                    f"{self._name}: its firmware is built for {has:.4g} {what}, {configured:.4g} are configured: "
                    "flash drivers/firmware with these, or mend the configuration"
                )

    def _command(self, now_ns: int) -> None:
        """Send the target, if it waits and the line is free."""
        if self._waits and not 0 < self._free_ns - now_ns <= _BUSY_NS:  # more: the clock was set back
            self._waits = False
            self._sent_target, self._sent_ns = self._target, now_ns
            self._send(*self._motion())

    def _motion(self) -> tuple[Command, Permission]:
        """Return a command and a permission by the newest nonce; one for a motion clears the firmware's latch first.

        The gate before this driver has latched for the same reason, and lets a motion through only after its reset.
        """
        status, health, epoch = self._status, self._health, self._epoch
        assert status is not None
        assert health is not None
        assert epoch is not None
        self._seq += 1
        moves = self._target != (0, 0)
        clear = health.latch_id if moves and status.latch else 0
        nonce = status.boot_id, status.nonce
        return (
            Command(epoch, self._session, self._seq, *nonce, *self._target),
            Permission(epoch, self._seq, *nonce, 0, clear, self._limit if moves else 0),
        )

    def _send(self, *messages: Message) -> None:
        frames = []
        for message in messages:
            frames.append(rfp_frames.frame(message, self._sent))
            self._sent += 1
        # what noise has left at the robot's end is ended by a zero of its own
        data = b"\0" + b"".join(frames)
        self._free_ns = self._now_ns() + self._line.duration_ns(data)
        self._line.write(data)

    def _listen(self) -> int:
        """Take what has come; return the instant."""
        if self._closed:
            raise self._error("it is closed")
        received = self._line.read()
        now_ns = self._now_ns()
        self._answered = self._answered or bool(received)
        for body in self._receiver.receive(received):
            if body[0] >> 4 == rfp_frames.IDENTITY and body[1:2] != bytes([VERSION]):
                raise self._error(f"it speaks rfp/{body[1]}, this driver rfp/{VERSION}: flash drivers/firmware")
            self._take(rfp_frames.message(body), now_ns)
        return now_ns

    def _take(self, message: Message | None, now_ns: int) -> None:
        match message:
            case Status():
                self._take_status(message, now_ns)
            case Health():
                if self._restarted:
                    raise self._error(f"its board started anew: it {_RESETS.get(message.reset, 'does not tell why')}")
                self._health = message
            case Identity():
                self._identity = message
            case rfp_frames.Settings():
                self._built = message
            case LeaseAnswer(session=self._session, granted=1):
                self._epoch = message.epoch

    def _take_status(self, new: Status, now_ns: int) -> None:
        old = self._status
        if old is not None and new.boot_id == old.boot_id and new.nonce <= old.nonce:
            return  # it comes late
        self._restarted |= self._epoch is not None and old is not None and new.boot_id != old.boot_id
        if self._restarted:
            return  # the next Health says why
        counts = new.left_count, new.right_count
        if self._counts is not None:
            for side in (0, 1):
                self._turned[side] += (counts[side] - self._counts[side] + 2**31) % 2**32 - 2**31
        if new.latch and (old is None or new.latch != old.latch):
            self._latched |= new.felt | (0 if new.latch in _ROBOT_FAULTS and new.felt else _own(new.latch))
        self._counts, self._status, self._status_ns = counts, new, now_ns

    def _charge(self, battery_mv: int) -> float:
        if self._settings.battery_v is None or not battery_mv:
            return math.nan
        empty_v, full_v = self._settings.battery_v
        return min(1.0, max(0.0, (battery_mv * 1e-3 - empty_v) / (full_v - empty_v)))

    def _error(self, why: str) -> DriverError:
        return DriverError(f"{self._name}: {why}")


def _speed(rad_s: float) -> int:
    return max(-32767, min(32767, round(rad_s * PER_RAD_S)))


def _text(characters: bytes) -> str:
    return characters.rstrip(b"\0").decode("ascii", "replace")


def _own(latch: int) -> int:
    """Return the fault by which a reading tells that the firmware latched itself."""
    return RobotFault.OWN << latch
