"""The robot's end of a network: the socket part of this project's firmware (``udp.c``), at a port of 127.0.0.1."""

from collections.abc import Callable

from robofleet.core.errors import RobofleetError
from robofleet.drivers.udp_port import LOOPBACK, host_and_port
from robofleet.simulation.firmware_library import firmware_library

_MOST_BYTES = 128  # UDP_BYTES
_OWN = f"a twin needs a free port of this computer: write {LOOPBACK}PORT"
_LOOPBACK = 0x7F000001


class UdpLineError(RobofleetError):
    """Raised where a twin cannot have its port. The message says why, and the cure."""


class UdpLine:
    """As a :class:`SerialLine`; ``now_us``: the board's clock."""

    def __init__(self, url: str, now_us: Callable[[], int]) -> None:
        self._url, self._now_us = url, now_us
        _, self._port = host_and_port(url)
        self._ffi, self._c = firmware_library({})
        self._udp = self._ffi.new("struct udp *", {"descriptor": -1})
        self._bytes = self._ffi.new("uint8_t[]", _MOST_BYTES)
        self.plug()

    @property
    def descriptor(self) -> int | None:
        """What becomes readable when a datagram comes; None while there can be none."""
        return self._udp.descriptor if self._udp.descriptor >= 0 else None

    @property
    def open(self) -> bool:
        """Whether there is a host that the robot answers."""
        return self.descriptor is not None and bool(self._udp.port)

    def plug(self) -> None:
        """Let the robot be on the network."""
        if self._udp.descriptor < 0 and not self._c.udp_open(self._udp, _LOOPBACK, self._port):
            raise UdpLineError(f"{self._url}: {_OWN}")

    def unplug(self) -> None:
        """Let the robot be gone. Idempotent."""
        self._c.udp_close(self._udp)

    def read(self) -> bytes:
        """Return what hosts have sent; a zero ends each datagram."""
        datagrams = []
        while self._udp.descriptor >= 0 and (length := self._c.udp_receive(self._udp, self._bytes, self._now_us())):
            datagrams.append(bytes(self._ffi.buffer(self._bytes, length)))
        return b"".join(datagrams)

    def write(self, data: bytes) -> None:
        """Send to the host, a frame a datagram."""
        for frame in data.split(b"\0"):
            if frame and self._udp.descriptor >= 0:
                self._c.udp_send(self._udp, frame + b"\0", len(frame) + 1, self._now_us())
