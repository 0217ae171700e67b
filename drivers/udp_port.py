"""A robot's port on a network, ``udp://HOST:PORT``: the same methods as a serial port's, a write is one datagram."""

import errno
import re
import select
import socket

from robofleet.vehicles.interface import DriverError

SCHEME = "udp://"
LOOPBACK = f"{SCHEME}127.0.0.1:"  # where twins answer: nobody else reaches them
_URL = re.compile(rf"{SCHEME}([\w.-]+):(\d{{1,5}})", re.ASCII)
_MOST_DATAGRAMS_AT_ONCE = 256
_MOST_BYTES = 2048
_PAUSE_NS = 10_000_000  # a datagram takes a radio 0.1 to 0.2 ms, whatever its size: not more of them than a line had
_LOST = {
    errno.ECONNREFUSED: "no program listens at this port: flash drivers/firmware for UDP, or mend settings.port",
    errno.EHOSTUNREACH: "nobody has this address: is the robot on, and in reach of its Wi-Fi?",
    errno.ENETUNREACH: "no network leads there: plug in this computer's network, or mend settings.port",
    errno.ENETDOWN: "no network leads there: plug in this computer's network, or mend settings.port",
}
_WHOLE_NETWORK = "this address is not one robot's: mend settings.port"


class UdpPort:
    """One robot's end of a network. Datagrams of others are not seen.

    What the network does not take is lost, as on its way: silence alone tells the driver.

    Attributes:
        descriptor: The socket's file descriptor. -1: closed.
    """

    def __init__(self, url: str) -> None:
        """Find the robot's address; nothing is sent.

        Args:
            url: ``udp://HOST:PORT``; a name or an IPv4 address.

        Raises:
            DriverError: There is no such host. The message says why, and the cure.
        """
        host, port = host_and_port(url)
        self._trouble: int | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.connect(socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)[0][4])
        except (socket.gaierror, UnicodeError) as error:
            self._socket.close()
            raise DriverError(
                f"{url}: the name {host} does not resolve: write the robot's address, or mend the network's names"
            ) from error
        except OSError as error:
            self._socket.close()
            why = _WHOLE_NETWORK if error.errno == errno.EACCES else _LOST.get(error.errno or 0, str(error))
            raise DriverError(f"{url}: {why}") from error
        self.descriptor = self._socket.fileno()

    @property
    def silence(self) -> str:
        """Why nothing comes, as far as the network knows, and the cure."""
        return _LOST.get(self._trouble or 0, "is the robot on, and in reach of its Wi-Fi?")

    def duration_ns(self, data: bytes) -> int:
        """Tell how long a write keeps the line busy.

        Args:
            data: What is written.

        Returns:
            The time [ns].
        """
        return _PAUSE_NS

    def read(self) -> bytes:
        """Take what has come since the last call, without waiting; a zero ends each datagram."""
        datagrams = []
        try:
            for _ in range(_MOST_DATAGRAMS_AT_ONCE):
                datagrams.append(self._socket.recv(_MOST_BYTES) + b"\0")
        except BlockingIOError:
            pass
        except OSError as error:
            self._trouble = error.errno
        if datagrams:
            self._trouble = None
        return b"".join(datagrams)

    def write(self, data: bytes) -> None:
        """Send a datagram, without waiting."""
        try:
            self._socket.send(data)
        except OSError as error:
            self._trouble = error.errno

    def wait(self, seconds: float) -> bool:
        """Wait until something has come; only while a driver is being made. Returns whether it has."""
        return bool(select.select([self.descriptor], [], [], max(0.0, seconds))[0])

    def close(self) -> None:
        """Close; idempotent."""
        self.descriptor = -1
        self._socket.close()


def host_and_port(url: str) -> tuple[str, int]:
    """Return both; DriverError where it is no ``udp://HOST:PORT``."""
    found = _URL.fullmatch(url)
    if found is None or not 0 < int(found[2]) < 65536:
        raise DriverError(f"{url}: write {SCHEME}HOST:PORT, for example {SCHEME}192.168.1.21:4210")
    return found[1], int(found[2])
