"""The sketch ros_arduino_bridge, imitated: its reader that knows no errors, its frames, its own stop."""

import math
from dataclasses import replace

import numpy as np
import pytest

from robofleet.core.clock import S
from robofleet.simulation.firmware import Hardware
from robofleet.simulation.firmwares.arduino_bridge import ArduinoBridgeFirmware
from robofleet.vehicles.plant import Plant
from tests.robots import GTERNAL, IDEAL

FRAME_S = 0.033
COUNTS_PER_TURN = 2000
COUNTING = replace(IDEAL, loop_period=FRAME_S, speed_quantum=math.tau / COUNTS_PER_TURN / FRAME_S)


class Board:
    """A board whose wheels turn as they are told, at once."""

    def __init__(self) -> None:
        self.plant = Plant(GTERNAL, COUNTING, (0.0, 0.0, 0.0), np.random.default_rng(1))
        self.hardware = Hardware(GTERNAL, COUNTING, self.plant)
        self.firmware = ArduinoBridgeFirmware(self.hardware)
        self.now_ns = 10 * S

    def say(self, data: bytes) -> bytes:
        return self.firmware.receive(data, self.now_ns)

    def let_pass(self, seconds: float) -> None:
        for _ in range(round(seconds / FRAME_S)):
            self.now_ns += round(FRAME_S * S)
            assert self.firmware.loop(self.now_ns) == b""
            self.plant.step(self.hardware.command, FRAME_S)

    def frame(self) -> tuple[int, int]:
        """Return what the next frame of the speed loop aims at [counts a frame]."""
        self.firmware.loop(self.now_ns)
        left, right = (speed * FRAME_S * COUNTS_PER_TURN / math.tau for speed in self.hardware.command)
        return round(left), round(right)


@pytest.fixture
def board() -> Board:
    return Board()


@pytest.mark.parametrize(
    ("line", "target"),
    [
        (b"m 12 34\r", (12, 34)),
        (b"m -12 +34\r", (-12, 34)),
        (b"m 12, 34\r", (12, 34)),  # what follows a number is passed over
        (b"m 12 3 4\r", (12, 34)),  # a space ends the first argument only
        (b"em 12 34\r", (12, 34)),  # the letter is the last character before the space
        (b"m 12\r", (12, 0)),
        (b"m \n12 x34\r", (12, 0)),  # what is no number is 0, but white space may precede one
        (b"m 0012 65537\r", (12, 1)),  # an int of 16 bits
        (b"m 32768 0\r", (-32768, 0)),
        (b"m 12 34\0567\r", (12, 34)),
        (b"m " + b"0" * 40 + b"12 5\r", (0, 5)),
    ],
)
def test_it_reads_what_it_is_given(board: Board, line: bytes, target: tuple[int, int]) -> None:
    assert board.say(line) == b"OK\r\n"
    assert board.frame() == target


def test_a_line_without_its_end_swallows_the_next_one(board: Board) -> None:
    assert board.say(b"m 12 3") == b""
    assert board.say(b"m 56 78\r") == b"OK\r\n"
    assert board.frame() == (12, 3)
    assert board.say(b"m 56 78\r") == b"OK\r\n"
    assert board.frame() == (56, 78)


def test_each_letter_has_its_answer(board: Board) -> None:
    assert board.say(b"b\re\rr\ru 30:14:2:60\rq\r\r") == b" 57600\r\n0 0\r\nOK\r\nOK\r\n" + b"Invalid Command\r\n" * 2
    assert board.firmware.gains == (30, 14, 2, 60)


def test_a_motion_begins_with_a_frame_and_ends_at_once(board: Board) -> None:
    board.say(b"m 12 34\r")
    assert board.hardware.command == (0.0, 0.0)
    assert board.frame() == (12, 34)
    board.say(b"m 0 0\r")
    assert board.hardware.command == (0.0, 0.0)


def test_wheels_turn_so_many_counts_a_frame(board: Board) -> None:
    board.say(b"m 12 -34\r")
    board.let_pass(30 * FRAME_S)
    left, right = map(int, board.say(b"e\r").split())
    assert (left, right) == pytest.approx((30 * 12, -30 * 34), abs=1)
    board.say(b"r\r")
    assert board.say(b"e\r") == b"0 0\r\n"
    assert board.frame() == (0, 0)


def test_only_motion_commands_keep_it_from_stopping_after_two_seconds(board: Board) -> None:
    board.say(b"m 12 34\r")
    for _ in range(19):
        board.let_pass(0.1)
        board.say(b"e\rb\r")
    assert board.frame() == (12, 34)
    board.let_pass(0.3)
    assert board.frame() == (0, 0)


def test_opening_its_port_resets_it_and_it_is_deaf_while_it_boots(board: Board) -> None:
    board.say(b"u 1:2:3:4\rm 12 34\r")
    board.let_pass(0.5)
    board.firmware.opened(board.now_ns)
    assert board.frame() == (0, 0)
    assert board.say(b"b\rm 12 34\r") == b""
    board.let_pass(2.0)
    assert board.frame() == (0, 0)
    assert board.say(b"e\r") == b"0 0\r\n"
    assert board.firmware.gains == (20, 12, 0, 50)
