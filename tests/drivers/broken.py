"""The driver of drivers/YOUR_OWN.md, broken on purpose: each in one way (``test_contract_sabotage.py``)."""

import os
import select
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

from robofleet.drivers.serial_port import SerialPort
from robofleet.vehicles.interface import STOP, DriverContext, DriverError, DriverReading, WheelSpeeds
from robofleet.vehicles.readings import SensorReading
from tests.drivers.sparrow import Sparrow  # type: ignore[attr-defined]


def _writes(change: Callable[[float, float], tuple[float, float]]) -> Any:
    """Return a driver that changes the speeds that it writes, left and right [rad/s]."""

    class Changed(Sparrow):
        def write(self, wheels: WheelSpeeds) -> None:
            super().write(WheelSpeeds(*change(*wheels)))

    return Changed


def _reads(change: Callable[[DriverReading], DriverReading]) -> Any:
    """Return a driver that changes what it reads."""

    class Changed(Sparrow):
        def read(self) -> DriverReading:
            return change(super().read())

    return Changed


Reversed = _writes(lambda left, right: (-left, -right))
Swapped = _writes(lambda left, right: (right, left))
CoarselyRounded = _writes(lambda left, right: (round(left / 0.7) * 0.7, round(right / 0.7) * 0.7))
RoundsUpAtTheLimit = _writes(lambda *speeds: tuple((1.03 if max(map(abs, speeds)) > 12.0 else 1.0) * v for v in speeds))
TellsWhatNobodyAsked = _reads(lambda reading: reading._replace(sensors=SensorReading(gyro=(0.0, 0.0, 0.1))))
CountsBackwards = _reads(lambda reading: reading._replace(left_angle=-reading.left_angle))
DegreesPerSecond = _reads(lambda reading: reading._replace(right_speed=57.3 * reading.right_speed))
BatteryInVolts = _reads(lambda reading: reading._replace(battery=11.1))


class SharesItsBoard(Sparrow):
    concurrent = True  # which it cannot be
    board = threading.Lock()

    def __init__(self, context: DriverContext) -> None:
        if not self.board.acquire(blocking=False):
            raise DriverError("the board is busy")
        try:
            super().__init__(context)
        finally:
            self.board.release()


class MovesWhenMade(Sparrow):
    def __init__(self, context: DriverContext) -> None:
        super().__init__(context)
        self.write(WheelSpeeds(1.0, 1.0))


class SaysItAgain(Sparrow):
    """As a driver whose polling is as good as a command to its firmware."""

    _newest = STOP

    def write(self, wheels: WheelSpeeds) -> None:
        self._newest = wheels
        super().write(wheels)

    def read(self) -> DriverReading:
        super().write(self._newest)
        return super().read()


class LeavesItTurning(Sparrow):
    def close(self) -> None:
        self.line.close()


class WritesWhenClosed(Sparrow):
    closed = False

    def write(self, wheels: WheelSpeeds) -> None:
        if not self.closed:
            super().write(wheels)
            return
        self.line = SerialPort(self.settings.port, 115200)
        super().write(wheels)
        self.line.close()

    def close(self) -> None:
        if not self.closed:
            super().close()
        self.closed = True


class WritesToItsOldNumber(Sparrow):
    def write(self, wheels: WheelSpeeds) -> None:
        if self.line.descriptor >= 0:
            self.number = self.line.descriptor
        super().write(wheels) if self.line.descriptor >= 0 else os.write(self.number, b"w 0 0")

    def close(self) -> None:
        if self.line.descriptor >= 0:
            super().close()


class BelievesEveryLine(Sparrow):
    def listen(self) -> bool:
        *lines, self.rest = (self.rest + self.line.read())[-4096:].split(b"\n")
        for line in lines:
            if line.startswith(b"s "):
                self.reports = [*self.reports[-9:], (self.now_ns(), *map(int, line.split()[1:4]))]
        return bool(self.reports)


class MiscountsBadLines(Sparrow):
    def listen(self) -> bool:
        before = self.reports[-1:]
        is_heard = super().listen()
        if before and self.reports[-1][0] - before[0][0] > 15_000_000:
            at_ns, left, right, charge = self.zero
            self.zero = at_ns, left + 500, right, charge
        return is_heard


class NeverMissesIt(Sparrow):
    def listen(self) -> bool:
        super().listen()
        if self.reports:
            self.reports[-1] = (self.now_ns(), *self.reports[-1][1:])
        return bool(self.reports)


class WritesIntoTheVoid(Sparrow):
    def write(self, wheels: WheelSpeeds) -> None:
        with suppress(DriverError):
            super().write(wheels)


