"""What the operator's page can ask for, and the commands that open it."""

import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest

from robofleet.clock import MS
from robofleet.config.load import resolved_yaml
from robofleet.config.tree import Config
from robofleet.processes.refusal import WEB_PACKAGES, RefusedError, need_extra
from robofleet.safety.gate import GateStatus, Latch
from tests.processes.realrun import ALONE, RealRun, wait
from tests.processes.webstand import CLOCK, WebStand, web_stand


@pytest.fixture
def stand(tmp_path: Path) -> Iterator[WebStand]:
    with web_stand(tmp_path, "tracker.source=truth") as stand:
        yield stand


@pytest.mark.parametrize("what", ["arm", "start", "hold", "stop", "reset"])
def test_what_the_page_asks_for_is_asked_of_the_supervisor(stand: WebStand, what: str) -> None:
    with stand.page() as page:
        page.say(do=what)
        assert page.next("answer") == {"type": "answer", "to": what, "ok": True, "text": "ok"}
    assert stand.asked == [what.encode()]


def test_a_refusal_is_told_in_the_supervisors_words(stand: WebStand) -> None:
    with stand.page() as page:
        page.say(do="resume")
        assert page.next("answer") == {"type": "answer", "to": "resume", "ok": False, "text": "the fleet is asleep"}
        stand.mute = True
        page.say(do="hold")
        silent = page.next("answer")
        assert (silent["ok"], silent["text"].split(":")[0]) == (False, "the supervisor does not answer")


def latch_when_asked(stand: WebStand, *robots: str) -> threading.Thread:
    """Play the drivers: these latch their gates when an emergency stop is asked for."""

    def play() -> None:
        if wait(lambda: b"estop" in stand.asked, 5):
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
        stand.asked.clear()
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
        assert wait(lambda: stand.asked.count(b"estop") >= 2, 5)
        waits = "the supervisor does not answer"  # the answer to each of the others
        for who in (busy, page):
            first = who.next("answer", lambda answer: answer["to"] == "estop" or answer["text"].startswith(waits))
            assert (first["to"], first["ok"]) == ("estop", False)


def test_the_emergency_stop_also_comes_by_post(stand: WebStand) -> None:
    playing = latch_when_asked(stand, *stand.robots)
    headers = {"origin": f"http://{stand.authority}", "x-token": stand.token}
    answer = httpx.post(f"http://{stand.authority}/estop", headers=headers)
    playing.join()
    assert (answer.status_code, answer.json()["ok"], answer.json()["to"]) == (200, True, "estop")


def test_a_stop_reaches_the_robots_also_when_its_page_is_gone(stand: WebStand) -> None:
    with stand.page() as page:
        page.say(do="estop")
    assert wait(lambda: b"estop" in stand.asked, 2)


def test_a_run_goes_on_without_its_page(real_run: Callable[..., RealRun]) -> None:
    run = real_run(*ALONE, "--web", "--duration", "1")
    run.wait_for(lambda: "the operator's page: http://127.0.0.1:" in run.said)
    run.kill("web")
    run.wait_for(lambda: "\nthe page is gone, the run goes on: `robofleet web` opens another one" in run.said)
    assert run.ended(30) == 0
    assert run.summary["outcome"] == "completed"
    assert run.nothing_is_left()


def test_what_is_not_installed_is_named_with_the_way_to_it() -> None:
    need_extra("web", *WEB_PACKAGES)
    with pytest.raises(
        RefusedError, match=r"this needs no_such_one: \S+ -m pip install -e '\.\[web\]' in robofleet's folder$"
    ):
        need_extra("web", "starlette", "no_such_one")


def test_what_the_command_cannot_serve_is_refused_in_a_line(
    real_run: Callable[..., RealRun], platoon_of: Callable[..., Config], tmp_path: Path
) -> None:
    run = real_run("--web", "--lockstep")
    assert run.ended(20) == 2
    assert run.said == "--web: a lockstep run is over before anybody has looked: leave --web or --lockstep out\n"
    file = tmp_path / "config.yaml"
    file.write_text(resolved_yaml(platoon_of()))
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        for arguments, line in [
            ([], "no arena has a run"),
            (
                [str(file), "--host", "0.0.0.0"],
                "name one of this machine's addresses: what a browser calls it is checked",
            ),
            (
                [str(file), "--port", str(port)],
                "Address already in use: name an address of this machine, and a port that",
            ),
        ]:
            refused = run.robofleet("web", *arguments)
            assert (refused.returncode, refused.stderr.count("\n")) == (2, 1), refused.stderr
            assert line in refused.stderr
