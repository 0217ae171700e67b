"""The GTernal's motor controller as its public firmware is: what refreshes its stop, what half a line does to it."""

import json
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robofleet.core.clock import MS, S
from robofleet.simulation.firmware import Hardware
from robofleet.simulation.firmwares.gternal import GTernalFirmware
from robofleet.vehicles.interface import STOP, WheelSpeeds
from robofleet.vehicles.plant import Plant
from tests.robots import GTERNAL, IDEAL

LOOP_NS = 10 * MS
NOTHING = {"status": [], "body": []}


def line(*requests: tuple[str, str, dict[str, Any]]) -> bytes:
    drives, interfaces, bodies = zip(*requests, strict=True)
    return json.dumps({"request": drives, "iface": interfaces, "body": bodies}).encode()


def motion(v: float, w: float) -> bytes:
    return line(("write", "motor", {"v": v, "w": w}))


BATTERY = line(("read", "batt_volt", {}))
LAMP = line(("write", "left_led", {"rgb": [0, 9, 0]}))
AHEAD, BACK = motion(0.08, 0.0), motion(-0.08, 0.0)


class Bench:
    """A motor controller and its clock."""

    def __init__(self) -> None:
        self.hardware = Hardware(GTERNAL, IDEAL, Plant(GTERNAL, IDEAL, (0.0, 0.0, 0.0), np.random.default_rng(1)))
        self.firmware = GTernalFirmware(self.hardware)
        self.now_ns = 0

    def say(self, data: bytes) -> Any:
        """Return what it answers; None: nothing."""
        answer = self.firmware.receive(data, self.now_ns)
        self.firmware.loop(self.now_ns)
        return json.loads(answer) if answer else None

    def stopped_after_ms(self, *, saying: bytes = b"") -> int:
        """Return when its motors go off, when it is told the same again and again."""
        for loops in range(300):
            if self.hardware.command == STOP:
                return loops * 10
            self.now_ns += LOOP_NS
            if saying:
                self.firmware.receive(saying, self.now_ns)
            self.firmware.loop(self.now_ns)
        return 3000


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_v_and_w_become_wheels(bench: Bench) -> None:
    assert bench.say(motion(0.08, 1.0)) == {"status": [1], "body": [{}]}
    assert bench.hardware.command == pytest.approx(((0.08 - 0.0525) / 0.016, (0.08 + 0.0525) / 0.016))


def test_it_answers_each_request_of_a_line_in_its_place(bench: Bench) -> None:
    answer = bench.say(line(("read", "charge_status", {}), ("write", "motor", {"v": 0.1}), ("read", "batt_volt", {})))
    assert answer["status"] == [1, 1, 1]
    assert answer["body"][:2] == [{"charge_status": False}, {}]
    assert answer["body"][2]["batt_volt"] == pytest.approx(4.2, abs=0.005)


def test_what_it_does_not_know_has_no_status(bench: Bench) -> None:
    assert bench.say(line(("read", "encoders", {}))) == {"status": [], "body": [{}]}
    assert bench.say(b'{"body": {}}') == NOTHING
    assert bench.say(b'{"body":' + b"[" * 9999) == NOTHING


def test_it_stops_when_nothing_is_written_for_half_a_second(bench: Bench) -> None:
    bench.say(AHEAD)
    assert 500 <= bench.stopped_after_ms() <= 520


def test_a_read_does_not_keep_it_going_and_a_lamp_does(bench: Bench) -> None:
    bench.say(AHEAD)
    assert 500 <= bench.stopped_after_ms(saying=BATTERY) <= 520
    bench.say(AHEAD)
    assert bench.stopped_after_ms(saying=LAMP) == 3000


@pytest.mark.parametrize(("wait_ns", "half"), [(400 * MS, BACK[:20]), (0, b"\n")])
def test_half_a_line_holds_its_stop_up_until_it_waits_no_more(bench: Bench, wait_ns: int, half: bytes) -> None:
    bench.say(AHEAD)
    bench.now_ns += wait_ns
    bench.say(half)
    assert 1000 <= bench.stopped_after_ms() <= 1020


def test_of_two_lines_at_once_the_second_is_lost(bench: Bench) -> None:
    bench.say(AHEAD + BACK)
    assert bench.hardware.command.left > 0.0


@given(st.integers(1, len(BACK) - 1), st.booleans())
def test_a_line_that_is_cut_moves_nothing_and_costs_the_next_two_at_most(end: int, late: bool) -> None:
    bench = Bench()
    bench.say(AHEAD)
    before = bench.hardware.command
    assert bench.say(BACK[:end]) is None
    assert bench.hardware.command == before
    bench.now_ns += 2 * S if late else 33 * MS
    answer = bench.firmware.loop(bench.now_ns)
    assert (json.loads(answer) == NOTHING) if late else not answer
    turn, turning = motion(0.0, 2.0), pytest.approx((-2.0 * 0.0525 / 0.016, 2.0 * 0.0525 / 0.016))
    for _ in range(2):
        bench.say(turn)
        assert bench.hardware.command in (before, STOP, turning)
    assert bench.say(turn) == {"status": [1], "body": [{}]}
    assert bench.hardware.command == turning


@given(st.lists(st.binary(max_size=40), max_size=20), st.lists(st.integers(0, 2 * S), max_size=20))
def test_whatever_comes_it_stands_half_a_second_after_the_last_and_a_second_more(
    chunks: list[bytes], waits: list[int]
) -> None:
    bench = Bench()
    bench.say(AHEAD)
    for chunk, wait_ns in zip(chunks, waits, strict=False):
        bench.say(chunk)
        bench.now_ns += wait_ns
        bench.firmware.loop(bench.now_ns)
    assert bench.stopped_after_ms() <= 1520
    bench.now_ns += S
    bench.firmware.loop(bench.now_ns)
    assert bench.say(BATTERY)["status"] == [1]


@given(st.data())
def test_a_line_with_other_bytes_in_it_never_breaks_it(data: st.DataObject) -> None:
    bench = Bench()
    whole = bytearray(motion(0.1234, -1.5))
    for at in data.draw(st.sets(st.integers(0, len(whole) - 1), max_size=5)):
        whole[at] = data.draw(st.integers(0, 255))
    bench.say(bytes(whole))
    assert isinstance(bench.hardware.command, WheelSpeeds)
    bench.now_ns += 2 * S
    bench.firmware.loop(bench.now_ns)
    bench.say(AHEAD)
    assert bench.hardware.command == pytest.approx((5.0, 5.0))


def test_quotes_may_be_left_out_as_its_reader_allows(bench: Bench) -> None:
    assert bench.say(b"{request:[write],iface:['motor'],body:[{v:0.08,w:0x}]}")["status"] == [1]
    assert bench.hardware.command == pytest.approx((5.0, 5.0))


def test_its_battery_falls_with_its_charge(bench: Bench) -> None:
    worn = Hardware(GTERNAL, IDEAL, plant := Plant(GTERNAL, IDEAL, (0.0, 0.0, 0.0), np.random.default_rng(1)))
    firmware = GTernalFirmware(worn)
    volts = []
    for _ in range(4):
        volts.append(json.loads(firmware.receive(BATTERY, 0))["body"][0]["batt_volt"])
        plant.step(STOP, 0.3 * IDEAL.battery_life)
    assert all(a - b == pytest.approx(0.27, abs=0.005) for a, b in pairwise(volts))
