"""Whose wishes the controller takes, and how old they are."""

from pathlib import Path

import pytest

from robofleet.behaviours import WishKind
from robofleet.clock import SimulatedClock
from robofleet.comms.bus import MemoryBus
from robofleet.comms.keys import WISH
from robofleet.comms.messages import SCRIPT_WISH, RobotWish, ScriptWish
from robofleet.config.load import load_config
from robofleet.processes.wishes import Wishes
from robofleet.safety.supervisor import Phase

CONFIG = load_config(Path(__file__).parents[2] / "configs" / "script.yaml")
TICK_S = CONFIG.controller.tick_s


class Taken:
    """What a controller takes, tick by tick, of what two scripts say."""

    def __init__(self) -> None:
        bus = MemoryBus(CONFIG.arena.name, SimulatedClock(), 0)
        self._wishes, self._say = Wishes(CONFIG, bus), bus.publisher(WISH, "script")

    def at(
        self, tick: int, epoch: int = 0, seq: int = 1, echo: int | None = None, kind: WishKind = WishKind.BODY,
        *, phase: Phase = Phase.RUNNING,
    ) -> tuple[int, int] | None:  # fmt: skip
        """Return epoch and number of the wish at a tick, before which a script says something (0: nobody does)."""
        if epoch:
            robots = (RobotWish(1, 0.1, 0.0, 0.0),) * 4
            self._say(SCRIPT_WISH.encode(ScriptWish(epoch, seq, kind, 0, tick if echo is None else echo, robots)))
        (wish,) = self._wishes.at(tick, phase)
        if wish is not None:
            self.age = wish.age
        return None if wish is None else (wish.epoch, wish.seq)


def test_the_age_counts_from_the_tick_by_which_the_script_decided() -> None:
    taken = Taken()
    assert taken.at(10, 1, echo=9) == (1, 1)
    assert taken.age == pytest.approx(TICK_S)
    assert taken.at(13) == (1, 1)
    assert taken.age == pytest.approx(4 * TICK_S)


def test_what_was_overtaken_and_what_knows_a_tick_to_come_is_not_taken() -> None:
    taken = Taken()
    assert taken.at(10, 1, seq=5) == (1, 5)
    assert taken.at(11, 1, seq=4) == (1, 5)
    assert taken.at(11, 1, seq=5, kind=WishKind.STAND) == (1, 5)
    assert taken.at(11, 1, seq=6, echo=12) == (1, 5)
    assert taken.at(11, 1, seq=6, echo=0) == (1, 5)


def test_another_script_waits_until_the_first_one_parts_or_has_long_been_silent() -> None:
    taken = Taken()
    assert taken.at(10, 1) == (1, 1)
    assert taken.at(11, 2) == (1, 1)
    long = 10 + round(0.5 / TICK_S)
    assert taken.at(long, 2, seq=9) == (1, 1)
    assert taken.at(long + 1, 2, seq=10) == (2, 10)
    assert taken.at(long + 2, 2, seq=11, kind=WishKind.STAND) == (2, 11)
    assert taken.at(long + 3, 1, seq=2) == (1, 2)


def test_what_is_said_while_nobody_may_drive_is_forgotten() -> None:
    taken = Taken()
    assert taken.at(10, 1) == (1, 1)
    assert taken.at(11, phase=Phase.HOLD) is None
    assert taken.at(12) is None
    assert taken.at(12, 2, phase=Phase.HOLD) is None
    assert taken.at(13) is None
    assert taken.at(14, 1, seq=2) == (1, 2)
