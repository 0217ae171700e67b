"""The made-up robot's driver, broken on purpose: each class in one way. ``test_contract_sabotage.py`` says in which."""

import os
import select
from pathlib import Path
from typing import ClassVar

from pydantic import ConfigDict, Field

from drivers.serial_port import SerialPort
from robofleet.vehicles.interface import STOP, DriverContext, DriverError, DriverReading, WheelSpeeds
from tests.drivers.line_robot import BAUD, LineRobot, LineSettings


class Reversed(LineRobot):
    def write(self, wheels: WheelSpeeds) -> None:
        super().write(WheelSpeeds(-wheels.left, -wheels.right))


class Swapped(LineRobot):
    def write(self, wheels: WheelSpeeds) -> None:
        super().write(WheelSpeeds(wheels.right, wheels.left))


class CoarselyRounded(LineRobot):
    def write(self, wheels: WheelSpeeds) -> None:
        super().write(WheelSpeeds(round(wheels.left / 0.7) * 0.7, round(wheels.right / 0.7) * 0.7))


class CountsBackwards(LineRobot):
    def read(self) -> DriverReading:
        reading = super().read()
        return reading._replace(left_angle=-reading.left_angle)


class DegreesPerSecond(LineRobot):
    def read(self) -> DriverReading:
        reading = super().read()
        return reading._replace(right_speed=57.3 * reading.right_speed)


class BatteryInVolts(LineRobot):
    def read(self) -> DriverReading:
        return super().read()._replace(battery=11.1)


class MovesWhenMade(LineRobot):
    def __init__(self, context: DriverContext) -> None:
        super().__init__(context)
        self.write(WheelSpeeds(1.0, 1.0))


class RoundsUpAtTheLimit(LineRobot):
    def write(self, wheels: WheelSpeeds) -> None:
        factor = 1.03 if max(map(abs, wheels)) > 12.0 else 1.0
        super().write(WheelSpeeds(factor * wheels.left, factor * wheels.right))


class SaysItAgain(LineRobot):
    """As a driver whose polling is as good as a command to its firmware."""

    _told = STOP

    def write(self, wheels: WheelSpeeds) -> None:
        self._told = wheels
        super().write(wheels)

    def read(self) -> DriverReading:
        super().write(self._told)
        return super().read()


class LeavesItTurning(LineRobot):
    def close(self) -> None:
        self.closed = True
        self._port.close()


class WritesWhenClosed(LineRobot):
    def write(self, wheels: WheelSpeeds) -> None:
        if not self.closed:
            super().write(wheels)
            return
        self.closed, self._port = False, SerialPort(self._path, BAUD)
        super().write(wheels)
        self.closed = True
        self._port.close()


class BelievesEveryLine(LineRobot):
    def _fields(self, line: bytes) -> list[int]:
        return [int(field) for field in line.split()[1:4]] if line.startswith(b"s ") else []


class MiscountsBadLines(LineRobot):
    def _fields(self, line: bytes) -> list[int]:
        fields = super()._fields(line)
        if line and not fields:
            self._first = self._first[0] + 100, self._first[1]
        return fields


class NeverMissesIt(LineRobot):
    silent_ns = 1 << 62


class WritesIntoTheVoid(LineRobot):
    def write(self, wheels: WheelSpeeds) -> None:
        try:
            super().write(wheels)
        except DriverError:
            if self.closed:
                raise


class ReadsFromTheVoid(LineRobot):
    def _listen(self) -> None:
        try:
            super()._listen()
        except DriverError:
            if not self._counts:
                raise


class SeesNoPlug(WritesIntoTheVoid, ReadsFromTheVoid):
    pass


class ComesBackOnce(LineRobot):
    lost: ClassVar[set[str]] = set()

    def __init__(self, context: DriverContext) -> None:
        if context.settings.port in self.lost:
            raise DriverError(f"{context.settings.port}: lost for good")
        super().__init__(context)

    def _listen(self) -> None:
        try:
            super()._listen()
        except DriverError:
            self.lost.add(self._path)
            raise


class GoesOn(LineRobot):
    """Where it was interrupted by a plug."""

    told: ClassVar[dict[str, WheelSpeeds]] = {}

    def __init__(self, context: DriverContext) -> None:
        super().__init__(context)
        self._again = self.told.pop(self._path, None)

    def write(self, wheels: WheelSpeeds) -> None:
        self._last = wheels
        super().write(wheels)

    def read(self) -> DriverReading:
        if self._again is not None:
            super().write(self._again)
        return super().read()

    def _listen(self) -> None:
        try:
            super()._listen()
        except DriverError:
            self.told[self._path] = self._last
            raise


class GreetsWithoutAStop(LineRobot):
    greeting = b""


class WaitsForRoom(LineRobot):
    def write(self, wheels: WheelSpeeds) -> None:
        select.select([], [self._port.descriptor], [])
        super().write(wheels)


class WaitsForAnAnswer(LineRobot):
    def read(self) -> DriverReading:
        self._port.wait(0.02)
        return super().read()


class TakesAnySetting(LineRobot):
    class Settings(LineSettings):
        model_config = ConfigDict(extra="allow")


class GuessesItsPort(LineRobot):
    class Settings(LineSettings):
        port: str = "/dev/ttyUSB0"


class TakesAnyNumber(LineRobot):
    class Settings(LineSettings):
        counts_per_turn: float = Field(default=2800.0)


class NamelessWhenAbsent(LineRobot):
    def __init__(self, context: DriverContext) -> None:
        if not Path(context.settings.port).exists():
            raise DriverError("there is no such port")
        super().__init__(context)


class NamelessWhenBusy(LineRobot):
    def __init__(self, context: DriverContext) -> None:
        try:
            super().__init__(context)
        except DriverError as error:
            raise DriverError(str(error) if "another program" not in str(error) else "it is busy") from error


class MeetsAnybody(LineRobot):
    def _listen(self) -> None:
        self._rest += self._port.read()
        if self._rest and not self._counts:
            self._counts = [(self._now_ns(), 0, 0)]
        super()._listen()


class ShoutsAround(LineRobot):
    """Moves a Create 2: start, full control, wheels."""

    greeting = bytes([128, 132, 145, 0, 100, 0, 100])


class ClosesOnce(LineRobot):
    def close(self) -> None:
        if self.closed:
            raise DriverError(f"{self._path}: closed already")
        super().close()


class MadeTwiceAtMost(LineRobot):
    made: ClassVar[dict[str, list[int]]] = {}

    def __init__(self, context: DriverContext) -> None:
        times = self.made.setdefault(context.settings.port, [])
        times.append(context.now_ns())
        if len(times) == 3 and times[-1] - times[0] > 1_900_000_000 and times[-1] - times[0] < 2_500_000_000:
            raise DriverError(f"{context.settings.port}: not once more")
        super().__init__(context)


class Spins(LineRobot):
    def read(self) -> DriverReading:
        sum(range(100_000))
        return super().read()


class LeavesADescriptor(LineRobot):
    def __init__(self, context: DriverContext) -> None:
        super().__init__(context)
        self._left = os.open("/dev/null", os.O_RDONLY)


class LeavesADescriptorWhenRefused(LineRobot):
    def __init__(self, context: DriverContext) -> None:
        try:
            super().__init__(context)
        except DriverError:
            self._left = os.open("/dev/null", os.O_RDONLY)
            raise


class RemembersEverything(LineRobot):
    def read(self) -> DriverReading:
        reading = super().read()
        self.__dict__.setdefault("_past", []).append(reading)
        return reading
