"""A driver and its robot at two ends of a network that loses, doubles and delays datagrams; on real sockets."""

import heapq
import select
import socket
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Any
from unittest.mock import patch

from robofleet.core.clock import MS
from robofleet.drivers.rfp import Rfp
from robofleet.drivers.udp_port import UdpPort
from robofleet.simulation.firmwares.rfp import RfpFirmware
from robofleet.simulation.udp_line import UdpLine
from tests.drivers.line_bench import COUNTS_PER_TURN, LineBench
from tests.endpoints import free_port
from tests.robots import GTERNAL, IDEAL

Fate = Callable[[bytes], Sequence[tuple[int, bytes]]]  # of a datagram: what arrives, and how late [ns]


def undisturbed(datagram: bytes) -> Sequence[tuple[int, bytes]]:
    return [(0, datagram)]


class NetworkBench(LineBench):
    """As a :class:`LineBench`; what is on its way meets its ``fate``."""

    def __init__(self) -> None:
        encoders = replace(IDEAL, speed_quantum=6.283185307179586 / COUNTS_PER_TURN / 0.005, loop_period=0.005)
        super().__init__(Rfp, RfpFirmware, GTERNAL, IDEAL, 5 * MS, encoders)
        self.fate: Fate = undisturbed
        self.patience_s = 1.0  # real time; a datagram needs none on one computer. 0: the robot may answer another host
        self._written = self._sequence = 0
        self._on_the_way: list[tuple[int, int, bool, bytes]] = []  # arrives [ns], sequence, to the robot, bytes

    def plug(self, stack: ExitStack) -> tuple[Any, Any]:
        self.robot = "127.0.0.1", free_port()
        line = UdpLine(f"udp://127.0.0.1:{self.robot[1]}", lambda: self.now_ns // 1000 % 2**32)
        self._front, self._back = stack.enter_context(datagrams()), stack.enter_context(datagrams())
        self._back.connect(self.robot)
        write = UdpPort.write

        def counted(port: UdpPort, data: bytes) -> None:
            self._written += 1
            write(port, data)

        stack.enter_context(patch.object(UdpPort, "write", counted))
        return f"udp://127.0.0.1:{self._front.getsockname()[1]}", line

    def hear(self) -> bool:
        for _ in range(self._written):
            data, self._driver = self._front.recvfrom(2048)
            self._send(data, to_robot=True)
        self._written = 0
        self._deliver()
        return super().hear()

    def say(self, data: bytes) -> None:
        self.line.write(data)
        for _ in range(data.count(b"\0") if self.line.open else 0):
            if readable(self._back.fileno(), self.patience_s):
                self._send(self._back.recv(2048), to_robot=False)
        self._deliver()

    def let_pass(self, seconds: float) -> None:
        end_ns = self.now_ns + round(seconds * 1e9)
        while self.now_ns < end_ns:
            super().let_pass(min(0.005, (end_ns - self.now_ns) * 1e-9))
            self.hear()

    def arrived(self) -> None:
        """Wait until something has come to the robot."""
        assert readable(self.line.descriptor, 1.0)

    def _send(self, datagram: bytes, *, to_robot: bool) -> None:
        for late_ns, data in self.fate(datagram):
            self._sequence += 1
            heapq.heappush(self._on_the_way, (self.now_ns + late_ns, self._sequence, to_robot, data))

    def _deliver(self) -> None:
        while self._on_the_way and self._on_the_way[0][0] <= self.now_ns:
            *_, to_robot, data = heapq.heappop(self._on_the_way)
            if to_robot and self.line.descriptor is not None:
                self._back.send(data)
                self.arrived()
            elif to_robot:
                continue  # it is not on the network
            else:
                self._front.sendto(data, self._driver)


def datagrams() -> socket.socket:
    """Return a socket of this computer's own."""
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind(("127.0.0.1", 0))
    made.settimeout(1.0)
    return made


def readable(descriptor: int, seconds: float) -> bool:
    """Return whether something comes within real time: ``select`` lets the bench's time pass."""
    poll = select.poll()
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(seconds * 1e3))
