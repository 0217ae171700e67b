"""What is compiled once is loaded by later processes, whatever happened to files and models meanwhile."""

import os
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

import pytest

from robofleet.core.kernels import store

MODELS = """
import sys
from pathlib import Path
from robofleet.core.kernels import model, store

store.folder = lambda: Path(sys.argv[1])

def made(pull):
    def inner(x):
        return pull * x
    def outer(x):
        return inner(x) + 1.0
    return model(outer)

for pull in map(float, sys.argv[2:]):
    compiled = made(pull)
    print(compiled(1.0), sum(compiled.stats.cache_hits.values()))
"""
FLOW = """
import numpy as np
from robofleet.control.flow import FlowSettings, NewtonRaphsonFlow, Plant

PULL = 3.0
plant = Plant(lambda x, u: PULL * u, lambda x: x.copy(), 1, 1)
flow = NewtonRaphsonFlow(plant, FlowSettings(20.0, 0.5, 0.01), [2.0])
flow.update(np.zeros(1), np.ones(1))
print(round(float(flow.prediction[0]), 9), sum(flow.compiled_step.stats.cache_hits.values()))
"""
Said = list[tuple[float, bool]]
NOBODY = 65534
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files to somebody else")


def started(source: str, *arguments: object) -> "subprocess.Popen[str]":
    """Start a process; its functions stand in no file."""
    command = [sys.executable, "-c", source, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def said(process: "subprocess.Popen[str]") -> Said:
    """Return what each model gave, and whether it was loaded."""
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    return [(float(line.split()[0]), line.split()[1] == "1") for line in out.splitlines()]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that two processes have filled at the same time, with a common model and one of each one's own."""
    folder = tmp_path_factory.mktemp("kernels")
    both = [started(MODELS, folder, 2.0, 3.0), started(MODELS, folder, 2.0, 4.0)]
    assert [[value for value, _ in said(table)] for table in both] == [[3.0, 4.0], [3.0, 5.0]]
    return folder


@pytest.fixture
def folder(kept: Path, tmp_path: Path) -> Path:
    return shutil.copytree(kept, tmp_path / "kernels")


@pytest.mark.slow
def test_another_process_loads_what_was_compiled_and_never_another_model(folder: Path) -> None:
    """Models of one factory, compiled as the second in their processes: numba gives them one name."""
    assert said(started(MODELS, folder, 4.0, 3.0, 2.0)) == [(5.0, True), (4.0, True), (3.0, True)]


@pytest.mark.slow
def test_where_nothing_can_be_written_nothing_is_kept(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    assert said(started(MODELS, tmp_path / "file" / "kernels", 3.0)) == [(4.0, False)]


class Evil:
    """What runs where it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self._mark = mark

    def __reduce__(self) -> tuple[object, ...]:
        return Path.touch, (self._mark,)


def of_nobody(path: Path) -> None:
    os.chown(path, NOBODY, NOBODY)


def a_link(path: Path) -> None:
    path.symlink_to(path.rename(path.parent.parent / f"elsewhere {path.name}"))


def a_second_name(file: Path) -> None:
    (file.parent.parent / file.name).hardlink_to(file)


def flipped(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


def cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[:-10])


@pytest.fixture
def evil(folder: Path) -> Path:
    """Return where a mark is left when one of the folder's files is unpickled: all of them are changed."""
    mark = folder.parent / "ran"
    for file in folder.iterdir():
        data = pickle.dumps(Evil(mark))
        file.write_bytes(store._digest(data) + data)
    return mark


@pytest.mark.slow
def test_a_file_of_ones_own_is_unpickled(folder: Path, evil: Path) -> None:
    said(started(MODELS, folder, 2.0))
    assert evil.exists(), "else the next tests prove nothing"


@pytest.mark.slow
@pytest.mark.parametrize("spoil", [pytest.param(of_nobody, marks=as_root), lambda path: path.chmod(0o770), a_link])
def test_a_folder_that_is_not_the_users_alone_is_not_used_and_that_is_said_once(
    folder: Path, evil: Path, spoil: Callable[[Path], None]
) -> None:
    spoil(folder)
    before = sorted((file.name, file.read_bytes()) for file in folder.iterdir())
    process = started(MODELS, folder, 2.0, 3.0)
    out, err = process.communicate(timeout=300)
    assert out.split() == ["3.0", "0", "4.0", "0"]
    assert len(err.splitlines()) == 1, err
    assert err.startswith("compiled kernels are not kept, and every start compiles: ")
    assert str(folder) in err
    assert not evil.exists()
    assert sorted((file.name, file.read_bytes()) for file in folder.iterdir()) == before


NOT_ONES_OWN = of_nobody if os.geteuid() == 0 else lambda file: file.chmod(0o666), a_link, a_second_name


@pytest.mark.slow
@pytest.mark.parametrize("spoils", [NOT_ONES_OWN, (cut, lambda file: file.write_bytes(b""), flipped)])
def test_a_file_that_may_be_anothers_or_is_damaged_is_compiled_anew(
    folder: Path, evil: Path, spoils: Sequence[Callable[[Path], object]]
) -> None:
    for file, spoil in zip(sorted(folder.iterdir()), spoils, strict=True):
        spoil(file)
    assert said(started(MODELS, folder, 2.0, 3.0, 4.0)) == [(3.0, False), (4.0, False), (5.0, False)]
    assert not evil.exists()
    assert said(started(MODELS, folder, 2.0, 3.0, 4.0)) == [(3.0, True), (4.0, True), (5.0, True)]


class Waits:
    """A clock by which whoever waits does ``at_last`` at the third time."""

    def __init__(self, at_last: Callable[[], None]) -> None:
        self.count, self._at_last = 0, at_last

    def now_ns(self) -> int:
        return 0

    def sleep_until(self, instant_ns: int, *, precise: bool = False) -> None:
        self.count += 1
        if self.count == 3:
            self._at_last()


def test_as_many_compile_at_a_time_as_there_are_cores(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "folder", lambda: tmp_path / "kernels")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _process: {0, 5})
    nobody = Waits(lambda: pytest.fail("there are two cores"))
    with ExitStack() as first, store.turn(nobody):
        first.enter_context(store.turn(nobody))
        third = Waits(first.close)
        with store.turn(third):
            assert third.count == 3


def test_where_no_turn_can_be_kept_nobody_waits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _process: {0})
    monkeypatch.setattr(store, "folder", lambda: tmp_path / "file" / "kernels")
    (tmp_path / "file").touch()
    nobody = Waits(lambda: pytest.fail("nothing can be kept here"))
    with store.turn(nobody), store.turn(nobody):
        assert nobody.count == 0


