"""A robot's driver that comes back: closed when it fails, and made again in a thread, ever more patiently."""

import math
import threading
from collections.abc import Callable
from contextlib import suppress

from robofleet.core.clock import S
from robofleet.vehicles.interface import STOP, Driver, DriverError, DriverReading, WheelSpeeds
from robofleet.vehicles.sensors import is_sound

_FIRST_S, _LONGEST_S = 0.2, 2.0  # between two attempts
_WELL_NS = 5 * S  # a driver that lasted so long is sought without haste or delay again
_PUT_DOWN_S = 0.3  # a driver that failed has so long to switch the motors off when the process ends
_U32 = 1 << 32


class ReconnectingDriver:
    """A driver in its own driver's place. While that one is away every call raises at once.

    A robot that is back is taken up with the first zero that it is told, so nothing that was on its way when it was
    lost moves it. Its angles go on from where they were; what its wheels turned unseen is not in them.
    """

    def __init__(self, make: Callable[[], Driver], now_ns: Callable[[], int]) -> None:
        """Make it for the first time; raises what its driver raises."""
        self._make, self._now_ns = make, now_ns
        self._driver: Driver | None = make()
        self._made_ns = now_ns()
        self._returned: Driver | None = None  # made again, and not taken up yet
        self._why = ""  # newest reason why it is away
        self._pause_s = _FIRST_S
        self._turned = self._before = (0.0, 0.0)  # angles as read last, and when this driver was taken up [rad]
        self._closed, self._put_down = threading.Event(), threading.Event()
        self._put_down.set()
        self._closing = threading.Lock()

    def write(self, wheels: WheelSpeeds) -> None:
        if wheels == STOP:
            self._take_up()
        try:
            self._present().write(wheels)
        except Exception as error:
            self._lose(error)
            raise

    def read(self) -> DriverReading:
        try:
            reading = sound(self._present().read())
            left, right = self._before
            self._turned = left + reading.left_angle, right + reading.right_angle
            return reading._replace(left_angle=self._turned[0], right_angle=self._turned[1])
        except Exception as error:
            self._lose(error)
            raise

    def close(self) -> None:
        """Motors off, of a driver too that failed just now. Idempotent."""
        with self._closing:
            self._closed.set()
            drivers = self._driver, self._returned
            self._driver = self._returned = None
        self._why = "it is closed"
        for driver in drivers:
            if driver is not None:
                driver.close()
        self._put_down.wait(_PUT_DOWN_S)

    def _present(self) -> Driver:
        if self._driver is None:
            raise DriverError(self._why)
        return self._driver

    def _take_up(self) -> None:
        with self._closing:
            if self._returned is not None:
                self._driver, self._returned = self._returned, None
                self._before, self._made_ns = self._turned, self._now_ns()

    def _lose(self, error: Exception) -> None:
        """Let go of a driver that failed, and begin to bring it back."""
        driver, self._driver = self._driver, None
        if driver is None:
            return
        self._why = in_words(error)
        if self._now_ns() - self._made_ns > _WELL_NS:
            self._pause_s = _FIRST_S
        self._put_down.clear()
        threading.Thread(target=self._bring_back, args=(driver,), daemon=True).start()

    def _bring_back(self, driver: Driver) -> None:
        """Do what may take seconds: the loop that drives this robot and its neighbours never waits for it."""
        with suppress(Exception):
            driver.close()
        self._put_down.set()
        while not self._closed.wait(self._pause_s):
            self._pause_s = min(2 * self._pause_s, _LONGEST_S)
            try:
                returned = self._make()
            except Exception as error:  # noqa: BLE001 - whatever it is, the next attempt may do
                self._why = in_words(error)
                continue
            with self._closing:
                if not self._closed.is_set():
                    self._returned = returned
                    return
            returned.close()


def in_words(error: Exception) -> str:
    """Return what a driver raised: its own words, or what kind of mistake it is."""
    return str(error) if isinstance(error, DriverError) else repr(error)


def sound(reading: DriverReading) -> DriverReading:
    """Return the reading; ValueError if it says nothing."""
    possible = math.isfinite(sum(reading[:4])) and 0 <= reading.faults < _U32
    if not possible or (reading.sensors is not None and not is_sound(reading.sensors)):
        raise ValueError(f"impossible: {reading}")
    return reading
