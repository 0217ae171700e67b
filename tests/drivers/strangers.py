"""What else may be found at a serial port: nothing that answers, something that says everything back, and noise."""

import zlib

from robofleet.simulation.firmware import Hardware


class Mute:
    """Takes everything and says nothing."""

    baud = 115200
    watchdog_s: float | None = 1.0

    def __init__(self, hardware: Hardware) -> None:
        pass

    def opened(self, now_ns: int) -> None:
        pass

    def receive(self, data: bytes, now_ns: int) -> bytes:
        return b""

    def loop(self, now_ns: int) -> bytes:
        return b""


class Echo(Mute):
    """Says back what it hears: a modem, or a plug whose two pins touch."""

    def receive(self, data: bytes, now_ns: int) -> bytes:
        return data


class Chatter(Mute):
    """Says something all the time, as a baud rate that is not the robot's looks like."""

    def loop(self, now_ns: int) -> bytes:
        return zlib.crc32(str(now_ns).encode()).to_bytes(4, "little") * 3