@pytest.mark.slow
def test_a_folder_is_made_and_kept_closed(folder: Path) -> None:
    assert folder.stat().st_mode & 0o7777 == 0o700
    folder.chmod(0o755)  # as an older version made it
    assert said(started(MODELS, folder, 2.0)) == [(3.0, True)]
    assert folder.stat().st_mode & 0o7777 == 0o700


def test_they_are_kept_in_the_users_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    assert store.folder() == tmp_path / "cache" / "robofleet" / "kernels"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert store.folder() == tmp_path / ".cache" / "robofleet" / "kernels"


SHIPPED = "import sys; from pathlib import Path; from robofleet.core.kernels import store; "
FOR_COMMON = {"NUMBA_CPU_NAME": store.SHIPPED_CPU, "NUMBA_CPU_FEATURES": ""}


@pytest.mark.slow
@pytest.mark.skipif(not store.runs_shipped(), reason="this processor runs no kernels of a wheel")
def test_what_the_package_brings_is_loaded_unless_others_can_write_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package, own = tmp_path / "package", tmp_path / "kernels"
    with monkeypatch.context() as build:
        for name, value in FOR_COMMON.items():
            build.setenv(name, value)
        said(started(MODELS, package, 2.0, 3.0))
    package.chmod(0o755)
    source = f"{SHIPPED}store.SHIPPED = Path({str(package)!r})\n{MODELS}"
    assert said(started(source, own, 2.0, 3.0)) == [(3.0, True), (4.0, True)]
    assert not own.exists(), "what the package brings is not written again"
    sorted(package.iterdir())[0].chmod(0o666)
    assert sorted(hit for _, hit in said(started(source, own, 2.0, 3.0))) == [False, True]
    shutil.rmtree(own)
    package.chmod(0o777)
    assert said(started(source, own, 2.0, 3.0)) == [(3.0, False), (4.0, False)]


def test_what_nobody_has_read_for_longest_makes_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "_LARGEST", 250)
    for age, name in enumerate("abc"):
        (tmp_path / name).write_bytes(bytes(100))
        os.utime(tmp_path / name, (1e9 + age, 1e9 + age))
    store._make_room(tmp_path)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["b", "c"]


@pytest.mark.long
def test_a_second_process_loads_a_users_flow() -> None:
    ((predicted, _),) = said(started(FLOW))
    assert predicted == 3.0
    assert said(started(FLOW)) == [(3.0, True)]


@pytest.mark.slow
def test_importing_changes_nothing() -> None:
    source = "import numba; before = numba.config.CACHE_DIR; import robofleet.control.flow, sys; "
    subprocess.run([sys.executable, "-c", f"{source}sys.exit(numba.config.CACHE_DIR != before)"], check=True)
