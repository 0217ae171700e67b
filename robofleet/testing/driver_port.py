"""The contract's checks of settings and ports: what cannot be is refused in words, and nothing moves."""

import math
import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

import pytest
from pydantic import ValidationError

from robofleet.core.plugins import load
from robofleet.drivers.serial_port import SerialPort
from robofleet.nodes.unit import driver_settings
from robofleet.simulation.firmware import Hardware
from robofleet.testing.driver_bench import DriverBench
from robofleet.testing.driver_motion import Checks, cruise, on_the_line, travel
from robofleet.vehicles.interface import STOP, DriverError, is_concurrent

# Other devices that may be at the port, and the kind of robot that each is given out for.
OTHERS = {
    "gternal": "gternal",
    "arduino_bridge": "arduino",
    "create2": "create2",
    "robofleet.testing.driver_port:Mute": "gternal",
    "robofleet.testing.driver_port:Echo": "gternal",
    "robofleet.testing.driver_port:Chatter": "gternal",
}


class Mute:
    """Nothing that answers."""

    baud = 115200
    watchdog_s: float | None = 1.0

    def __init__(self, hardware: Hardware) -> None:
        """Move nothing."""

    def opened(self, now_ns: int) -> None:
        """Do nothing."""

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Answer nothing."""
        return b""

    def loop(self, now_ns: int) -> bytes:
        """Send nothing."""
        return b""


class Echo(Mute):
    """A modem, or a plug whose two pins touch."""

    def receive(self, data: bytes, now_ns: int) -> bytes:
        """Return what came."""
        return data


class Chatter(Mute):
    """Noise, as a wrong baud rate gives."""

    def loop(self, now_ns: int) -> bytes:
        """Send noise."""
        return zlib.crc32(str(now_ns).encode()).to_bytes(4, "little") * 3


class Interrupted(DriverBench):
    """A bench on which ``meanwhile`` is called the first time that a driver waits."""

    meanwhile: Callable[[], None] | None = None

    def _pass_while_waiting(self, deadline_ns: int) -> None:
        meanwhile, self.meanwhile = self.meanwhile, None
        if meanwhile is not None:
            meanwhile()
        super()._pass_while_waiting(deadline_ns)


class Port(Checks):
    """Checks of the port."""

    def test_a_setting_that_there_is_not_is_refused_in_words(self) -> None:
        with DriverBench(replace(self.subject, settings={**self.subject.settings, "prot": "/dev/ttyUSB0"})) as bench:
            paths, words = zip(*driver_settings.complaints(bench.config, 0), strict=True)
        assert any(path.startswith("robots.0.settings") for path in paths)
        assert all(words)

    def test_a_port_that_is_not_given_is_refused_in_words(self) -> None:
        on_the_line(self.subject)
        with DriverBench(replace(self.subject, twin=None)) as bench:
            found = dict(driver_settings.complaints(bench.config, 0))
        assert found["robots.0.settings.port"]

    def test_a_setting_that_cannot_be_is_refused(self) -> None:
        """No number may be infinite or none, and no port may be one."""
        on_the_line(self.subject)
        settings = load("robofleet.drivers", self.subject.driver).Settings
        sound = {**self.subject.settings, "port": "/dev/ttyUSB0"}
        assert settings.model_validate(sound).port == "/dev/ttyUSB0"
        for name in settings.model_fields:
            for value in (math.nan, math.inf):
                with pytest.raises(ValidationError):
                    settings.model_validate({**sound, name: value})

    def test_a_port_that_is_absent_is_named(self) -> None:
        on_the_line(self.subject)
        with DriverBench(self.subject) as bench:
            assert bench.twin is not None
            bench.twin.close()
            with pytest.raises(DriverError, match=bench.port.name):
                bench.make()

    def test_a_port_that_somebody_has_is_named_and_left_alone(self) -> None:
        on_the_line(self.subject)
        with DriverBench(self.subject) as bench:
            holder = SerialPort(str(bench.port), 115200)
            try:
                bench.let_pass(0.1)
                with pytest.raises(DriverError, match=bench.port.name):
                    bench.make()
                assert bench.unheard() == 0
            finally:
                holder.close()

    def test_those_that_say_so_may_be_constructed_at_once(self) -> None:
        """While one waits for its robot, another one is constructed, on a port that is not there."""
        on_the_line(self.subject)
        kind = load("robofleet.drivers", self.subject.driver)
        if not is_concurrent(kind):
            pytest.skip("they are constructed one after the other")
        with Interrupted(self.subject) as bench:
            absent = bench.port.with_name("absent")
            settings = driver_settings.of(bench.config, bench.config.robots[0]).model_copy(update={"port": str(absent)})
            other = replace(bench.context(), settings=settings)

            def construct_another() -> None:
                with pytest.raises(DriverError, match="absent"):
                    kind(other)

            bench.meanwhile = construct_another
            bench.make()
            moments = bench.drive(cruise(self.subject, 1.0, 1.0), 1.0)
        assert moments[-1].speeds != STOP

    @pytest.mark.parametrize("other", OTHERS)
    def test_who_speaks_another_language_is_no_robot_of_ours_and_does_not_move(self, other: str) -> None:
        on_the_line(self.subject)
        if other == self.subject.twin:
            pytest.skip("it is its own language")
        with DriverBench(replace(self.subject, twin=other, vehicle=OTHERS[other], sensors=False)) as bench:
            with pytest.raises(DriverError, match=bench.port.name):
                bench.make()
            bench.let_pass(1.0)
            assert bench.fastest == 0.0

    def test_closing_again_is_fine_and_so_is_closing_without_a_line(self) -> None:
        with DriverBench(self.subject) as bench:
            driver = bench.make()
            bench.drive(cruise(self.subject, 1.0, 1.0), 0.2)
            driver.close()
            driver.close()
            bench.let_pass(0.1)
            if bench.twin is not None:
                again = bench.make()
                bench.twin.close()
                again.close()
                again.close()

    def test_one_that_was_closed_can_be_made_again_on_its_port(self) -> None:
        with DriverBench(self.subject) as bench:
            for _ in range(3):
                bench.make()
                assert travel(bench.drive(cruise(self.subject, 1.0, 1.0), 0.5)) > 0.0
                with suppress(DriverError, OSError):
                    bench.give_up()
                bench.let_pass(0.5)
