"""An engine gives every unit back: its result, or in one line why there is none."""

from collections.abc import Callable
from contextlib import closing
from multiprocessing import active_children

import pytest

from robofleet.processes.refusal import RefusedError
from robofleet.studies import engine
from robofleet.studies.engine import WORKER_DIED, Finished
from tests.studies.work import squared


def _all(on: str) -> list[Finished[int]]:
    with engine.opened(on, 2) as opened, closing(opened.each(squared, range(8))) as results:
        return sorted(results)


def _holds(found: list[Finished[int]]) -> None:
    assert [one.place for one in found] == [*range(8)]
    assert [one.result for one in found] == [0, 1, 4, None, 16, None, 36, 49]
    assert found[3].failure.startswith("ValueError: three is odd (work.py:")
    assert found[5].failure == WORKER_DIED
    assert not any(one.failure for one in found if one.place not in (3, 5))


def test_a_unit_that_fails_and_one_whose_worker_dies_are_named_and_the_others_are_finished() -> None:
    _holds(_all("local"))


def test_ended_early_an_engine_leaves_no_process() -> None:
    with engine.opened("local", 2) as opened, closing(opened.each(squared, [1] * 100)) as results:
        next(results)
    assert not active_children()


@pytest.mark.slow
def test_ray_gives_the_same() -> None:
    pytest.importorskip("ray")
    _holds(_all("ray"))


@pytest.mark.parametrize(
    ("on", "said"),
    [
        ("slurm", "--on: 'slurm' is no engine: write local, ray, or ray://HOST:PORT"),
        ("ray://here", "--on: ray://here is no address: write ray://HOST:PORT"),
        ("ray://127.0.0.1:1", "--on: ray://127.0.0.1:1 cannot be reached: Connection refused: `ray start --head"),
    ],
)
def test_an_engine_that_is_not_there_is_refused_in_one_line(
    on: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    has_all: Callable[..., None] = lambda *_: None  # noqa: E731
    monkeypatch.setattr("robofleet.studies.cluster.need_extra", has_all)
    with pytest.raises(RefusedError) as refused, engine.opened(on, None):
        pass
    assert str(refused.value).startswith(said)
    assert "\n" not in str(refused.value)


def test_ray_that_is_not_installed_is_said_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robofleet.processes.refusal.find_spec", lambda _: None)
    with pytest.raises(RefusedError, match=r"this needs ray: .*\[ray\]"), engine.opened("ray", None):
        pass
