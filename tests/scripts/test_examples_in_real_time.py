"""Three example scripts in real time: each joins an arena whose run is on, one after the other."""

import io
import sys
from collections.abc import Iterator

import numpy as np
import pytest

from tests.runs.realrun import RealRun
from tests.scripts.examples import EXAMPLES, Watched, seen, started

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def arena(alone_for_a_module: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RealRun]:
    run = RealRun(
        tmp_path_factory.mktemp("arena"), "--set", "tracker.source=truth", config=EXAMPLES.parent / "script.yaml"
    )
    try:
        run.wait_until_running()
        yield run
    finally:
        run.clean_up()


@pytest.fixture
def joined(arena: RealRun, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME"):
        monkeypatch.setenv(name, arena.environment[name])
    monkeypatch.setattr(Watched, "longest_s", 4.0)


@pytest.mark.usefixtures("joined")
def test_consensus_in_real_time() -> None:
    _, _, points = seen(started("consensus", "script"))
    spread = np.linalg.norm(points - points.mean(axis=1, keepdims=True), axis=(1, 2))
    assert spread[-1] < 0.7 * spread[0]


@pytest.mark.usefixtures("joined")
def test_coverage_in_real_time() -> None:
    costs = started("voronoi_coverage", "script")["costs"]
    assert costs[-1] < 0.8 * costs[0]


@pytest.mark.usefixtures("joined")
def test_teleoperation_in_real_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("aaaa" + 60 * "."))  # a key a tick
    _, poses, _ = seen(started("teleop", "script"))
    turned = np.unwrap(poses[:, 0, 2])
    assert turned[-1] - turned[0] == pytest.approx(1.2 * 2.0, rel=0.25)
    assert np.abs(poses[-1, 1:] - poses[0, 1:]).max() < 0.005