class ReadsFromTheVoid(Sparrow):
    def listen(self) -> bool:
        with suppress(DriverError):
            super().listen()
        return bool(self.reports)


class SeesNoPlug(WritesIntoTheVoid, ReadsFromTheVoid):
    pass


class ComesBackOnce(Sparrow):
    lost: ClassVar[set[str]] = set()

    def __init__(self, context: DriverContext) -> None:
        if context.settings.port in self.lost:
            raise DriverError(f"{context.settings.port}: lost for good")
        super().__init__(context)

    def listen(self) -> bool:
        try:
            return super().listen()
        except DriverError:
            self.lost.add(self.settings.port)
            raise


class GoesOn(Sparrow):
    """Where it was interrupted by a plug."""

    commands: ClassVar[dict[str, WheelSpeeds]] = {}

    def __init__(self, context: DriverContext) -> None:
        super().__init__(context)
        self.again = self.commands.pop(self.settings.port, None)

    def write(self, wheels: WheelSpeeds) -> None:
        self.last = wheels
        super().write(wheels)

    def read(self) -> DriverReading:
        if self.again is not None:
            super().write(self.again)
        return super().read()

    def listen(self) -> bool:
        try:
            return super().listen()
        except DriverError:
            self.commands[self.settings.port] = self.last
            raise


class GreetsWithoutAStop(Sparrow):
    def write(self, wheels: WheelSpeeds) -> None:
        if self.reports:
            super().write(wheels)


class WaitsForRoom(Sparrow):
    def write(self, wheels: WheelSpeeds) -> None:
        if self.line.descriptor >= 0:
            select.select([], [self.line.descriptor], [])
        super().write(wheels)


class WaitsForAnAnswer(Sparrow):
    def read(self) -> DriverReading:
        self.line.wait(0.02)
        return super().read()


class TakesAnySetting(Sparrow):
    class Settings(Sparrow.Settings, extra="allow"):
        pass


class GuessesItsPort(Sparrow):
    class Settings(Sparrow.Settings):
        port: str = "/dev/ttyUSB0"


class TakesAnyNumber(Sparrow):
    class Settings(Sparrow.Settings):
        counts_per_turn: float = 2800.0


class NamelessWhenAbsent(Sparrow):
    def __init__(self, context: DriverContext) -> None:
        if not Path(context.settings.port).exists():
            raise DriverError("there is no such port")
        super().__init__(context)


class NamelessWhenBusy(Sparrow):
    def __init__(self, context: DriverContext) -> None:
        try:
            super().__init__(context)
        except DriverError as error:
            raise DriverError(str(error) if "another program" not in str(error) else "it is busy") from error


class MeetsAnybody(Sparrow):
    def listen(self) -> bool:
        if not self.reports:
            self.reports = [(self.now_ns(), 0, 0, 0)]
        return super().listen()


class ShoutsAround(Sparrow):
    """Moves a Create 2: start, full control, wheels."""

    def write(self, wheels: WheelSpeeds) -> None:
        if not self.reports:
            self.line.write(bytes([128, 132, 145, 0, 100, 0, 100]))
        super().write(wheels)


class ClosesOnce(Sparrow):
    def close(self) -> None:
        if self.line.descriptor < 0:
            raise DriverError(f"{self.settings.port}: closed already")
        super().close()


class MadeTwiceAtMost(Sparrow):
    made: ClassVar[dict[str, list[int]]] = {}

    def __init__(self, context: DriverContext) -> None:
        times = self.made.setdefault(context.settings.port, [])
        times.append(context.now_ns())
        if len(times) == 3 and times[-1] - times[0] > 1_900_000_000 and times[-1] - times[0] < 2_500_000_000:
            raise DriverError(f"{context.settings.port}: not once more")
        super().__init__(context)


class Spins(Sparrow):
    def read(self) -> DriverReading:
        sum(range(100_000))
        return super().read()


class LeavesADescriptor(Sparrow):
    def __init__(self, context: DriverContext) -> None:
        super().__init__(context)
        self._left = os.open("/dev/null", os.O_RDONLY)


class LeavesADescriptorWhenRefused(Sparrow):
    def __init__(self, context: DriverContext) -> None:
        try:
            super().__init__(context)
        except DriverError:
            self._left = os.open("/dev/null", os.O_RDONLY)
            raise


class RemembersEverything(Sparrow):
    def read(self) -> DriverReading:
        reading = super().read()
        self.__dict__.setdefault("_past", []).append(reading)
        return reading
