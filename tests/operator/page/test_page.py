"""The operator's page in a real browser: what it shows, what it lets the operator do, and when it must not."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from selenium.webdriver import ActionChains, Chrome
from selenium.webdriver.common.by import By

from robofleet.bus.messages import TagPose
from robofleet.core.clock import MS, S
from robofleet.safety.supervisor import Event, Phase
from tests.operator.page.browser import DESKTOP, LYING, PHONE, show_as
from tests.operator.page.openpage import Seen, opened
from tests.operator.page.webstand import CLOCK, WebStand, web_stand

PERMITTED = {
    Phase.IDLE: {"arm", "start"},
    Phase.ARMED: {"start", "stop"},
    Phase.POSITIONING: {"hold", "stop"},
    Phase.RUNNING: {"hold", "stop"},
    Phase.PARKING: {"hold", "stop"},
    Phase.HOLD: {"resume", "stop"},
    Phase.FAULT: {"reset"},
    Phase.ESTOP: {"reset"},
}


@pytest.fixture(scope="module")
def stand(browser: Chrome, tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebStand]:
    with web_stand(tmp_path_factory.mktemp("run")) as stand:
        yield stand


@pytest.fixture
def mortal(browser: Chrome, tmp_path: Path) -> Iterator[WebStand]:
    """A server that a test may end."""
    with web_stand(tmp_path) as stand:
        yield stand


def test_the_page_shows_the_fleet_within_a_second_and_fetches_nothing_from_outside(page: Seen) -> None:
    def first_picture_ms() -> float:
        page.browser.refresh()
        page.becomes(lambda: page.run("return window.robofleet?.state.drawn"))
        return float(page.run("return performance.getEntriesByName('first-tick-drawn')[0].startTime"))

    assert min(first_picture_ms() for _ in range(2)) < 1000.0
    page.becomes(lambda: page.run("return document.querySelectorAll('tbody tr').length") == 4)
    assert page.text("arena-name") == "platoon"
    fetched = page.run("return performance.getEntriesByType('resource').map(entry => entry.name)")
    assert len(fetched) > 5
    assert all(name.startswith(f"http://{page.stand.authority}/") for name in fetched)
    assert [line for line in page.browser.get_log("browser") if line["level"] != "INFO"] == []  # also none of the CSP


def test_robots_move_on_the_page_as_they_do_in_the_arena(page: Seen) -> None:
    pixels = "return document.getElementById('arena-robots').toDataURL()"
    places = "return robofleet.state.robots.map(robot => robot.x_m)"
    before, picture = page.run(places), page.run(pixels)
    page.becomes(lambda: min(np.subtract(page.run(places), before)) > 0.01)
    assert page.run(pixels) != picture


@pytest.mark.slow
def test_a_control_can_be_pressed_only_in_the_phases_that_permit_it(page: Seen) -> None:
    for phase, permitted in PERMITTED.items():
        page.stand.requests.clear()
        page.fleet.phase = phase
        page.becomes(lambda phase=phase: page.run("return robofleet.state.phase") == phase.name.lower())
        page.becomes(lambda permitted=permitted: page.enabled() == permitted)
        assert not page.estop_is_dead()
        for what in permitted:
            page.press(what)
        page.becomes(lambda permitted=permitted: {what.encode() for what in permitted} == set(page.stand.requests))


def _first_row(page: Seen) -> str:
    """Return the table of robots from its first robot on."""
    found = re.search(r"\br[1-4] .*", " ".join(page.text("robots-tables").split()))
    return found[0] if found else ""


@pytest.mark.slow
def test_in_peace_a_reset_is_offered_only_when_a_robot_is_latched_and_that_robot_comes_first(page: Seen) -> None:
    page.fleet.phase, page.fleet.latched = Phase.IDLE, {"r3"}
    page.becomes(lambda: "reset" in page.enabled())
    page.becomes(lambda: _first_row(page).startswith("r3 latched: emergency stop"))


@pytest.mark.slow
def test_a_refusal_is_shown_in_the_supervisors_words(page: Seen) -> None:
    page.fleet.phase = Phase.HOLD
    page.becomes(lambda: "resume" in page.enabled())
    page.press("resume")
    page.becomes(lambda: page.text("run-answer") == "resume: the fleet is asleep")


def latch_when_asked(page: Seen, *robots: str) -> None:
    page.becomes(lambda: b"estop" in page.stand.requests)
    page.fleet.latched, page.fleet.phase = set(robots), Phase.ESTOP


@pytest.mark.slow_after_first
@pytest.mark.parametrize("how", ["pointer", " ", "e", "E"])
def test_the_emergency_stop_is_one_press_and_says_who_has_latched(page: Seen, how: str) -> None:
    page.becomes(lambda: "hold" in page.enabled())
    page.run("document.querySelector('[data-do=hold]').focus()")
    keyboard, button = ActionChains(page.browser), page.browser.find_element(By.ID, "estop-button")
    if how == "pointer":
        keyboard.click_and_hold(button).perform()  # it acts when it is pressed, not when it is let go
    else:
        keyboard.send_keys(how).perform()
    latch_when_asked(page, *page.stand.robots)
    keyboard.reset_actions()
    page.becomes(lambda: page.text("estop-note").startswith("every robot has latched its gate"))
    page.becomes(lambda: page.text("phase-name") == "EMERGENCY STOP")
    assert not page.shown("notice")
    assert b"hold" not in page.stand.requests, "space pressed the button that had the focus"


@pytest.mark.slow
def test_robots_that_did_not_acknowledge_are_named_loudly(page: Seen) -> None:
    page.browser.find_element(By.ID, "estop-button").click()
    latch_when_asked(page, "r1", "r3")
    page.becomes(lambda: page.shown("notice"))
    assert "NOT acknowledged within 200 ms by r2, r4" in page.text("notice")


@pytest.mark.slow
def test_the_emergency_stop_goes_another_way_where_the_socket_does_not_open(page: Seen) -> None:
    script = {"source": "window.WebSocket = class { static OPEN = 1; readyState = 0; }"}
    added = page.browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", script)
    page.browser.refresh()
    page.browser.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", added)
    page.browser.find_element(By.ID, "estop-button").click()
    latch_when_asked(page, *page.stand.robots)
    page.becomes(lambda: page.text("run-answer").startswith("estop: every robot has latched its gate"))


def is_lost(page: Seen) -> bool:
    return page.shown("lost-banner") and page.estop_is_dead() and not page.enabled()


@pytest.mark.slow
@pytest.mark.parametrize("who", ["supervisor", "controller"])
def test_a_fleet_that_is_not_heard_greys_everything_out_until_it_is_heard_again(page: Seen, who: str) -> None:
    silent = {"supervisor": "supervised", "controller": "controlled"}[who]
    setattr(page.fleet, silent, False)
    page.becomes(lambda: is_lost(page))
    assert "cannot stop anything: use the terminal (robofleet stop) or the switch" in page.text("lost-banner")
    assert f"The {who} is silent." in page.text("lost-banner")
    assert "CANNOT STOP" in page.text("estop-button")
    assert "grayscale" in page.run("return getComputedStyle(document.querySelector('main')).filter")
    setattr(page.fleet, silent, True)
    page.becomes(lambda: not page.shown("lost-banner") and not page.estop_is_dead())
    assert page.enabled() == PERMITTED[Phase.RUNNING]


@pytest.mark.slow
def test_a_server_that_is_gone_in_mid_run_is_a_lost_link(browser: Chrome, mortal: WebStand) -> None:
    with opened(browser, mortal) as page:
        page.run("setInterval(() => { window.after_ms ??= robofleet.state.lost?.ms }, 5)")
        mortal.end()
        page.becomes(lambda: is_lost(page))
        assert page.run("return after_ms") < 900, "a socket that closes is not waited for"
        assert "The page's server cannot be reached." in page.text("lost-banner")
        assert not page.shown("ended-banner")
        page.browser.find_element(By.ID, "estop-button").click()
        page.becomes(lambda: page.shown("notice"))
        assert "did not get through" in page.text("notice")


@pytest.mark.slow
def test_a_run_that_has_ended_is_told_calmly(browser: Chrome, mortal: WebStand, tmp_path: Path) -> None:
    with opened(browser, mortal) as page:
        page.fleet.phase, page.fleet.cause = Phase.IDLE, Event.STOP_REQUESTED
        page.becomes(lambda: page.text("phase-name") == "Idle")
        mortal.over.set()
        page.becomes(lambda: page.shown("ended-banner"))
        assert "stop requested" in page.text("ended-banner")
        assert not page.shown("ended-report")
        bounds = [{"figure": "overruns", "value": 0, "limit": 0, "pass": True}]
        summary = {"outcome": "completed", "cause": None, "ticks": 9, "bounds": bounds}
        (tmp_path / "summary.json").write_text(json.dumps(summary))
        page.becomes(lambda: page.text("ended-text") == "Completed, every bound met")
        (tmp_path / "report.html").write_text("<!doctype html><title>its report</title>")
        page.becomes(lambda: page.shown("ended-report"))
        fetched = "return fetch(document.getElementById('ended-report').href).then((answer) => answer.text())"
        assert "its report" in page.run(fetched)
        mortal.end()
        page.becomes(lambda: not page.shown("ended-report"))
        assert str(tmp_path / "report.html") in page.text("ended-place"), "a link would lead nowhere"
        CLOCK.sleep_until(CLOCK.now_ns() + 3 * S // 2)  # longer than a silence that is a lost link
        assert not page.shown("lost-banner")
        assert page.estop_is_dead()
        assert page.text("estop-button").startswith("The run has ended")
        assert not page.enabled()
        states = page.browser.find_elements(By.CSS_SELECTOR, "td.state")
        assert {state.text for state in states} == {"ended"}


@pytest.mark.slow
@pytest.mark.parametrize("size", [DESKTOP, (820, 1100), PHONE, LYING])
def test_the_emergency_stop_is_in_sight_at_every_size_and_scrolled(page: Seen, size: tuple[int, int]) -> None:
    show_as(page.browser, size)
    for down in (0, 10_000):
        page.run("scrollTo(0, arguments[0])", down)
        hit, left, top, right, bottom = page.run(
            "const button = document.getElementById('estop-button'), box = button.getBoundingClientRect();"
            "const hit = document.elementFromPoint((box.left + box.right) / 2, (box.top + box.bottom) / 2);"
            "return [button.contains(hit), box.left, box.top, box.right, box.bottom]"
        )
        assert hit
        assert min(left, top) >= 0
        assert (right, bottom) <= size
        assert right - left >= 200
        assert bottom - top >= 44, "a thumb's width"
    assert page.run("return document.documentElement.scrollWidth") <= size[0], "it scrolls sideways"


@pytest.mark.slow
def test_the_camera_is_asked_only_while_it_is_shown_and_its_tags_are_outlined(page: Seen) -> None:
    pixel = "return Array.from(document.getElementById('camera-view').getContext('2d').getImageData(...arguments).data)"
    grey = cv2.imencode(".jpg", np.full((72, 128), 128, np.uint8))[1].tobytes()
    stand = page.stand
    width, height = stand.config.camera.width, stand.config.camera.height
    stand.say_image(1, CLOCK.now_ns(), TagPose(1, 0, 0, 0.0, 0.0, 0.0), jpeg=grey)
    drawn = page.run("return robofleet.state.drawn")
    page.becomes(lambda: page.run("return robofleet.state.drawn") > drawn + 5)
    assert not page.shown("camera-view")
    page.browser.find_element(By.ID, "camera-toggle").click()
    page.becomes(lambda: page.run(pixel, 2, 2, 1, 1)[:3] == pytest.approx([128] * 3, abs=3))
    around = np.array(page.run(pixel, width // 2 - 60, height // 2 - 60, 120, 120)).reshape(-1, 4)[:, :3]
    assert (around == 255).all(axis=1).any(), "no outline is drawn"
    page.browser.find_element(By.ID, "camera-toggle").click()
    assert not page.shown("camera-view")
    taken = page.run("return document.getElementById('camera-view').toDataURL()")
    stand.say_image(2, CLOCK.now_ns() + 33 * MS, jpeg=cv2.imencode(".jpg", np.zeros((72, 128), np.uint8))[1].tobytes())
    drawn = page.run("return robofleet.state.drawn")
    page.becomes(lambda: page.run("return robofleet.state.drawn") > drawn + 10)
    assert page.run("return document.getElementById('camera-view').toDataURL()") == taken
