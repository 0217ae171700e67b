"""A firmware's twin: a simulated body, the firmware that moves it, and a port that a driver opens."""

from collections.abc import Callable, Sequence
from pathlib import Path

from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S
from robofleet.core.plugins import load
from robofleet.drivers.udp_port import LOOPBACK
from robofleet.simulation.faults import Schedule
from robofleet.simulation.faulty_line import Ledger, TwinTroubles
from robofleet.simulation.firmware import Firmware, Hardware
from robofleet.simulation.serial_line import SerialLine, Wire
from robofleet.simulation.udp_line import UdpLine
from robofleet.vehicles.interface import STOP
from robofleet.vehicles.plant import Plant
from robofleet.vehicles.plants import SharedPlant
from robofleet.vehicles.readings import SensorReading, TruePose
from robofleet.vehicles.sensors import SimulatedSensors

Others = Callable[[], Sequence[tuple[TruePose, float]]]  # where other robots are, and their bodies' radii [m]

_NETWORK_BAUD = 10**9
_UNOPENED_NS = 10 * MS  # nothing tells when the host opens the port: it is looked at so often
_BUFFER_BYTES = 64  # that wait for a firmware that hangs


class Twin:
    """One robot's twin, switched on at ``now_ns`` with its port at ``port``, a path or ``udp://127.0.0.1:PORT``.

    The caller's clock is its time.
    """

    def __init__(
        self, config: Config, robot: str, port: str, now_ns: int, faults: Schedule | None = None,
        others: Others = lambda: (), plant: SharedPlant | None = None,
    ) -> None:  # fmt: skip
        """Put it there; ``others`` tells the bodies that its distance sensors see; ``plant``: that it shares."""
        kind = config.robot(robot)
        s = slices.simulation(config, kind, None if faults is None else faults.body_trouble(robot))
        self._plant = (
            Plant(s.drive, s.imperfections, s.start, s.rng, now_ns=now_ns, trouble=s.trouble)
            if plant is None
            else plant.robot(robot, s.trouble)
        )
        self.truth = self._plant.truth  # at the last step
        self.hardware, spare = (Hardware(s.drive, s.imperfections, self._plant) for _ in range(2))
        self.radius, self.others = s.radius, others
        if s.sensing is not None:
            self._sensors = SimulatedSensors([0], [s.sensing])
            self.hardware.sense = self._sense
        make = load("robofleet.twins", str(kind.twin))
        self._firmware: Firmware = make(self.hardware)
        self._target = STOP
        self._loop_period_ns = round(s.imperfections.loop_period * S)
        self._loop_ns = now_ns + self._loop_period_ns
        self._now_ns = now_ns
        self._network = port.startswith(LOOPBACK)  # which has no baud rate, and resets no board
        baud = _NETWORK_BAUD if self._network else self._firmware.baud
        self._to_robot, self._to_host = Wire(baud), Wire(baud)
        self._waiting = b""  # for a firmware that hangs
        self._troubles = TwinTroubles(faults, robot)
        self.ledger = (
            Ledger(self._firmware, self.hardware, make(spare), spare) if self._troubles.to_robot.injections else None
        )
        self._line = UdpLine(port, lambda: self._now_ns // 1000 % 2**32) if self._network else SerialLine(Path(port))

    @property
    def descriptor(self) -> int | None:
        """What becomes readable when the driver writes; None while it has not opened the port."""
        return self._line.descriptor

    def _sense(self, now_ns: int) -> SensorReading:
        others = self.others()
        truths, radii = [self.truth(), *(true for true, _ in others)], [0.0, *(radius for _, radius in others)]
        return self._sensors.first(now_ns, truths, radii)

    def step(self, now_ns: int) -> int:
        """Let time pass until ``now_ns``; returns when the next step is due [ns], if nothing is heard before."""
        self._now_ns = now_ns
        if self._troubles.unplugged(now_ns):
            self._line.unplug()
        else:
            self._line.plug()
        self._listen(now_ns)
        while (at_ns := int(min(self._loop_ns, self._to_robot.next_ns))) <= now_ns:
            self._plant.advance(at_ns)
            self._run(at_ns)
        self._plant.advance(now_ns)
        self._line.write(self._to_host.take(now_ns))
        next_ns = int(min(self._loop_ns, self._to_robot.next_ns, self._to_host.next_ns))
        return next_ns if self._line.open else min(next_ns, now_ns + _UNOPENED_NS)

    def close(self) -> None:
        """Take the port away. Idempotent."""
        self._line.unplug()

    def _listen(self, now_ns: int) -> None:
        """Notice that the driver has opened the port, and take what it has written."""
        was_open = self._line.open
        data = self._line.read()
        if (self._line.open or data) and not was_open and not self._network:
            self._to_robot.clear()
            self._to_host.clear()
            self._firmware.opened(now_ns)
            if self.ledger is not None:
                self.ledger.opened(now_ns)
            self._act(now_ns)
        if data and self.ledger is not None:
            self.ledger.sent(data, now_ns)
        line, late_ns = self._troubles.to_robot.befall(data, now_ns)
        self._to_robot.put(line, now_ns, late_ns)

    def _run(self, now_ns: int) -> None:
        """Let the firmware take what has arrived, and run its loop when that is due."""
        looping = now_ns == self._loop_ns
        self.hardware.feels = self._troubles.feels(now_ns)
        if looping and self.ledger is not None:
            self.ledger.loop(now_ns)
        data = self._waiting + self._to_robot.take(now_ns)
        if self._troubles.hangs(now_ns):
            self._waiting = data[:_BUFFER_BYTES]
        else:
            self._waiting = b""
            if data:
                self._say(self._firmware.receive(data, now_ns), now_ns)
            if looping:
                self._say(self._firmware.loop(now_ns), now_ns)
            self._act(now_ns)
        if looping:
            self._loop_ns += self._loop_period_ns

    def _say(self, data: bytes, now_ns: int) -> None:
        line, late_ns = self._troubles.to_host.befall(data, now_ns)
        self._to_host.put(line, now_ns, late_ns)

    def _act(self, now_ns: int) -> None:
        """Let the wheel-speed loops aim at what the firmware has decided."""
        if self.hardware.command != self._target:
            self._target = self.hardware.command
            self._plant.write(self._target)
        if self.ledger is not None:
            self.ledger.look(now_ns)
