"""How far a start is: it never goes back, says when what is left, and follows the machine on which it is."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from robofleet.core.clock import S
from robofleet.core.compiling import Progress
from robofleet.core.starting import Start, Starting

NAMES = ("supervisor", "tracker", "controller", "driver-r1")
LOADING_S, CHECKS_S = 1.0, 3.0
COMPILING_S = {"supervisor": 2.0, "tracker": 16.0, "controller": 12.0, "driver-r1": 4.0}


class Machine:
    """Two cores that do the work of a start at a pace, and the clock beside it."""

    def __init__(self, pace: float, *, compiles: bool) -> None:
        self.pace, self.now_s = pace, 0.0
        self.start = Start(NAMES, loading_s=LOADING_S, checks_s=CHECKS_S, cores=2, now_ns=lambda: round(self.now_s * S))
        self._work_s = COMPILING_S if compiles else dict.fromkeys(NAMES, 0.0)

    def looks(self) -> Iterator[tuple[float, Starting]]:
        """Yield when what is seen, ten times a second, to the end."""
        left_s = {name: LOADING_S + work_s for name, work_s in self._work_s.items()}
        while any(left_s.values()):
            busy = [name for name in NAMES if left_s[name] > 0.0]
            for name in busy:
                left_s[name] = max(0.0, left_s[name] - 0.1 / self.pace * min(1.0, 2 / len(busy)))
                work_s = self._work_s[name]
                if left_s[name] == 0.0:
                    self.start.ready(name)
                elif left_s[name] < work_s:  # a kernel a half second of work
                    done_s = (work_s - left_s[name]) // 0.5 * 0.5
                    self.start.compiles(name, Progress(round(2 * done_s), round(2 * work_s), done_s, work_s))
            self.now_s += 0.1
            yield self.now_s, self.start.look()
        self.start.checks("trying the wheels")
        for _ in range(round(CHECKS_S * 10)):
            self.now_s += 0.1
            yield self.now_s, self.start.look()


@pytest.fixture(params=[0, 100], ids=["nothing on disk", "all on disk"])
def files(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    folder = tmp_path / "robofleet" / "kernels"
    folder.mkdir(parents=True)
    for k in range(request.param):
        (folder / f"kernel-{k}-0").touch()
    return int(request.param)


@pytest.mark.parametrize("pace", [0.7, 1.0, 2.0])
def test_what_is_left_is_known_after_a_fifth_of_the_start_and_the_bar_never_goes_back(files: int, pace: float) -> None:
    looks = [*Machine(pace, compiles=not files).looks()]
    end_s = looks[-1][0]
    shares = [starting.share for _, starting in looks]
    assert shares == sorted(shares)
    assert 0.85 < shares[-1] < 1.0
    for at_s, starting in looks:
        known = starting.doing != "processes, 0 of 4 ready"  # before that nobody knows this machine's pace
        if known and at_s > end_s / 5 and end_s - at_s > 2.0:
            assert 1 / 1.5 < starting.left_s / (end_s - at_s) < 1.5, (at_s, end_s, starting)


def test_it_says_what_it_does(files: int) -> None:
    seen = list(dict.fromkeys(starting.doing for _, starting in Machine(1.0, compiles=True).looks()))
    assert seen[0] == "processes, 0 of 4 ready"
    assert {"compiling kernels, 34 of 68", "compiling kernels, 67 of 68"} < {*seen}
    assert seen[-1] == "trying the wheels"


def test_it_crosses_to_the_page_and_other_lines_are_none() -> None:
    starting = Starting(0.32, 23.6, "compiling kernels, 31 of 61")
    assert Starting.decode(starting.encode()) == starting
    assert starting.words() == "32 %, about 24 s left: compiling kernels, 31 of 61"
    assert Starting.decode("started") is Starting.decode("") is None
