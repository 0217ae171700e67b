"""A robot's serial port: opened with plain words, read and written without ever waiting for the robot."""

import errno
import os
import select

import serial

from robofleet.vehicles.interface import DriverError

_MOST_BYTES_AT_ONCE = 65536
_BITS_A_BYTE = 10  # with start and stop bit
_WHY = {
    errno.ENOENT: "there is no such port: plug the robot in, switch it on, or mend settings.port",
    errno.EACCES: "this user may not open it: join the group dialout, or install the udev rules of tools/deploy",
    errno.EAGAIN: "another program has it open: end that one",
    errno.EBUSY: "another program has it open: end that one",
    errno.ENOTTY: "this is not a serial port: mend settings.port",
    errno.EISDIR: "this is not a serial port: mend settings.port",
}


class SerialPort:
    """One robot's serial line, 8N1. Every method raises DriverError with the port's name once the line is gone.

    Attributes:
        descriptor: The line's file descriptor. -1: closed.
        silence: Why nothing may come, and the cure.
    """

    silence = "is the robot on, and its cable good?"

    def __init__(self, path: str, baud: int) -> None:
        """Open the line, for this process alone.

        Args:
            path: The device, ``/dev/ttyUSB0`` for example.
            baud: Rate [bit/s].

        Raises:
            DriverError: It cannot be opened. The message says why, and the cure.
        """
        self._path, self._baud = path, baud
        try:
            self._serial = serial.Serial(path, baud, timeout=0, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            first = error if getattr(error, "errno", None) else error.__context__  # pyserial drops a number or two
            number = getattr(first, "errno", None) or getattr(first, "args", (0,))[0]
            raise DriverError(f"{path}: {_WHY.get(number, str(error))}") from error
        self.descriptor = self._serial.fileno()

    def duration_ns(self, data: bytes) -> int:
        """Tell how long a write keeps the line busy.

        Args:
            data: What is written.

        Returns:
            The time [ns].
        """
        return len(data) * _BITS_A_BYTE * 1_000_000_000 // self._baud

    def read(self) -> bytes:
        """Take what has come since the last call, without waiting.

        Returns:
            At most 64 KiB.

        Raises:
            DriverError: The line is gone.
        """
        try:
            return bytes(self._serial.read(_MOST_BYTES_AT_ONCE))
        except (serial.SerialException, OSError, TypeError) as error:
            raise self._gone() from error

    def write(self, data: bytes) -> None:
        """Hand the bytes to the kernel, without waiting; pyserial's own write would spin where the kernel takes none.

        Args:
            data: All of it is taken, or the call fails.

        Raises:
            DriverError: The line is gone, or the robot takes no more bytes.
        """
        try:
            taken = os.write(self.descriptor, data)
        except BlockingIOError:
            taken = 0
        except (OSError, TypeError) as error:
            raise self._gone() from error
        if taken < len(data):
            raise DriverError(f"{self._path}: the robot takes no more bytes: look at its firmware and its cable")

    def wait(self, seconds: float) -> bool:
        """Wait until something has come; only while a driver is being made.

        Args:
            seconds: The longest time to wait [s].

        Returns:
            Whether something has come.

        Raises:
            DriverError: The line is gone.
        """
        try:
            return bool(select.select([self.descriptor], [], [], max(0.0, seconds))[0])
        except (OSError, TypeError, ValueError) as error:
            raise self._gone() from error

    def close(self) -> None:
        """Let the last bytes go out, and close. Idempotent."""
        self.descriptor = -1  # the number is somebody else's soon
        self._serial.close()

    def _gone(self) -> DriverError:
        return DriverError(f"{self._path}: the line is gone: plug it in again")
