"""A gateway ends with the run that it serves, also where the arena's next run takes the same place on the bus."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from robofleet.bus.arena_file import claimed
from robofleet.bus.bus import Arrival
from robofleet.bus.keys import STATE, key
from robofleet.bus.messages import RUN_STATE, RunState
from robofleet.bus.permissions import OPERATOR
from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.core.clock import S
from robofleet.gateways.place import ArenaAccess, Served, is_over
from robofleet.gateways.viewers.live import Viewers
from robofleet.safety.supervisor import NOBODY, Phase
from tests.endpoints import short_folder

CONFIG = load_config(SHIPPED / "ros2.yaml", ["bus.endpoint=unixsock-stream//run/lab/bus.sock"])
STATES = key(CONFIG.arena.name, STATE)


def state(epoch: int) -> bytes:
    return RUN_STATE.encode(RunState(epoch, 1, Phase.RUNNING, 0, NOBODY, 0.0, 0, ()))


def test_a_run_is_over_when_another_supervisor_is_heard() -> None:
    served = Served(lambda: False, 0)
    assert not served.is_over(S)
    for at_s in range(1, 9):
        served.take(1, at_s * S)
        assert not served.is_over(at_s * S)
    served.take(2, 9 * S)
    assert served.is_over(9 * S)


@pytest.mark.parametrize("ended", [False, True])
def test_a_run_that_is_silent_is_over_if_it_has_ended(ended: bool) -> None:
    served = Served(lambda: ended, 0)
    served.take(1, S)
    assert not served.is_over(3 * S) and served.is_over(5 * S) == ended


def test_the_next_run_of_an_arena_is_another_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    folder = short_folder()
    for name, variable in (("tmp", "TMPDIR"), ("run", "XDG_RUNTIME_DIR")):
        (folder / name).mkdir()
        (folder / name).chmod(0o1777 if name == "tmp" else 0o700)
        monkeypatch.setenv(variable, str(folder / name))
    places = [ArenaAccess(CONFIG.bus.endpoint, None, OPERATOR, tmp_path / name) for name in ("this", "next")]
    with claimed(CONFIG, tmp_path / "this"):
        assert [is_over(CONFIG, run_place) for run_place in places] == [False, True]
    with claimed(CONFIG, tmp_path / "next"):
        assert [is_over(CONFIG, run_place) for run_place in places] == [True, False]


def test_viewers_see_nothing_of_the_next_run() -> None:
    states: list[bytes] = []

    def tell(topic: str, _log_ns: int, message: bytes) -> None:
        states.extend([message] if topic == STATES else [])

    server: Any = SimpleNamespace(address="", tell=tell, step=lambda _: None, close=lambda: None)
    arrivals = [Arrival(at * S, STATES, state(epoch)) for at, epoch in enumerate([1, 1, 2, 2], 1)]
    stream: Any = SimpleNamespace(drain=lambda: arrivals)
    served = Served(lambda: False, 0)
    Viewers(CONFIG, stream, served, lambda _: server, 0).step(4 * S)
    assert states == [state(1)] * 2 and served.is_over(4 * S)
