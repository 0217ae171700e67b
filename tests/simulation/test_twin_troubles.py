"""What goes wrong with a twin: lines that come spoilt or late, a line that is pulled out, a firmware that hangs."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from robofleet.core.clock import MS
from robofleet.drivers.serial_port import SerialPort
from robofleet.vehicles.interface import DriverError, RobotFault
from tests.simulation.test_twin import BAUD, Bench

Made = Callable[[str], Bench]


@pytest.fixture
def made(tmp_path: Path) -> Iterator[Made]:
    benches = []

    def make(faults: str) -> Bench:
        benches.append(Bench(tmp_path, faults=faults))
        return benches[-1]

    yield make
    for bench in benches:
        bench.host.close()
        bench.twin.close()


def begin(bench: Bench) -> None:
    bench.faults.begin(bench.clock.now_ns())


def test_a_cut_line_has_lost_its_end(made: Made) -> None:
    bench = made("{kind: line_cut, share: 1.0}")
    for _ in range(20):
        bench.say(b"500,500\n")
    bench.pass_time(0.1)
    assert not bench.host.wait(0.05)  # no line's end has come, or gone
    assert bench.twin.truth().v == 0.0


def test_garbage_is_as_long_as_the_line_was(made: Made) -> None:
    bench = made("{kind: line_garbage, share: 1.0, robot: r1}")
    healthy = made("")
    for line in (b"500,500\n", b"0,0\n"):
        bench.say(line)
        healthy.say(line)
        bench.pass_time(0.05)
        healthy.pass_time(0.05)
    answer = bench.answer()
    assert answer != healthy.answer()
    assert bench.faults.injections[0].effects > 0


@pytest.mark.parametrize("kind", ["line_cut", "line_garbage", "line_late"])
def test_a_share_of_the_lines_is_struck_and_the_others_come_as_they_were_sent(made: Made, kind: str) -> None:
    bench = made(f"{{kind: {kind}, share: 0.2}}")
    for _ in range(100):
        bench.say(b"0,0\n")
        bench.pass_time(0.005)
    both_ways = 200
    assert 0.1 * both_ways < bench.faults.injections[0].effects < 0.3 * both_ways
    bench.pass_time(0.1)
    assert bench.answer().count(b"0,0\n") > 40


def test_late_lines_keep_their_order(made: Made) -> None:
    bench = made("{kind: line_late, share: 0.5, delay_s: 0.04}")
    lines = [b"%d,0\n" % (100 + k) for k in range(40)]
    for line in lines:
        bench.say(line)
        bench.pass_time(0.01)
    bench.pass_time(0.2)
    counts = [int(line.split(b",")[0]) for line in bench.answer().splitlines()]
    assert len(counts) == len(lines)  # none is lost
    assert counts == sorted(counts)


def test_a_pulled_plug_is_the_end_of_the_line_and_comes_back(made: Made) -> None:
    bench = made("{kind: unplugged, robot: r1, at_s: 0, duration_s: 1.0}")
    bench.say(b"500,500\n")
    bench.pass_time(0.3)
    assert bench.twin.truth().v > 0.05
    begin(bench)
    bench.step()
    assert not bench.port.exists()
    assert bench.host.wait(1.0)
    with pytest.raises(DriverError, match="gone"):
        bench.host.read()
    bench.pass_time(0.9)
    assert bench.twin.truth().v < 1e-3  # by its own watchdog
    bench.host.close()
    bench.pass_time(0.2)
    bench.host = SerialPort(str(bench.port), BAUD)
    bench.pass_time(0.02)
    bench.say(b"0,0\n")
    bench.pass_time(0.01)
    assert bench.answer().count(b",") == 1


def test_a_firmware_that_hangs_lets_its_motors_go_on_and_answers_nobody(made: Made) -> None:
    bench = made("{kind: firmware_hangs, robot: r1, at_s: 0, duration_s: 2.0}")
    bench.say(b"500,500\n")
    bench.pass_time(0.3)
    bench.answer()
    begin(bench)
    for _ in range(40):
        bench.say(b"100,100\n")
    bench.pass_time(1.9)
    assert bench.twin.truth().v > 0.07  # four times as long as its watchdog is patient
    assert not bench.host.wait(0.05)
    bench.pass_time(0.2)
    assert bench.answer().count(b"\n") == 8  # to what had waited: the first 64 bytes
    assert bench.twin.truth().v < 0.05
    bench.pass_time(1.0)
    assert bench.twin.truth().v == 0.0


@pytest.mark.parametrize(
    ("kind", "felt"),
    [("bumper_hit", RobotFault.BUMPED), ("cliff", RobotFault.CLIFF), ("wheel_lifted", RobotFault.WHEEL_DROPPED)],
)
def test_what_touches_the_robot_its_firmware_feels(made: Made, kind: str, felt: RobotFault) -> None:
    bench = made(f"{{kind: {kind}, robot: r1, at_s: 0, duration_s: 0.5}}")
    feels = []
    for _ in range(3):
        bench.say(b"0,0\n")
        bench.pass_time(0.4)
        bench.say(b"feel,\n")
        bench.pass_time(0.01)
        feels.append(RobotFault(int(bench.answer().splitlines()[-1].removeprefix(b"?"))))
        begin(bench)
    assert feels == [0, felt, 0]


def test_a_motor_that_is_stuck_stands(made: Made) -> None:
    bench = made("{kind: motor_stuck, robot: r1}")
    bench.say(b"500,500\n")
    bench.pass_time(0.3)
    assert bench.twin.truth().v == 0.0


def test_a_motion_that_nobody_asked_for_is_counted(made: Made) -> None:
    """Cut after the comma's digits a line still ends where the next one does: 5,5 and 00 become 5,500 or 500,5."""
    bench = made("{kind: line_cut, share: 0.3}")
    for _ in range(300):
        bench.say(b"500,500\n")
        bench.pass_time(0.02)
    assert bench.twin.ledger.wrong > 0
    assert bench.twin.ledger.furthest > 0.04
    assert bench.twin.ledger.longest_ns >= 10 * MS


def test_what_comes_late_is_no_wrong_motion_and_neither_is_a_stop(made: Made) -> None:
    bench = made("{kind: line_late, share: 0.3, delay_s: 0.05}")
    for k in range(200):
        bench.say(b"%d,%d\n" % (300 + k, 500 - k))
        bench.pass_time(0.02)
    bench.pass_time(2.0)
    assert bench.twin.truth().v == 0.0
    assert bench.twin.ledger.wrong == 0
