"""A robot with the binary of an Uno in simavr behind its real driver, in lockstep: a driver for measurements.

    robofleet run configs/firmware.yaml --lockstep $(python -m tools.measure.robots.lockstep_uno [--udp])

Driver, pseudo-terminal and binary live on a clock of their own, which the run's clock moves: the second that the boot
loader takes passes before the run begins. ``--udp``: the firmware compiled for this computer, by UDP.
"""

import socket
import sys
import tempfile
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field

from robofleet.core.clock import MS
from robofleet.drivers.rfp import Rfp
from robofleet.drivers.udp_port import SCHEME
from robofleet.simulation.firmware import Hardware
from robofleet.simulation.firmwares.arduino_uno import ArduinoUnoFirmware
from robofleet.simulation.firmwares.rfp import RfpFirmware
from robofleet.simulation.serial_line import SerialLine
from robofleet.simulation.udp_line import UdpLine
from robofleet.testing.serial_world import shared
from robofleet.vehicles.interface import DriverContext, DriverReading, WheelSpeeds
from robofleet.vehicles.plant import Plant
from robofleet.vehicles.readings import TruePose


class LockstepUno:
    """One robot; it is a simulated one for the run."""

    body_faults: ClassVar[bool] = True
    _make: ClassVar[Any] = ArduinoUnoFirmware

    class Settings(BaseModel):
        """As the driver's, without what a line needs."""

        model_config = ConfigDict(frozen=True, extra="ignore", use_attribute_docstrings=True)

        counts_per_turn: Annotated[float, Field(gt=0)]
        """Encoder counts in one turn of a wheel."""
        gains: tuple[int, int, int]
        """kp, ki, kff."""

    def __init__(self, context: DriverContext) -> None:
        s = context.simulation
        assert s is not None
        self._run_ns = context.now_ns
        self._ns = begin_ns = context.now_ns()
        self._plant = Plant(s.drive, s.imperfections, s.start, s.rng, now_ns=begin_ns, trouble=s.trouble)
        self._hardware = Hardware(s.drive, s.imperfections, self._plant)
        self._firmware = self._make(self._hardware)
        self._target = self._hardware.command
        with ExitStack() as stack:
            port, self._line = self._plug(Path(stack.enter_context(tempfile.TemporaryDirectory())))
            stack.callback(self._line.unplug)
            stack.enter_context(shared(lambda: self._ns, self._pass_until))
            settings = Rfp.Settings(port=port, **context.settings.model_dump())
            if not port.startswith(SCHEME):
                self._firmware.opened(self._ns)
            self._driver = Rfp(replace(context, now_ns=lambda: self._ns, settings=settings))
            self._ahead_ns = self._ns - begin_ns
            self._stack = stack.pop_all()

    def _plug(self, folder: Path) -> tuple[str, Any]:
        """Return the driver's port, and the robot's end."""
        return str(folder / "uno"), SerialLine(folder / "uno")

    def write(self, wheels: WheelSpeeds) -> None:
        self._catch_up()
        self._driver.write(wheels)
        self._hear()

    def read(self) -> DriverReading:
        self._catch_up()
        reading = self._driver.read()
        self._hear()
        return reading

    def truth(self) -> TruePose:
        self._catch_up()
        return self._plant.truth()

    def close(self) -> None:
        self._driver.close()
        self._stack.close()

    def _catch_up(self) -> None:
        self._pass_until(self._run_ns() + self._ahead_ns, all_of_it=True)

    def _pass_until(self, deadline_ns: int, *, all_of_it: bool = False) -> None:
        """Let a millisecond pass, or all of the time until then."""
        self._hear()
        while self._ns < deadline_ns:
            self._ns = min(deadline_ns, (self._ns // MS + 1) * MS)
            self._plant.advance(self._ns)
            self._line.write(self._firmware.loop(self._ns))
            self._act()
            if not all_of_it:
                return

    def _hear(self) -> None:
        if data := self._line.read():
            self._line.write(self._firmware.receive(data, self._ns))
            self._act()

    def _act(self) -> None:
        if self._hardware.command != self._target:
            self._target = self._hardware.command
            self._plant.write(self._target)


class LockstepUdp(LockstepUno):
    """One robot with the firmware that is compiled for this computer, on a network."""

    _make = RfpFirmware

    def _plug(self, folder: Path) -> tuple[str, Any]:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            url = f"{SCHEME}127.0.0.1:{probe.getsockname()[1]}"
        return url, UdpLine(url, lambda: self._ns // 1000 % 2**32)


if __name__ == "__main__":
    kind = "LockstepUdp" if "--udp" in sys.argv else "LockstepUno"
    names = (f"--set robots.{i}.driver=tools.measure.robots.lockstep_uno:{kind}" for i in range(4))
    print(*names, *(f"--set robots.{i}.twin=null" for i in range(4)))
