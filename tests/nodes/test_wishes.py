"""Whose wishes the controller takes, and how old they are."""

from pathlib import Path

import pytest

from robofleet.behaviours import WishKind
from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import WISH
from robofleet.bus.messages import SCRIPT_WISH, RobotWish, ScriptWish
from robofleet.config.load import load_config
from robofleet.core.clock import SimulatedClock
from robofleet.nodes.setpoints import SetpointInbox
from robofleet.safety.supervisor import Phase

CONFIG = load_config(Path(__file__).parents[2] / "configs" / "script.yaml")
TICK_S = CONFIG.controller.tick_s
CAROL, MALLORY = SENDERS = "script/carol/1f", "script/mallory/2e"


class Taken:
    """What a controller takes, tick by tick, of what two scripts say."""

    def __init__(self) -> None:
        bus = MemoryBus(CONFIG.arena.name, SimulatedClock(), 0)
        self._setpoints = SetpointInbox(CONFIG, bus)
        self._say = {sender: bus.publisher(WISH, "script", sender) for sender in SENDERS}

    def send(
        self, echo: int, epoch: int, seq: int, kind: WishKind = WishKind.BODY, sender: str = CAROL
    ) -> None:  # fmt: skip
        robots = (RobotWish(1, 0.1, 0.0, 0.0),) * 4
        self._say[sender](SCRIPT_WISH.encode(ScriptWish(epoch, seq, kind, 0, echo, robots)))

    def at(
        self, tick: int, epoch: int = 0, seq: int = 1, echo: int | None = None, kind: WishKind = WishKind.BODY,
        *, phase: Phase = Phase.RUNNING, sender: str = CAROL,
    ) -> tuple[int, int] | None:  # fmt: skip
        """Return epoch and number of the wish at a tick, before which a script says something (0: nobody does)."""
        if epoch:
            self.send(tick if echo is None else echo, epoch, seq, kind, sender)
        (wish,) = self._setpoints.at(tick, phase)
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
    assert taken.at(long + 2, 2, seq=11, kind=WishKind.DONE) == (2, 11)
    assert taken.at(long + 3, 1, seq=2) == (1, 2)


def test_a_script_between_its_loops_keeps_its_group() -> None:
    taken = Taken()
    assert taken.at(10, 1, kind=WishKind.STAND) == (1, 1)
    assert taken.at(11, 2) == (1, 1)
    assert taken.at(12, 1, seq=2) == (1, 2)


def test_another_senders_message_with_the_same_epoch_and_a_huge_number_counts_for_nothing() -> None:
    """Every tick tells the epoch; the number is anybody's guess."""
    taken = Taken()
    assert taken.at(10, 1, seq=1, sender=CAROL) == (1, 1)
    assert taken.at(11, 1, seq=1 << 60, sender=MALLORY) == (1, 1)
    assert taken.at(12, 1, seq=2, sender=CAROL) == (1, 2)


@pytest.mark.parametrize("mallorys", [1, 2, 1 << 29], ids=lambda epoch: f"epoch {epoch}")
def test_no_sender_overwrites_the_message_of_another(mallorys: int) -> None:
    taken = Taken()
    for tick in range(10, 60):
        taken.send(tick, 1, seq=tick, sender=CAROL)
        for k in range(100):
            taken.send(tick, mallorys, seq=(1 << 50) + 100 * tick + k, sender=MALLORY)
        assert taken.at(tick) == (1, tick)


def test_a_hold_takes_the_group_from_nobody_who_waits_for_its_end() -> None:
    taken = Taken()
    assert taken.at(10, 1, sender=CAROL) == (1, 1)
    for tick in range(11, 100):
        assert taken.at(tick, 1, seq=tick, kind=WishKind.STAND, phase=Phase.HOLD, sender=CAROL) is None
    assert taken.at(100, 2, sender=MALLORY) is None
    assert taken.at(101, 1, seq=101, sender=CAROL) == (1, 101)


def test_a_hold_gives_the_group_to_the_next_script_where_the_first_is_gone() -> None:
    taken = Taken()
    assert taken.at(10, 1, sender=CAROL) == (1, 1)
    assert taken.at(11, phase=Phase.HOLD) is None
    assert taken.at(100, 2, phase=Phase.HOLD, sender=MALLORY) is None
    assert taken.at(101, 2, seq=2, sender=MALLORY) == (2, 2)


def test_a_group_changes_hands_in_no_tick_in_which_its_driver_speaks() -> None:
    """A replay is given one message of a tick."""
    taken = Taken()
    assert taken.at(10, 1, sender=CAROL) == (1, 1)
    taken.send(11, 1, seq=2, kind=WishKind.DONE, sender=CAROL)
    assert taken.at(11, 2, sender=MALLORY) == (1, 2)
    assert taken.at(12, 2, seq=2, sender=MALLORY) == (2, 2)


def test_what_is_said_while_nobody_may_drive_is_forgotten() -> None:
    taken = Taken()
    assert taken.at(10, 1) == (1, 1)
    assert taken.at(11, phase=Phase.HOLD) is None
    assert taken.at(12) is None
    assert taken.at(12, 2, phase=Phase.HOLD) is None
    assert taken.at(13) is None
    assert taken.at(14, 1, seq=2) == (1, 2)
