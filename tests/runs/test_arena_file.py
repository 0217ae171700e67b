"""Where a run leaves its file, who finds it, and what strangers can do about that."""

import fcntl
import json
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from struct import Struct

import pytest

from robofleet.bus.arena_file import ArenaBusyError, ArenaFile, Search, claimed, found, running
from robofleet.bus.endpoint import settled
from robofleet.bus.private_folder import PlaceError
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.operator import requests as operator
from robofleet.scripts.fleet import Fleet, FleetError
from tests.command import robofleet
from tests.endpoints import short_folder
from tests.shipped import PLATOON

SWIRL = PLATOON.with_name("swirl.yaml")
ENDPOINT = "bus.endpoint=unixsock-stream//run/lab/bus.sock"
FLOCK = Struct("hhqqi4x")  # kind, whence, start, length, process
ME, NOBODY = os.geteuid(), 65534
as_root = pytest.mark.skipif(ME != 0, reason="only root can be somebody else")


@pytest.fixture
def users_folder(monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder in which all users of this test leave their files."""
    folder = short_folder()
    folder.chmod(0o1777)
    for name, variable in (("tmp", "TMPDIR"), ("run", "XDG_RUNTIME_DIR")):
        (folder / name).mkdir()
        monkeypatch.setenv(variable, str(folder / name))
    (folder / "tmp").chmod(0o1777)
    return folder


@pytest.fixture
def opened() -> list[str]:
    """Return the names of the runs' files that this process opens from now on."""
    names: list[str] = []

    def opens(event: str, arguments: tuple[object, ...]) -> None:
        if event == "open" and str(arguments[0]).endswith(".json"):
            names.append(str(arguments[0]))

    sys.addaudithook(opens)
    return names


def config(*changes: str) -> Config:
    return load_config(PLATOON, [ENDPOINT, *changes])


def register(users_folder: Path) -> Path:
    return users_folder / "tmp" / "robofleet"


def become_nobody(runtime: Path | None = None) -> None:
    os.environ.pop("XDG_RUNTIME_DIR", None)
    if runtime is not None:
        os.environ["XDG_RUNTIME_DIR"] = str(runtime)
    os.setgroups([])
    os.setresgid(NOBODY, NOBODY, NOBODY)
    os.setresuid(NOBODY, NOBODY, NOBODY)


def as_nobody(act: Callable[[], object]) -> str:
    """Do something as another user, in a process of its own; returns what it returned or raised, as text."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            become_nobody()
            try:
                text = str(act())
            except BaseException as error:  # noqa: BLE001 - it is told
                text = f"{type(error).__name__}: {error}"
            os.write(writing, text.encode())
        finally:
            os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as pipe:
        text = pipe.read()
    os.waitpid(child, 0)
    return text


class Elsewhere:
    """A run of another user, for as long as this is open."""

    def __init__(self, folder: str, runtime: Path | None = None) -> None:
        self._folder, self._runtime = folder, runtime
        self._config = config()  # another user may not read all that it loads

    def __enter__(self) -> None:
        ready, writing = os.pipe()
        reading, self._end = os.pipe()
        self._child = os.fork()
        if self._child == 0:
            try:
                os.close(self._end)
                become_nobody(self._runtime)
                with claimed(self._config, Path(self._folder)):
                    os.write(writing, b"x")
                    os.read(reading, 1)
            finally:
                os._exit(0)
        os.close(writing)
        os.close(reading)
        assert os.read(ready, 1) == b"x"
        os.close(ready)

    def __exit__(self, *_: object) -> None:
        os.close(self._end)
        os.waitpid(self._child, 0)


def test_a_run_is_found_where_the_runtime_folder_is_another_one(
    users_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with claimed(config(), Path("somewhere")):
        for runtime in (short_folder(), short_folder() / "new"):
            monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
            assert [run.arena for run in running()] == ["platoon"]
            with pytest.raises(ArenaBusyError, match=r"has a run already, in .*somewhere"), claimed(config(), Path()):
                pass
        monkeypatch.delenv("XDG_RUNTIME_DIR")
        assert [run.pid for run in running()] == [os.getpid()]
    assert running() == []


def test_a_run_is_found_by_the_private_folder_where_the_register_is_another_one(
    users_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with claimed(config(), Path()):
        monkeypatch.setenv("TMPDIR", str(short_folder()))
        assert [run.arena for run in running()] == ["platoon"]
        with pytest.raises(ArenaBusyError), claimed(config(), Path()):
            pass


def test_the_places_where_was_looked_are_named(users_folder: Path) -> None:
    with pytest.raises(operator.NoArenaError) as refused:
        operator.chosen(None)
    assert str(refused.value) == (
        f"no arena has a run in {register(users_folder)} or {users_folder}/run/robofleet: "
        "start one with `robofleet run CONFIG`"
    )


def test_a_file_that_was_left_behind_is_no_run_and_is_replaced(users_folder: Path) -> None:
    with claimed(config(), Path("somewhere")):
        (file,) = register(users_folder).iterdir()
        left_behind = file.read_text()
        assert file.name == f"platoon.{ME}.json"
        assert file.stat().st_mode & 0o7777 == 0o644
        (run,) = running()
    assert run == ArenaFile(
        "platoon", "unixsock-stream//run/lab/bus.sock", os.getpid(), str(Path("somewhere").absolute()),
        run.started, ("r1", "r2", "r3", "r4"), {"r1": ("r1", "r2", "r3", "r4")}, ME,
    )  # fmt: skip
    for content in (left_behind, left_behind + " " * 5000, ""):  # its launcher was killed
        file.write_text(content)
        assert running() == []
        with claimed(config(), Path("again")):
            (run,) = running()
            assert run.folder == str(Path("again").absolute())
        assert not file.exists()


def test_an_arena_has_one_run_and_who_was_refused_takes_nothing_away(users_folder: Path) -> None:
    with claimed(config(), Path("somewhere")):
        with pytest.raises(ArenaBusyError, match=f"`kill {os.getpid()}`"), claimed(config(), Path()):
            pass
        assert len(running()) == 1
    with claimed(config(), Path()):
        assert len(running()) == 1


def test_of_many_who_begin_in_the_same_moment_one_has_the_arena(users_folder: Path) -> None:
    inside, most, refused = 0, 0, 0
    lock = threading.Lock()

    def begin() -> None:
        nonlocal inside, most, refused
        for _ in range(20):
            try:
                with claimed(config(), Path()):
                    with lock:
                        inside += 1
                        most = max(most, inside)
                    found()
                    with lock:
                        inside -= 1
            except ArenaBusyError:
                with lock:
                    refused += 1

    threads = [threading.Thread(target=begin) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == 1
    assert running() == []


@pytest.mark.parametrize("lock", [fcntl.LOCK_SH, fcntl.LOCK_EX])
def test_who_only_reads_a_file_cannot_make_it_look_alive_nor_keep_it(users_folder: Path, lock: int) -> None:
    """A file left behind, which a stranger opens and locks in every way that the system gives to a reader."""
    with claimed(config(), Path()):
        (file,) = register(users_folder).iterdir()
        text = file.read_text()
    file.write_text(text)
    with file.open() as stranger:
        fcntl.flock(stranger, lock)
        fcntl.lockf(stranger, fcntl.LOCK_SH)
        fcntl.fcntl(stranger, fcntl.F_OFD_SETLK, FLOCK.pack(fcntl.F_RDLCK, 0, 0, 0, 0))
        assert running() == []
        with claimed(config(), Path()):
            assert len(running()) == 1


@pytest.mark.parametrize(
    "content",
    [
        "", "{}", "[]", "null", "7", "{", "[" * 50_000, "x" * 100_000,
        {"arena": "hall"}, {"endpoint": "private"}, {"endpoint": "udp/1.2.3.4:5"}, {"endpoint": 7}, {"pid": 1},
        {"pid": -1}, {"pid": True}, {"pid": "7"}, {"folder": "\x1b[2J"}, {"folder": "x" * 5000}, {"started": None},
        {"robots": "r1 r2"}, {"robots": [["r1"]]}, {"robots": 7}, {"uid": 0}, {"more": 1},
    ],
    ids=repr,
)  # fmt: skip
def test_what_no_launcher_has_written_is_no_run(users_folder: Path, content: str | dict[str, object]) -> None:
    with claimed(config(), Path()):
        for file in (*register(users_folder).iterdir(), *(users_folder / "run" / "robofleet").iterdir()):
            record = json.loads(file.read_text())
            text = json.dumps(record | content) if isinstance(content, dict) else content
            with file.open("r+") as stream:  # the lock stays
                stream.truncate()
                stream.write(text)
        assert [run.uid for run in running()] == ([ME] if content == {"uid": 0} else [])


def test_a_link_or_a_pipe_in_the_place_of_a_file_is_passed_over_and_left_as_it_is(users_folder: Path) -> None:
    found()  # makes the register
    victim = users_folder / "victim.json"
    victim.write_text("precious")
    file = register(users_folder) / f"platoon.{ME}.json"
    file.symlink_to(victim)
    os.mkfifo(register(users_folder) / f"hall.{ME}.json")
    (register(users_folder) / "odd name.json").write_text("")
    assert found().runs == ()
    with pytest.raises(PlaceError, match=rf"{file} is not a file of yours.*`rm {file}`"), claimed(config(), Path()):
        pass
    file.unlink()
    os.link(victim, file)
    with pytest.raises(PlaceError, match="is not a file of yours"), claimed(config(), Path()):
        pass
    assert victim.read_text() == "precious"


@pytest.mark.parametrize("how", ["a link", "a file", "not sticky", "closed"])
def test_a_register_that_was_spoiled_keeps_nobody_from_stopping_his_own_run(
    users_folder: Path, how: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with claimed(config(), Path("somewhere")):
        register(users_folder).rename(users_folder / "away")
        if how == "a link":
            register(users_folder).symlink_to(users_folder / "away")
        elif how == "a file":
            register(users_folder).write_text("")
        else:
            register(users_folder).mkdir()
            register(users_folder).chmod(0o777 if how == "not sticky" else 0o755)
        assert operator.chosen(None).arena == "platoon"
        assert f"some runs may not be listed: {register(users_folder)} is not the folder" in capsys.readouterr().err
        with pytest.raises(PlaceError, match=r"an administrator moves it away with `mv "), claimed(config(), Path()):
            pass


def test_a_private_folder_that_was_spoiled_keeps_nobody_from_stopping_his_own_run(
    users_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    victim = users_folder / "victim"
    victim.mkdir(mode=0o700)
    (victim / "lab.json").write_text("precious")
    with claimed(config(), Path("somewhere")):
        (users_folder / "run" / "robofleet").rename(users_folder / "away")
        (users_folder / "run" / "robofleet").symlink_to(victim)
        assert operator.chosen(None).arena == "platoon"
        assert "some runs may not be listed" in capsys.readouterr().err
    assert (victim / "lab.json").read_text() == "precious"


def test_of_several_arenas_one_is_named_except_for_the_emergency_stop(
    users_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopped: list[str] = []

    def stop(run: ArenaFile) -> tuple[bool, str]:
        stopped.append(run.arena)
        return run.arena == "lab", run.arena

    monkeypatch.setattr(operator, "stop", stop)
    with claimed(config(), Path()), claimed(config("arena.name=lab"), Path()):
        assert operator.chosen("lab").arena == "lab"
        with pytest.raises(operator.NoArenaError, match="name one of lab, platoon"):
            operator.chosen(None)
        with pytest.raises(operator.NoArenaError, match="the arena attic has no run: name one of lab, platoon"):
            operator.chosen("attic")
        assert operator.stop_all(None) == [(True, "lab"), (False, "platoon")]
        assert sorted(stopped) == ["lab", "platoon"]
        assert operator.stop_all("lab") == [(True, "lab")]


@as_root
def test_another_user_sees_a_run_and_may_neither_stop_it_nor_begin_one_there(users_folder: Path) -> None:
    with claimed(config(), Path("/somewhere")):
        output = as_nobody(lambda: operator.stop_all(None))
        assert "(False, " in output
        assert f"the arena platoon has a run of root (process {os.getpid()}), which is not yours" in output
        assert "ask root or an administrator" in output
        assert "ask root or an administrator" in as_nobody(lambda: operator.chosen(None))
        assert as_nobody(running) == "[]"

        def begin() -> None:
            with claimed(config(), Path("/else")):
                pass

        output = as_nobody(begin)
        assert output.startswith("ArenaBusyError: the arena platoon has a run already, in /somewhere since ")
        assert "of root): ask root to end it, or an administrator" in output
        assert len(running()) == 1
    assert as_nobody(begin) == "None"


@as_root
def test_an_administrator_finds_the_runs_of_all(users_folder: Path) -> None:
    with Elsewhere("/theirs"):
        (found,) = running()
        assert (found.uid, found.user, found.folder) == (NOBODY, "nobody", "/theirs")
        with pytest.raises(ArenaBusyError, match=r"of nobody.*: ask nobody to end it"), claimed(config(), Path()):
            pass
    with claimed(config(), Path()):
        assert [run.uid for run in running()] == [ME]


@as_root
def test_own_runs_are_all_that_a_user_stops_and_strangers_do_not_make_that_fail(users_folder: Path) -> None:
    def stopped() -> list[tuple[bool, str]]:
        operator.stop = lambda run: (True, f"{run.arena} of {run.user}")
        with claimed(config("arena.name=lab"), Path("/theirs")):
            return operator.stop_all(None)

    with claimed(config(), Path("/mine")):
        assert as_nobody(stopped) == "[(True, 'lab of nobody')]"


@as_root
def test_many_files_of_one_user_neither_hide_nor_delay_the_runs_of_others(
    users_folder: Path, opened: list[str]
) -> None:
    with Elsewhere("/theirs"):
        for k in range(1000):
            file = register(users_folder) / f"lab{k}.{NOBODY - 1}.json"
            file.write_text("{}")
            os.chown(file, NOBODY - 1, NOBODY - 1)
        search = Search()
        opened.clear()
        assert next(search.permitted()).user == "nobody"
        assert len(opened) < 5
        found()
        assert len(opened) < 300
        assert f"user {NOBODY - 1} has more than 256 files of runs: name the arena" in found().troubles
        opened.clear()
        assert [run.user for run in running("platoon")] == ["nobody"]
        assert not [file for file in opened if Path(file).name.startswith("lab")]


@as_root
@pytest.mark.parametrize("runtime", [False, True], ids=["in /tmp", "in its runtime folder"])
def test_an_administrator_finds_a_run_that_the_registers_owner_hides(users_folder: Path, runtime: bool) -> None:
    """He made the register first: so he can remove what stands in it, or close it."""
    theirs = users_folder / str(NOBODY)
    theirs.mkdir(mode=0o700)
    os.chown(theirs, NOBODY, NOBODY)
    with Elsewhere("/theirs", theirs if runtime else None):
        (register(users_folder) / f"platoon.{NOBODY}.json").unlink()
        assert [run.user for run in running()] == ["nobody"]
        register(users_folder).chmod(0o755)
        assert [run.user for run in running("platoon")] == ["nobody"]
        assert as_nobody(lambda: [run.uid for run in found().runs]) == ("[]" if runtime else f"[{NOBODY}]")


@as_root
def test_in_a_users_private_folder_nothing_but_that_users_own_files_is_believed(users_folder: Path) -> None:
    with claimed(config(), Path("/mine")):
        theirs = users_folder / "tmp" / f"robofleet-{NOBODY}"
        theirs.mkdir(mode=0o700)
        os.chown(theirs, NOBODY, NOBODY)
        (own,) = (users_folder / "run" / "robofleet").iterdir()
        register(users_folder).rename(users_folder / "away")
        (theirs / f"lab.{NOBODY}.json").symlink_to(own)
        (theirs / f"hall.{ME}.json").symlink_to(own)
        (users_folder / "tmp" / "robofleet-1").symlink_to(own.parent)
        assert [*Search().others()] == []
        assert [run.folder for run in running()] == ["/mine"]


@pytest.mark.slow
@as_root
@pytest.mark.parametrize(
    "command", ["web --no-browser", "hosts", "foxglove", "rerun", "teleop", "ros2 --rviz", "Fleet"]
)
@pytest.mark.parametrize("named", [True, False])
def test_an_administrator_loads_no_code_of_another_users_run(users_folder: Path, command: str, named: bool) -> None:
    (users_folder / "theirs").mkdir()
    (users_folder / "theirs" / "config.yaml").write_text(SWIRL.read_text().replace("mylab:", "theirs_lab:"))
    (users_folder / "theirs" / "theirs_lab.py").write_text(
        "import pathlib\npathlib.Path(__file__).with_suffix('.ran').touch()\n"
    )
    with Elsewhere(str(users_folder / "theirs")):
        if command == "Fleet":
            with pytest.raises(FleetError) as refused:
                Fleet("platoon").open()
            message = str(refused.value)
        else:
            words = command.split()
            came = robofleet(*words, *(["platoon"] if named else []))
            assert came.exit_code == 2, came.output
            message = came.stderr
        assert "the arena platoon has a run of nobody (process " in message
        assert "do this as nobody" in message
        assert len(message.splitlines()) == 1
        assert operator.chosen(None).user == "nobody", "it may be stopped"
        with claimed(config("arena.name=mine"), Path("/mine")):
            assert operator.chosen(None, own=True).arena == "mine"
    assert not (users_folder / "theirs" / "theirs_lab.ran").exists()


@as_root
def test_what_a_stranger_writes_in_my_name_is_not_believed(users_folder: Path) -> None:
    """He made the register, wrote a file under my number, and keeps it locked."""
    with Elsewhere("/theirs"):
        (theirs,) = register(users_folder).iterdir()
        forged = register(users_folder) / f"lab.{ME}.json"
        forged.write_text(theirs.read_text().replace("platoon", "lab"))
        os.chown(forged, NOBODY, NOBODY)
        with forged.open("r+") as held:
            fcntl.fcntl(held, fcntl.F_OFD_SETLK, FLOCK.pack(fcntl.F_WRLCK, 0, 0, 0, 0))
            assert [(run.arena, run.uid) for run in found().runs] == [("platoon", NOBODY)]
            with pytest.raises(PlaceError, match=rf"`rm {forged}`"), claimed(config("arena.name=lab"), Path()):
                pass
    assert forged.exists(), "nothing of others is removed"


@pytest.mark.slow
def test_a_launcher_is_only_signalled_if_the_process_is_its_users(users_folder: Path) -> None:
    """The number in a file is what its user wrote: an administrator must not kill others by it."""
    with ExitStack() as stack:
        sleeper = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
        stack.callback(sleeper.wait)
        stack.callback(sleeper.kill)
        run = ArenaFile(
            "lab", "unixsock-stream//nowhere/bus.sock", sleeper.pid, "/x", "", ("r1",), {"r1": ("r1",)}, ME + 1
        )
        done, output = operator.stop(run)
        assert not done
        assert "does not answer" in output
        assert sleeper.poll() is None
        operator.stop(run._replace(uid=ME))
        assert sleeper.wait(10) != 0


@as_root
def test_another_user_does_not_reach_the_bus(users_folder: Path) -> None:
    """As seen: nobody drove, over TCP on loopback."""
    (users_folder / "run").chmod(0o777)
    settled_at = settled(load_config(PLATOON), listen=True).bus.endpoint
    path = settled_at.partition("/")[2]
    with socket.socket(socket.AF_UNIX) as router, socket.socket(socket.AF_UNIX) as mine:
        router.bind(path)
        router.listen()
        Path(path).chmod(0o777)  # whatever the umask was: the folder keeps others out
        mine.connect(path)

        def connect() -> None:
            with socket.socket(socket.AF_UNIX) as stranger:
                stranger.connect(path)

        assert as_nobody(connect).startswith("PermissionError")

        def join() -> None:
            os.environ["XDG_RUNTIME_DIR"] = str(users_folder / "run")
            settled(load_config(PLATOON), listen=False)

        assert "belongs to somebody else" in as_nobody(join)
