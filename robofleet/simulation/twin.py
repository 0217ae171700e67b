"""A firmware's twin: a simulated body, the firmware that moves it, and a serial port that a driver opens."""

from pathlib import Path

from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.plugins import load
from robofleet.simulation.faults import Schedule
from robofleet.simulation.firmware import Firmware, Hardware
from robofleet.simulation.serial_line import SerialLine, Wire
from robofleet.vehicles.body import Body
from robofleet.vehicles.interface import STOP, TruePose

_UNOPENED_NS = 10_000_000  # nothing tells when the host opens the port: it is looked at so often


class Twin:
    """One robot's twin, switched on at ``now_ns`` with its port at ``port``. The caller's clock is its time."""

    def __init__(self, config: Config, robot: str, port: Path, now_ns: int, faults: Schedule | None = None) -> None:
        kind = config.robot(robot)
        simulation = slices.simulation(config, kind, None if faults is None else faults.body_trouble(robot))
        self._body = Body(simulation, now_ns)
        self._hardware = Hardware(simulation.drive, simulation.imperfections, self._body.plant)
        self._firmware: Firmware = load("robofleet.twins", str(kind.twin))(self._hardware)
        self._target = STOP
        self._loop_period_ns = round(simulation.imperfections.loop_period * 1e9)
        self._loop_ns = now_ns + self._loop_period_ns
        self._to_robot, self._to_host = Wire(self._firmware.baud), Wire(self._firmware.baud)
        self._line = SerialLine(port)

    @property
    def descriptor(self) -> int | None:
        """What becomes readable when the driver writes; None while it has not opened the port."""
        return self._line.descriptor

    def truth(self) -> TruePose:
        """Return the true pose at the last step."""
        return self._body.plant.truth()

    def step(self, now_ns: int) -> int:
        """Let time pass until ``now_ns``; returns when the next step is due [ns], if nothing is heard before."""
        self._listen(now_ns)
        while (at_ns := int(min(self._loop_ns, self._to_robot.next_ns))) <= now_ns:
            self._body.advance(at_ns)
            if data := self._to_robot.take(at_ns):
                self._say(self._firmware.receive(data, at_ns), at_ns)
            if at_ns == self._loop_ns:
                self._say(self._firmware.loop(at_ns), at_ns)
                self._loop_ns += self._loop_period_ns
            self._act()
        self._body.advance(now_ns)
        self._line.write(self._to_host.take(now_ns))
        next_ns = int(min(self._loop_ns, self._to_robot.next_ns, self._to_host.next_ns))
        return next_ns if self._line.open else min(next_ns, now_ns + _UNOPENED_NS)

    def close(self) -> None:
        """Take the port away. Idempotent."""
        self._line.unplug()

    def _listen(self, now_ns: int) -> None:
        was_open = self._line.open
        data = self._line.read()
        if (self._line.open or data) and not was_open:
            self._to_robot.clear()
            self._to_host.clear()
            self._firmware.opened(now_ns)
            self._act()
        self._to_robot.put(data, now_ns)

    def _say(self, data: bytes, now_ns: int) -> None:
        self._to_host.put(data, now_ns)

    def _act(self) -> None:
        """Let the wheel-speed loops aim at what the firmware has decided."""
        if self._hardware.command != self._target:
            self._target = self._hardware.command
            self._body.command(self._target)
