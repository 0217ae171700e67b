"""What the operator's page can ask for, and the commands that open it."""

import json
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from robofleet.bus.arena_file import claimed, found
from robofleet.bus.endpoint import listens, settled
from robofleet.bus.zenoh_bus import open_router
from robofleet.config.load import resolved_yaml
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S
from robofleet.core.refusal import WEB_PACKAGES, RefusedError, need_extra
from robofleet.operator.page.command import Over, There
from robofleet.safety.latches import GateStatus, Latch
from tests.command import robofleet
from tests.endpoints import own_endpoint, short_folder
from tests.operator.page.webstand import CLOCK, WebStand
from tests.runs.realrun import ALONE, RealRun, own_folders, wait


def test_what_the_page_asks_for_is_asked_of_the_supervisor_and_a_refusal_is_told_in_its_words(stand: WebStand) -> None:
    with stand.page() as page:
        for what in ("arm", "start", "hold", "stop", "reset"):
            page.say(do=what)
            assert page.next("answer") == {"type": "answer", "to": what, "ok": True, "text": "ok"}
        assert stand.requests == [b"arm", b"start", b"hold", b"stop", b"reset"]
        page.say(do="resume")
        assert page.next("answer") == {"type": "answer", "to": "resume", "ok": False, "text": "the fleet is asleep"}
        stand.mute = True
        page.say(do="hold")
        silent = page.next("answer")
        assert (silent["ok"], silent["text"].split(":")[0]) == (False, "the supervisor does not answer")


def latch_when_asked(stand: WebStand, *robots: str) -> threading.Thread:
    """Play the drivers: these latch their gates when an emergency stop is asked for."""

    def play() -> None:
        if wait(lambda: b"estop" in stand.requests, 5):
            for _ in range(20):
                for robot in robots:
                    stand.say_status(robot, GateStatus.LATCHED, Latch.EMERGENCY_STOP)
                CLOCK.sleep_until(CLOCK.now_ns() + 5 * MS)

    thread = threading.Thread(target=play)
    thread.start()
    return thread


def test_the_emergency_stop_says_who_has_and_who_has_not_acknowledged(stand: WebStand) -> None:
    with stand.page() as page:
        playing = latch_when_asked(stand, *stand.robots)
        page.say(do="estop")
        answer = page.next("answer")
        playing.join()
        assert (answer["to"], answer["ok"]) == ("estop", True)
        assert answer["text"].startswith("every robot has latched its gate, the last one after ")
        stand.requests.clear()
        playing = latch_when_asked(stand, "r1", "r3")
        page.say(do="estop")
        answer = page.next("answer")
        playing.join()
    assert (answer["ok"], answer["text"]) == (False, "NOT acknowledged within 200 ms by r2, r4: stop them by hand")


def test_the_emergency_stop_waits_for_no_other_request_and_no_other_page(stand: WebStand) -> None:
    stand.mute = True  # each of these waits for two seconds
    with stand.page() as busy, stand.page() as page:
        for _ in range(12):
            busy.say(do="hold")
        assert busy.next("answer")["text"].startswith("too much was asked at once")
        for who in (busy, page):
            who.say(do="estop")
        assert wait(lambda: stand.requests.count(b"estop") >= 2, 5)
        waits = "the supervisor does not answer"  # the answer to each of the others
        for who in (busy, page):
            first = who.next("answer", lambda answer: answer["to"] == "estop" or answer["text"].startswith(waits))
            assert (first["to"], first["ok"]) == ("estop", False)


def test_a_stop_reaches_the_robots_also_when_its_page_is_gone(stand: WebStand) -> None:
    with stand.page() as page:
        page.say(do="estop")
    assert wait(lambda: b"estop" in stand.requests, 2)


@pytest.mark.long
def test_a_run_goes_on_without_its_page(real_run: Callable[..., RealRun]) -> None:
    run = real_run(*ALONE, "--web", "--duration", "1")
    run.wait_for(lambda: "the operator's page: http://127.0.0.1:" in run.said)
    run.kill("web")
    run.wait_for(lambda: "\nthe page is gone, the run goes on: `robofleet web` opens another one" in run.said)
    assert run.ended() == 0
    assert run.summary["outcome"] == "completed"
    assert run.nothing_is_left()


