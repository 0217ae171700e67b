"""A robot that is lost and comes back: what its process does meanwhile, and when it drives again."""

import threading
from collections.abc import Callable
from typing import Any

import pytest

from robofleet.core.clock import MS, S, WallClock
from robofleet.nodes.unit.reconnecting_driver import ReconnectingDriver
from robofleet.safety.latches import GateStatus, Latch
from robofleet.vehicles.interface import STOP, DriverError, DriverReading, RobotFault, WheelSpeeds
from tests.runs.realrun import wait

FORWARD = WheelSpeeds(3.0, 4.0)
CLOCK = WallClock()


class LostError(Exception):
    pass


class Cable:
    """A robot on a cable that can be pulled; ``events`` is what its drivers were made, told and asked, in order."""

    def __init__(self) -> None:
        self.plugged, self.events = True, list[Any]()
        self.attempts_ns = list[int]()
        self.angles = 0.0, 0.0
        self.closing_s = 0.0

    def __call__(self) -> "Cable":
        self.attempts_ns.append(CLOCK.now_ns())
        if not self.plugged:
            raise DriverError("no port")
        self.events.append("made")
        return self

    def write(self, wheels: WheelSpeeds) -> None:
        self._heard()
        self.events.append(wheels)

    def read(self) -> DriverReading:
        self._heard()
        return DriverReading(*self.angles, 0.0, 0.0, 0.5, 0)

    def close(self) -> None:
        threading.Event().wait(self.closing_s)
        self.events.append("closed")

    def _heard(self) -> None:
        if not self.plugged:
            raise LostError


def back(driver: ReconnectingDriver) -> bool:
    try:
        driver.write(STOP)
    except DriverError:
        return False
    return True


@pytest.fixture
def cable() -> Cable:
    return Cable()


@pytest.fixture
def attached(cable: Cable) -> Any:
    driver = ReconnectingDriver(cable, CLOCK.now_ns)
    yield driver
    driver.close()


@pytest.mark.slow
def test_a_driver_that_fails_is_closed_and_sought_ever_more_patiently(
    cable: Cable, attached: ReconnectingDriver
) -> None:
    cable.plugged = False
    with pytest.raises(LostError):
        attached.read()
    assert wait(lambda: len(cable.attempts_ns) == 4, 3.0)
    assert cable.events == ["made", "closed"]
    pauses = [(b - a) / MS for a, b in zip(cable.attempts_ns[1:], cable.attempts_ns[2:], strict=False)]
    assert [pytest.approx(pause, rel=0.3) for pause in (400, 800)] == pauses
    cable.plugged = True
    assert wait(lambda: back(attached), 3.0)
    assert cable.events == ["made", "closed", "made", STOP]


def test_while_it_is_away_every_call_raises_at_once_and_says_why(cable: Cable) -> None:
    hung, calls = threading.Event(), list[int]()

    def make() -> Any:
        calls.append(1)
        if len(calls) > 1:
            hung.wait(10.0)
        return cable

    attached = ReconnectingDriver(make, CLOCK.now_ns)
    cable.plugged = False
    with pytest.raises(LostError):
        attached.write(FORWARD)
    assert wait(lambda: len(calls) == 2, 10.0)
    before_ns = CLOCK.now_ns()
    for ask in (attached.read, lambda: attached.write(FORWARD), lambda: attached.write(STOP)):
        with pytest.raises(DriverError, match=r"LostError\(\)"):
            ask()
    attached.close()
    assert CLOCK.now_ns() - before_ns < 5 * S, "the one that hangs takes ten"
    hung.set()
    assert wait(lambda: cable.events[-2:] == ["closed", "closed"], 10.0)  # the second one came too late


def test_nothing_that_was_on_its_way_moves_a_robot_that_is_back(cable: Cable, attached: ReconnectingDriver) -> None:
    cable.plugged = False
    with pytest.raises(LostError):
        attached.write(FORWARD)
    cable.plugged = True
    assert wait(lambda: cable.events.count("made") == 2, 10.0)
    with pytest.raises(DriverError):
        attached.write(FORWARD)
    attached.write(STOP)
    attached.write(FORWARD)
    assert cable.events[-2:] == [STOP, FORWARD]


def test_angles_go_on_where_they_were_when_it_was_lost(cable: Cable, attached: ReconnectingDriver) -> None:
    cable.angles = 5.0, -6.0
    attached.read()
    cable.plugged = False
    with pytest.raises(LostError):
        attached.read()
    cable.plugged, cable.angles = True, (0.0, 0.0)
    assert wait(lambda: back(attached), 1.0)
    assert attached.read()[:2] == (5.0, -6.0)
    cable.angles = 0.5, 0.25
    assert attached.read()[:2] == (5.5, -5.75)


def test_what_was_closed_is_told_nothing_more(cable: Cable, attached: ReconnectingDriver) -> None:
    attached.close()
    attached.close()
    with pytest.raises(DriverError):
        attached.write(STOP)
    assert cable.events == ["made", "closed"]


def test_a_driver_that_fails_as_its_process_ends_is_closed_all_the_same(
    cable: Cable, attached: ReconnectingDriver
) -> None:
    cable.plugged, cable.closing_s = False, 0.1
    with pytest.raises(LostError):
        attached.write(STOP)
    attached.close()
    assert cable.events == ["made", "closed"]


def test_a_lost_robot_is_named_in_its_next_status_and_drives_again_after_a_reset(
    stand: Any, fake_driver: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    stand.run(S // 5)
    old = stand.made["r1"]
    fake_driver.unreadable.add("r1")
    fake_driver.absent.add("r1")
    stand.run(30 * MS)
    assert stand.newest("r1").faults == RobotFault.UNREACHABLE
    assert stand.newest("r1").latch == Latch.DRIVER_FAILED
    stderr = capsys.readouterr().err
    assert "r1: its driver failed: OSError('r1 does not answer')" in stderr
    assert wait(lambda: said_after(stand, capsys, "r1 is not there"), 2.0)
    for broken in (fake_driver.unreadable, fake_driver.absent):
        broken.clear()
    assert wait(lambda: said_after(stand, capsys, "its driver has reconnected"), 3.0)
    assert stand.made["r1"] is not old
    stand.run(S // 5)
    assert {wheels for _, wheels in stand.made["r1"].writes} == {STOP}
    assert (stand.newest("r1").gate, stand.newest("r1").faults) == (GateStatus.LATCHED, 0)
    stand.enable("r1", clear=stand.newest("r1").latch_id)
    stand.run(S // 5)
    assert stand.made["r1"].target == FORWARD


def said_after(stand: Any, capsys: pytest.CaptureFixture[str], words: str) -> bool:
    """Let the process go on for a while; returns whether it has said that."""
    stand.run(40 * MS)
    return words in capsys.readouterr().err


def test_a_robot_without_its_first_answer_is_named_with_its_place(
    bench_of: Callable[..., Any], platoon_of: Any, recorded: Any, fake_driver: Any, driver_of: Any
) -> None:
    fake_driver.absent.add("r2")
    with pytest.raises(DriverError, match=r"^robots\.1\.driver: r2 is not there$"):
        driver_of(bench_of(platoon_of(*recorded(0, 1))), "r1", "r2")
    assert fake_driver.instances["r1"].closed == 1
