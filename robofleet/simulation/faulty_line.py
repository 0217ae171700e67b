"""Faults of a twin and of its serial line, and an account of the wrong motions that follow."""

from functools import reduce
from operator import or_

import numpy as np

from robofleet.core.clock import MS, S
from robofleet.simulation.faults import Injection, Schedule, struck
from robofleet.simulation.firmware import Firmware, Hardware
from robofleet.vehicles.interface import STOP, RobotFault, WheelSpeeds

TOUCHES = {"bumper_hit": RobotFault.BUMPED, "cliff": RobotFault.CLIFF, "wheel_lifted": RobotFault.WHEEL_DROPPED}
_GARBLED = 0.25  # share of a line's bytes that are replaced in garbage; one at least
_REMEMBERED_NS = 300 * MS  # of what the driver has sent: a line that comes late is not a wrong one


class TwinTroubles:
    """What is wrong with one twin now; without a schedule never anything."""

    def __init__(self, schedule: Schedule | None, robot: str) -> None:
        def of(*kinds: str) -> tuple[Injection, ...]:
            return () if schedule is None else schedule.of(*kinds, robot=robot)

        self._felt = [(flag, of(kind)) for kind, flag in TOUCHES.items()]
        self._unplugged, self._hangs = of("unplugged"), of("firmware_hangs")
        self.to_robot, self.to_host = (LineTroubles(schedule, robot, way) for way in ("to robot", "to host"))

    def feels(self, now_ns: int) -> RobotFault:
        """Return what touches the robot."""
        return reduce(or_, (flag for flag, touches in self._felt if struck(touches, now_ns)), RobotFault(0))

    def unplugged(self, now_ns: int) -> bool:
        return struck(self._unplugged, now_ns)

    def hangs(self, now_ns: int) -> bool:
        return struck(self._hangs, now_ns)


class LineTroubles:
    """What becomes of the lines of one direction. A line is what is said at once: a write of the driver, an answer."""

    def __init__(self, schedule: Schedule | None, robot: str, way: str) -> None:
        found = () if schedule is None else schedule.of("line_cut", "line_garbage", "line_late")
        self.injections = [injection for injection in found if injection.fault.robot in (None, robot)]
        self._rng = None if schedule is None else schedule.rng("line", robot, way)

    def befall(self, line: bytes, now_ns: int) -> tuple[bytes, int]:
        """Return what arrives of a line, and how late [ns]."""
        late_ns = 0
        for injection in self.injections:
            assert self._rng is not None
            if line and injection.acts(now_ns) and self._rng.random() < injection.fault.share:
                injection.effects += 1
                if injection.fault.kind == "line_late":
                    late_ns += round(injection.fault.delay_s * S)
                else:
                    line = _SPOILT[injection.fault.kind](line, self._rng)
        return line, late_ns


def cut(line: bytes, rng: np.random.Generator) -> bytes:
    return line[: rng.integers(len(line))]


def garbled(line: bytes, rng: np.random.Generator) -> bytes:
    """Return a line of which some bytes are others."""
    received = np.frombuffer(line, np.uint8).copy()
    which = rng.random(len(line)) < _GARBLED
    which[rng.integers(len(line))] = True
    received[which] = rng.integers(256, size=int(which.sum()))
    return received.tobytes()


_SPOILT = {"line_cut": cut, "line_garbage": garbled}


class Ledger:
    """Counts wrong motions: targets of the wheels that a firmware which hears every byte well has not had lately.

    That firmware is a second one of the same kind, on ``spare``. So the count knows no protocol; a stop is never wrong.
    """

    def __init__(self, firmware: Firmware, hardware: Hardware, healthy: Firmware, spare: Hardware) -> None:
        self.wrong = 0
        self.furthest = 0.0  # of a wrong target from everything that was sent, of one wheel [rad/s]
        self.longest_ns = 0  # that wrong targets lasted, one after the other
        self._firmware, self._hardware, self._healthy, self._spare = firmware, hardware, healthy, spare
        self._sent: dict[WheelSpeeds, int] = {}  # when the healthy one aimed at it last [ns]
        self._target = STOP
        self._wrong_since_ns: int | None = None

    def opened(self, now_ns: int) -> None:
        self._healthy.opened(now_ns)
        self._note(now_ns)

    def sent(self, data: bytes, now_ns: int) -> None:
        self._healthy.receive(data, now_ns)
        self._healthy.loop(now_ns)  # it may look at its newest orders then only, and the robot at any of them
        self._note(now_ns)

    def loop(self, now_ns: int) -> None:
        """A period of the wheel-speed loop has passed."""
        self._spare.feels = self._hardware.feels
        self._healthy.loop(now_ns)
        self._note(now_ns)

    def look(self, now_ns: int) -> None:
        """Judge what the robot aims at now."""
        target = _target(self._firmware, self._hardware)
        if self._wrong_since_ns is not None:
            self.longest_ns = max(self.longest_ns, now_ns - self._wrong_since_ns)
        if target == STOP or target in self._sent:
            self._wrong_since_ns = None
        elif target != self._target:
            self.wrong += 1
            if self._wrong_since_ns is None:
                self._wrong_since_ns = now_ns
            self.furthest = max(self.furthest, min(_apart(target, wheels) for wheels in (*self._sent, STOP)))
        self._target = target

    def _note(self, now_ns: int) -> None:
        self._sent[_target(self._healthy, self._spare)] = now_ns
        self._sent = {wheels: at_ns for wheels, at_ns in self._sent.items() if at_ns >= now_ns - _REMEMBERED_NS}


def _target(firmware: Firmware, hardware: Hardware) -> WheelSpeeds:
    target: WheelSpeeds = getattr(firmware, "target", hardware.command)
    return target


def _apart(first: WheelSpeeds, other: WheelSpeeds) -> float:
    return max(abs(first.left - other.left), abs(first.right - other.right))