def test_what_is_not_installed_is_named_with_the_way_to_it() -> None:
    need_extra("lab", *WEB_PACKAGES)
    with pytest.raises(
        RefusedError, match=r"this needs no_such_one: \S+ -m pip install -e '\.\[lab\]' in robofleet's folder$"
    ):
        need_extra("lab", "starlette", "no_such_one")


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[int, str]]:
    """Return the exit code of a command and the line that it says; nothing of this computer's runs is seen."""
    for name, folder in own_folders(tmp_path).items():
        monkeypatch.setenv(name, folder)

    def invoke(*arguments: str) -> tuple[int, str]:
        result = robofleet(*arguments)
        assert result.stderr.count("\n") == 1, result.stderr
        return result.exit_code, result.stderr

    return invoke


@pytest.mark.slow
def test_what_the_command_cannot_serve_is_refused_in_a_line(
    command: Callable[..., tuple[int, str]], platoon_of: Callable[..., Config], tmp_path: Path
) -> None:
    run = tmp_path / "20260101T000000Z-platoon"
    run.mkdir()
    file = run / "config.yaml"
    file.write_text(resolved_yaml(platoon_of("arena.name=hall")))
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        for arguments, line in [
            ([], "no arena has a run"),
            (["hall"], "no arena has a run"),
            ([str(run / "none.yaml")], f"{run / 'none.yaml'}:"),
            ([str(file), "--host", "0.0.0.0"], "--host 0.0.0.0: name one of this machine's addresses"),
            ([str(file), "--port", str(port)], f"--host 127.0.0.1 --port {port}: Address already in use: name an addr"),
            ([str(file)], "no run of hall answers at unixsock-stream/"),
        ]:
            code, output = command("web", *arguments)
            assert (code, output[: len(line)]) == (2, line)
    bounds = [{"figure": "overruns", "value": 2, "limit": 0, "pass": False}]
    fault = {"outcome": "fault", "cause": "r3: a bumper is hit", "ticks": 9, "bounds": bounds}
    (run / "summary.json").write_text(json.dumps(fault))
    ended = f"the run in {run} has ended: Ended by a fault: r3: a bumper is hit"
    assert command("web", str(file)) == (2, f"{ended}; it is kept in {run}\n")
    (run / "report.html").touch()
    assert command("web", str(run)) == (2, f"{ended}; its report: {run / 'report.html'}\n")


@pytest.mark.slow
def test_a_run_that_ends_is_told_from_a_link_that_is_lost(platoon_of: Callable[..., Config], tmp_path: Path) -> None:
    config = platoon_of(f"bus.endpoint={own_endpoint()}", "arena.name=hall")
    with claimed(config, tmp_path):
        (run,) = [run for run in found().runs if run.arena == "hall"]
        over = Over(There(config, tmp_path, run))
        router = open_router(config.bus.endpoint)
        try:
            assert listens(config.bus.endpoint)
            CLOCK.sleep_until(CLOCK.now_ns() + S)
            assert not over()
        finally:
            router.close()  # type: ignore[no-untyped-call]
        assert wait(over, 5), "its router is the last of it"
        begins = Over(There(config, tmp_path, run))
        assert not begins(), "a launcher that has no router yet"
    assert wait(begins, 5), "its launcher is gone"
    assert not Over(There(config, tmp_path, None))(), "nobody has launched it"


@pytest.mark.slow
def test_a_page_that_is_opened_by_hand_ends_with_its_run(platoon_of: Callable[..., Config], tmp_path: Path) -> None:
    environment = own_folders(short_folder())
    run = tmp_path / "run"
    run.mkdir()
    with pytest.MonkeyPatch.context() as patched:
        for name, folder in environment.items():
            patched.setenv(name, folder)
        config = settled(platoon_of("arena.name=hall"), listen=True)
        (run / "config.yaml").write_text(resolved_yaml(config))
        with claimed(config, run), (tmp_path / "said").open("wb") as output:
            router = open_router(config.bus.endpoint)
            page = subprocess.Popen(
                [sys.executable, "-W", "error", "-m", "robofleet", "web", "hall"],
                env=environment,
                stderr=output,
                stdout=output,
            )
            try:
                words = tmp_path / "said"
                assert wait(lambda: "the operator's page: http://127.0.0.1:" in words.read_text(), 60), (
                    words.read_text()
                )
                bounds = [{"figure": "overruns", "value": 0, "limit": 9, "pass": True}]
                summary = {"outcome": "completed", "cause": None, "ticks": 9, "bounds": bounds}
                (run / "summary.json").write_text(json.dumps(summary))
                router.close()  # type: ignore[no-untyped-call]
                assert page.wait(30) == 0
            finally:
                page.kill()
                page.wait()
    ended = f"the run of hall has ended: Completed, every bound met; it is kept in {run}"
    address, how, *rest = words.read_text().splitlines()
    assert address.startswith("the operator's page: ")
    assert how.startswith("  ")
    assert rest == [ended], "no library says anything"
