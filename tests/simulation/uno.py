"""An emulated Uno or Mega with its binary, and a host at its line or its driver behind it."""

from dataclasses import replace
from typing import Any

import pytest

from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.drivers.rfp import Rfp
from robofleet.simulation.avr.board import CLOCK_HZ, Board, NoAvrError, image
from robofleet.simulation.firmwares.arduino_uno import ArduinoUnoFirmware
from tests.drivers.line_bench import LineBench
from tests.simulation.rfp_host import RfpHost
from tests.twins import config_of

BAUD = 250000
COUNTS_PER_TURN = 2248.0
UNO_SETTINGS: dict[str, Any] = {"counts_per_turn": COUNTS_PER_TURN, "baud": BAUD, "gains": (400, 160, 488)}
_MS = CLOCK_HZ // 1000


class Uno(RfpHost):
    """One board; ``flags`` are built into its binary."""

    board: Board

    def __init__(self, *flags: str, board: str = "uno", counts_per_turn: float = COUNTS_PER_TURN) -> None:
        """Switch it on, and let it begin; ``counts_per_turn`` is built in."""
        super().__init__(counts_per_turn)
        require_avr()
        self.built = image(board, f"-DRFP_COUNTS_PER_TURN={counts_per_turn}", f"-DRFP_BAUD={BAUD}L", *flags)
        self.board = Board(board, self.built, BAUD)
        self.pass_ms(300)

    def run_board(self, ms: int, left_counts: int, right_counts: int) -> None:
        self.board.run(_MS * ms - self.board.cycle, left_counts, right_counts)


def require_avr() -> None:
    """Skip the test where the tools are missing."""
    try:
        Board("uno", image("uno"), BAUD)
    except NoAvrError as error:
        pytest.skip(str(error))


def uno_configured() -> Config:
    """Return a configuration whose r1 has the binary as its twin."""
    require_avr()
    return config_of(twin="arduino_uno", vehicle="arduino_uno")


def uno_behind_its_driver(period_ns: int) -> LineBench:
    """Return a bench with motors; they take the pins' voltage, and turn the encoders', once in a period."""
    simulation = slices.simulation(uno_configured(), uno_configured().robots[0], None)
    built = simulation.imperfections
    count = built.speed_quantum * built.loop_period
    imperfections = replace(built, loop_period=period_ns / S, speed_quantum=count * S / period_ns)
    return LineBench(Rfp, ArduinoUnoFirmware, simulation.drive, imperfections, period_ns)
