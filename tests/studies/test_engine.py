"""An engine gives every unit back: its result, or in one line why there is none."""

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import closing
from importlib.util import find_spec
from multiprocessing import active_children
from pathlib import Path

import pytest

from robofleet.core.refusal import RefusedError
from robofleet.studies import cluster
from robofleet.studies.engine import WORKER_DIED, Finished
from tests.studies.work import squared


def _all(on: str) -> list[Finished[int]]:
    with cluster.opened(on, 2) as opened, closing(opened.each(squared, range(8))) as results:
        return sorted(results)


def _holds(found: list[Finished[int]]) -> None:
    assert [finished.item for finished in found] == [*range(8)]
    assert [finished.result for finished in found] == [0, 1, 4, None, 16, None, 36, 49]
    assert found[3].failure.startswith("ValueError: three is odd (work.py:")
    assert found[5].failure == WORKER_DIED
    assert not any(finished.failure for finished in found if finished.item not in (3, 5))


def test_a_unit_that_fails_and_one_whose_worker_dies_are_named_and_the_others_are_finished() -> None:
    _holds(_all("local"))


def test_ended_early_an_engine_leaves_no_process() -> None:
    with cluster.opened("local", 2) as opened, closing(opened.each(squared, [1] * 100)) as results:
        next(results)
    assert not active_children()


@pytest.mark.long
def test_ray_gives_the_same_on_loopback_alone_to_whoever_has_its_token() -> None:
    if find_spec("ray") is None:
        pytest.skip("NO RAY")
    done = subprocess.run([sys.executable, "-m", "tests.studies.on_ray"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout.splitlines()[-1])  # Ray prints, too
    _holds([Finished(*fields) for fields in seen["finished"]])
    assert len(seen["listening"]) > 3
    assert {ip.removeprefix("::ffff:") for ip in seen["listening"]} == {"127.0.0.1"}
    assert seen["answers"] == {"its own": "OK", "another": "UNAUTHENTICATED", "none": "UNAUTHENTICATED"}


@pytest.mark.long
def test_a_module_of_the_current_folder_runs_in_no_worker_of_ray(tmp_path: Path) -> None:
    if find_spec("ray") is None:
        pytest.skip("NO RAY")
    (tmp_path / "colorsys.py").write_text("open('imported', 'w').close()\nraise SystemExit\n")
    script = tmp_path / "elsewhere" / "try_it.py"
    script.parent.mkdir()
    script.write_text(
        "from robofleet.studies import cluster\nfrom colorsys import rgb_to_hsv\n"
        "def hue(red):\n    import colorsys\n    return colorsys.rgb_to_hsv(red, 0, 0)[2]\n"
        "with cluster.opened('ray', 1) as opened:\n    print([one.result for one in opened.each(hue, [1.0])])\n"
    )
    command = [sys.executable, "-P", str(script)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert "[1.0]" in done.stdout, (done.stdout, done.stderr)
    assert not (tmp_path / "imported").exists()


@pytest.mark.slow
def test_ray_that_does_not_start_is_said_in_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    pytest.importorskip("ray")
    folder = tmp_path / ("x" * 90)  # a socket's name has 107 bytes at most
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    with pytest.raises(RefusedError, match=r"^--on: ray cannot be used: .*: try --on local$"), cluster.opened("ray", 1):
        pass
    assert not list(folder.iterdir())


@pytest.mark.parametrize(
    ("on", "message"),
    [
        ("slurm", "--on: 'slurm' is no engine: write local, ray, or ray://HOST:PORT"),
        ("ray://here", "--on: ray://here is no address: write ray://HOST:PORT"),
        ("ray://127.0.0.1:1", "--on: ray://127.0.0.1:1 cannot be reached: Connection refused: `ray start --head"),
    ],
)
def test_an_engine_that_is_not_there_is_refused_in_one_line(
    on: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    has_all: Callable[..., None] = lambda *_: None  # noqa: E731
    monkeypatch.setattr("robofleet.studies.cluster.need_extra", has_all)
    with pytest.raises(RefusedError) as refused, cluster.opened(on, None):
        pass
    assert str(refused.value).startswith(message)
    assert "\n" not in str(refused.value)


def test_ray_that_is_not_installed_is_said_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robofleet.core.refusal.find_spec", lambda _: None)
    with pytest.raises(RefusedError, match=r"this needs ray: .*\[ray\]"), cluster.opened("ray", None):
        pass
