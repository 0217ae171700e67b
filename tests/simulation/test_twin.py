"""A firmware's twin: a port that is opened as any other, a body that moves by what was written to it."""

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from robofleet.core.clock import MS, S, SimulatedClock, WallClock
from robofleet.drivers.serial_port import SerialPort
from robofleet.vehicles.interface import DriverError
from tests.twins import TwinStand, config_of

FAKE = "tests.simulation.fake_firmware:FakeFirmware"
BAUD = 57600


class Bench(TwinStand):
    """A twin on a clock that the test moves, and the host's end of its line."""

    clock: SimulatedClock

    def __init__(self, folder: Path, *changes: str, faults: str = "") -> None:
        super().__init__(config_of(*changes, twin=FAKE, faults=faults), folder, SimulatedClock())
        self.host = SerialPort(str(self.port), BAUD)
        self.step()

    def pass_time(self, seconds: float) -> None:
        end_ns = self.clock.now_ns() + round(seconds * S)
        while self.clock.now_ns() < end_ns:
            self.clock.advance_to(min(end_ns, self.clock.now_ns() + 5 * MS))
            self.step()

    def say(self, line: bytes) -> None:
        self.host.write(line)
        self.hear()

    def answer(self) -> bytes:
        """Return what has been answered: a pseudo-terminal takes a moment in real time."""
        answer = b""
        while self.host.wait(0.05 if answer else 1.0):
            answer += self.host.read()
        return answer


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.host.close()
    bench.twin.close()


def test_it_stands_where_it_starts_until_it_is_told(bench: Bench) -> None:
    bench.pass_time(1.0)
    start = bench.config.robots[0].start
    assert bench.twin.truth() == (start.x_m, start.y_m, start.psi, 0.0, 0.0)


@pytest.mark.parametrize("plant", ["own", "mujoco"])
def test_what_is_written_moves_it_and_its_encoders_count_it(tmp_path: Path, plant: str) -> None:
    if plant == "mujoco":
        pytest.importorskip("mujoco")
    bench = Bench(tmp_path, f"plant.model={plant}")
    for _ in range(10):
        bench.say(b"500,500\n")
        bench.pass_time(0.2)
        counts = bench.answer()
    start, end = bench.config.robots[0].start, bench.twin.truth()
    assert math.hypot(end.x - start.x_m, end.y - start.y_m) == pytest.approx(5.0 * 0.016 * 1.92, rel=0.05)
    left, right = map(int, counts.split(b","))
    assert left * 0.002244 == pytest.approx(5.0 * 1.72, rel=0.05)
    assert right == pytest.approx(left, rel=0.05)
    bench.host.close()
    bench.twin.close()


def test_bytes_take_their_time_on_the_line(bench: Bench) -> None:
    line = b"0" * 55 + b"50,50\n"  # 61 bytes of 10 bits: 10.6 ms
    bench.say(line)
    bench.pass_time(0.010)
    assert not bench.host.wait(0.05)
    bench.pass_time(0.005)
    assert bench.answer()


def test_its_own_watchdog_stops_it(bench: Bench) -> None:
    bench.say(b"500,500\n")
    bench.pass_time(0.45)
    assert bench.twin.truth().v > 0.07
    bench.pass_time(1.0)
    assert bench.twin.truth().v == 0.0


def test_a_port_that_is_opened_again_starts_the_firmware_anew(bench: Bench) -> None:
    bench.say(b"500,500\n")
    bench.pass_time(0.3)
    bench.host.close()
    bench.pass_time(0.01)
    bench.host = SerialPort(str(bench.port), BAUD)
    bench.pass_time(0.4)  # of which its watchdog alone would have let it go on for half
    assert bench.twin.truth().v < 1e-3


def test_a_twin_that_is_closed_takes_its_port_away(bench: Bench) -> None:
    bench.twin.close()
    bench.twin.close()
    assert not bench.port.is_symlink()
    assert bench.host.wait(1.0)
    with pytest.raises(DriverError, match="gone"):
        bench.host.read()


def test_in_real_time_a_thread_steps_it(tmp_path: Path) -> None:
    stand = TwinStand(config_of(twin=FAKE), tmp_path, WallClock())
    with stand.running():
        host = SerialPort(str(stand.port), BAUD)
        host.write(b"0,0\n")
        assert host.wait(1.0)
        assert host.read() == b"0,0\n"
        host.close()
    stand.twin.close()
