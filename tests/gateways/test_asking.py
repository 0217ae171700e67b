"""What an operator asks through another world's services: it is answered in any case, and the stop waits for nobody."""

from threading import Event

import pytest

from robofleet.bus.bus import Answer, MemoryBus
from robofleet.bus.keys import Topic
from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.core.clock import WallClock
from robofleet.gateways.asking import Asking

CONFIG = load_config(SHIPPED / "ros2.yaml")
WITHIN_S = 30.0


class Hanging(MemoryBus):
    """A bus on which nobody is asked for anything but the emergency stop until somebody lets it go on."""

    def __init__(self) -> None:
        super().__init__(CONFIG.arena.name, WallClock(), 0)
        self.goes_on = Event()

    def ask(self, topic: Topic, name: str, payload: bytes) -> Answer:
        if payload != b"estop":
            self.goes_on.wait()
        return super().ask(topic, name, payload)


class Broken(MemoryBus):
    """A bus that cannot be asked."""

    def ask(self, topic: Topic, name: str, payload: bytes) -> Answer:
        raise OSError("the session is closed")


def test_the_emergency_stop_waits_for_no_other_request() -> None:
    bus = Hanging()
    ask = Asking(bus, WallClock(), CONFIG.units)
    others = [ask(what) for what in ("hold", "resume", "reset")]
    try:
        done, answer = ask("stop").result(WITHIN_S)
        assert not done and "stop them by hand" in answer, "there is no robot"
        assert not any(other.done() for other in others)
    finally:
        for other in others[1:]:
            other.cancel()
        bus.goes_on.set()
        ask.close()


@pytest.mark.parametrize("what", ["hold", "stop"])
def test_who_asks_is_told_what_went_wrong(what: str) -> None:
    clock = WallClock()
    ask = Asking(Broken(CONFIG.arena.name, clock, 0), clock, CONFIG.units)
    assert ask(what).result(WITHIN_S) == (False, "the session is closed")
    ask.close()


class Slow(MemoryBus):
    """A bus on which a resume is under way for as long as a hold may overtake it."""

    def __init__(self) -> None:
        super().__init__(CONFIG.arena.name, WallClock(), 0)
        self.asked_for: list[bytes] = []
        self.held = Event()

    def ask(self, topic: Topic, name: str, payload: bytes) -> Answer:
        if payload == b"resume":
            self.held.wait(0.3)
        else:
            self.held.set()
        self.asked_for.append(payload)
        raise OSError("nobody answers")


def test_a_request_does_not_overtake_the_one_before() -> None:
    bus = Slow()
    ask = Asking(bus, WallClock(), CONFIG.units)
    for answer in [ask("resume"), ask("hold")]:
        answer.result(WITHIN_S)
    ask.close()
    assert bus.asked_for == [b"resume", b"hold"]
