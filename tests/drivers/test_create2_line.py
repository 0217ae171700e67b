"""A Create 2 on a bad line: what a broken, changed or late command can do at most, and for how long."""

import struct
from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robofleet.drivers.create2_stream import Stream
from robofleet.simulation.firmwares.create2 import Mode
from robofleet.vehicles.interface import STOP, WheelSpeeds
from tests.drivers.line_bench import MM_S, LineBench, create2

SPEEDS = st.floats(-13.7, 13.7)
WHEELS = st.builds(WheelSpeeds, SPEEDS, SPEEDS)
SHARED = settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
SHORT = 0.5 * MM_S  # of rounding


@pytest.fixture
def bench() -> Iterator[LineBench]:
    with create2() as bench:
        bench.open()
        yield bench


def written(bench: LineBench, wheels: WheelSpeeds) -> bytes:
    """Return what the driver writes for this, a tick after the last command; the robot does not hear it."""
    bench.skip(0.033)
    bench.driver.write(wheels)
    return bench.line.read()


def obeyed(bench: LineBench, data: bytes) -> list[WheelSpeeds]:
    """Let the robot hear byte by byte; returns by which speeds it went meanwhile."""
    went = []
    for at in range(len(data)):
        bench.firmware.receive(data[at : at + 1], bench.now_ns)
        went.append(bench.hardware.command)
    return went


@given(before=WHEELS, broken=WHEELS, after=WHEELS)
@SHARED
def test_wherever_a_command_is_cut_it_does_nothing_until_the_next_which_heals_it(
    bench: LineBench, before: WheelSpeeds, broken: WheelSpeeds, after: WheelSpeeds
) -> None:
    whole = written(bench, broken)
    for cut in range(len(whole)):
        obeyed(bench, written(bench, before))
        kept = bench.hardware.command
        assert set(obeyed(bench, whole[:cut])) <= {kept}, "what it was told before, until the next command"
        following = written(bench, after)
        went = obeyed(bench, following)
        assert went[-1] == pytest.approx(tuple(after), abs=SHORT + 1e-9)
        assert bench.firmware.mode is Mode.SAFE
        # Between, for less than a millisecond: the broken one completed with zeros.
        for meanwhile in went[:-1]:
            for side in (0, 1):
                slower, faster = sorted((0.0, broken[side]))
                if slower < 0.0:
                    slower -= 256 * MM_S
                allowed = slower - SHORT <= meanwhile[side] <= faster + SHORT
                assert allowed or meanwhile[side] == kept[side]
        assert len(following) * 10 / 115200 < 1e-3


@pytest.mark.slow
@given(broken=WHEELS, garbage=st.binary(min_size=1, max_size=9), at=st.integers(0, 8))
@SHARED
def test_whatever_changed_bytes_make_it_do_it_soon_does_what_it_is_told(
    bench: LineBench, broken: WheelSpeeds, garbage: bytes, at: int
) -> None:
    wheels = WheelSpeeds(4.0, 6.0)
    whole = written(bench, broken)
    changed = (whole[:at] + garbage + whole[at + len(garbage) :])[: len(whole)]
    if any(opcode in changed for opcode in (7, 133, 173)):  # a reset takes seconds; off, it must be greeted anew
        return
    bench.firmware.receive(changed, bench.now_ns)
    counts = any(opcode in changed for opcode in (140, 148, 149))  # up to 255 bytes that follow are its list
    readings = bench.pass_time(2.0 if counts else 0.3, wheels)
    assert readings[-1].faults == 0
    assert bench.firmware.mode is Mode.SAFE
    assert bench.hardware.command == pytest.approx(tuple(wheels), abs=SHORT + 1e-9)


def test_a_wrong_speed_is_answered_within_a_frame_and_a_loop(bench: LineBench) -> None:
    bench.pass_time(0.2, WheelSpeeds(4.0, 4.0))
    wheels = bench.hardware.command
    bench.firmware.receive(struct.pack(">Bhh", 145, 500, -500), bench.now_ns)
    bench.pass_time(0.03)  # no write: what is read is enough
    assert bench.hardware.command == wheels


def test_an_opcode_that_swallows_what_follows_is_fed_until_it_hears_again(bench: LineBench) -> None:
    bench.pass_time(0.2, WheelSpeeds(4.0, 4.0))
    bench.firmware.receive(bytes((140, 0, 255)), bench.now_ns)  # a song of 255 notes
    bench.pass_time(0.2, STOP)
    assert bench.hardware.command == STOP
    assert bench.firmware.mode is Mode.SAFE


@pytest.mark.parametrize("opcode", [150, 173, 133, 148])
def test_a_stream_that_ends_is_begun_again(bench: LineBench, opcode: int) -> None:
    bench.firmware.receive(bytes((opcode, 0)), bench.now_ns)
    readings = bench.pass_time(0.4, WheelSpeeds(3.0, 3.0))
    assert readings[-1].faults == 0
    assert bench.hardware.command == pytest.approx((3.0, 3.0), abs=SHORT)


@pytest.mark.slow
def test_a_line_that_spoils_every_tenth_frame_never_makes_angles_jump() -> None:
    rng = np.random.default_rng(3)
    with create2() as bench:

        def spoil(data: bytes) -> bytes:
            if not data or rng.random() > 0.1:
                return data
            changed = bytearray(data[: rng.integers(1, len(data) + 1)])
            changed[rng.integers(len(changed))] = rng.integers(256)
            return bytes(changed)

        bench.open()
        bench.to_driver = spoil
        readings = bench.pass_time(20.0, WheelSpeeds(6.0, 3.0))
        true = bench.plant.reading()
        assert not any(reading.faults for reading in readings)
        for side in (0, 1):
            steps = np.diff([reading[side] for reading in readings])
            assert steps.min() >= 0.0
            assert steps.max() < 6.0 * 0.1  # six frames in a row may be lost
            assert readings[-1][side] == pytest.approx(true[side], abs=0.3)


def test_garbage_that_adds_up_is_no_angle(bench: LineBench) -> None:
    bench.pass_time(0.2, WheelSpeeds(4.0, 4.0))
    before = bench.read()
    bench.say(FRAME)  # whole, but 4900 counts from where the wheel is
    assert bench.read() == before
    assert bench.pass_time(0.1, WheelSpeeds(4.0, 4.0))[-1].left_angle == pytest.approx(before.left_angle + 0.4, abs=0.1)


FRAME = bytes.fromhex("13 22 07 00 09 00 0a 00 0b 00 0c 00 0e 00 22 00 23 02")
FRAME += bytes.fromhex("19 0a 00 1a 0a 88 29 00 64 2a ff 9c 2b 13 22 2c 00 13")
FRAME += bytes((-sum(FRAME) % 256,))


def test_a_frame_says_what_is_described() -> None:
    (frame,) = Stream().feed(FRAME)
    assert (frame.mode, frame.charge, frame.capacity) == (2, 2560, 2696)
    assert (frame.right_requested, frame.left_requested) == (100, -100)
    assert (frame.left_counts, frame.right_counts) == (0x1322, 0x13), "as the header looks"


@given(before=st.binary(max_size=80), chunks=st.lists(st.integers(1, 20), max_size=10))
@settings(deadline=None)
def test_after_any_garbage_the_second_frame_is_found_at_the_latest(before: bytes, chunks: list[int]) -> None:
    stream, data = Stream(), before + 3 * FRAME
    found = []
    for size in chunks:
        found += stream.feed(data[:size])
        data = data[size:]
    found += stream.feed(data)
    assert len(found) >= 2
    assert set(found) == set(Stream().feed(FRAME))
