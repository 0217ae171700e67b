"""`robofleet doctor --ask`: which robot answers at a port. Twins of the firmwares answer; no wheel turns."""

import os
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from robofleet.config.load import load_config
from robofleet.core.clock import WallClock
from robofleet.doctor import asking
from robofleet.doctor.findings import Mark
from robofleet.doctor.needs import Needs
from robofleet.vehicles.interface import DriverContext
from tests.twins import TwinStand, config_of

LAB = Path(__file__).parents[2] / "configs" / "lab.yaml"
KINDS = {"gternal": "gternal", "create2": "create2", "arduino_bridge": "arduino", "rfp": "rfp"}


@pytest.fixture(scope="module")
def twins(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, TwinStand]]:
    with ExitStack() as running:
        stands = {}
        for kind, vehicle in KINDS.items():
            stands[kind] = TwinStand(config_of(twin=kind, vehicle=vehicle), tmp_path_factory.mktemp(kind), WallClock())
            running.enter_context(stands[kind].running())
        yield stands


@pytest.mark.slow
def test_every_kind_is_known_by_its_answer_and_stands(twins: dict[str, TwinStand]) -> None:
    before = [stand.twin.truth()[:3] for stand in twins.values()]
    found = asking.ask(Needs(), [str(stand.port) for stand in twins.values()])
    *texts, rfp = [finding.says for finding in found]
    assert texts == [f"{kind} answers: write `driver: {kind}` for it" for kind in list(twins)[:-1]]
    assert rfp == "rfp answers: write `driver: rfp` and `baud: 57600` for it"
    assert {finding.mark for finding in found} == {Mark.OK}
    assert [stand.twin.truth()[:3] for stand in twins.values()] == before


@pytest.mark.slow
def test_a_configured_robot_is_asked_by_its_own_driver_alone(twins: dict[str, TwinStand]) -> None:
    ports = f"robots.0.settings.port={twins['gternal'].port}", f"robots.2.settings.port={twins['gternal'].port}"
    right, missing, *_ = asking.ask(Needs(load_config(LAB, ports[:1]), ("r1", "r2")), ["all"])
    assert (right.mark, right.says) == (Mark.OK, "gternal answers, which is r1")
    assert missing.mark is Mark.MISSING
    assert missing.says == "there is no such port"
    (wrong,) = asking.ask(Needs(load_config(LAB, ports[1:]), ("r3",)), ["all"])
    assert wrong.mark is Mark.MISSING
    assert "Create 2" in wrong.says


def test_a_port_that_somebody_has_open_is_not_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    robot, host = os.openpty()
    (found,) = asking.ask(Needs(), [os.ttyname(host)])
    assert found.mark is Mark.WARN
    assert found.says.startswith(f"not asked: process {os.getpid()} (")
    os.set_blocking(robot, False)
    with pytest.raises(BlockingIOError):
        os.read(robot, 1)
    os.close(host)
    os.close(robot)


def test_a_driver_that_hangs_costs_its_own_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    ended = threading.Event()

    def hang(_context: DriverContext) -> None:
        ended.wait()
        raise OSError

    hang.Settings = asking.load("robofleet.drivers", "create2").Settings  # type: ignore[attr-defined]
    monkeypatch.setattr(asking, "load", lambda *_: hang)
    (found,) = asking.ask(Needs(load_config(LAB), ("r3",)), ["all"], at_most_s=0.1)
    ended.set()
    assert (found.mark, found.name) == (Mark.MISSING, "answer at /dev/robofleet/r3")
    assert "did not finish opening it" in found.says
