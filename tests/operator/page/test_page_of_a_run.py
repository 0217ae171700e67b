"""The operator's page of a real run in a real browser: its emergency stop stops a robot's wheels."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By

from robofleet.bus import keys
from robofleet.bus.keys import key
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.config.load import load_config
from robofleet.safety.latches import Latch
from tests.bus.alone import ROBOT_STATUS, RobotStatus
from tests.operator.page.browser import show_as
from tests.operator.page.openpage import SOON_S
from tests.operator.page.webstand import CLOCK
from tests.runs.realrun import ALONE, RealRun, wait

pytestmark = pytest.mark.long

ADDRESS = re.compile(r"http://127\.0\.0\.1:\S+")


@contextmanager
def listening(run: RealRun) -> Iterator[Callable[[], dict[str, RobotStatus]]]:
    """Yield what returns the newest word of each robot of a run."""
    config = load_config(run.folder / "config.yaml", ())
    bus = ZenohBus(config.arena.name, config.bus.endpoint, "test", CLOCK)
    newest: dict[str, RobotStatus] = {}

    def heard() -> dict[str, RobotStatus]:
        for _, full, payload in statuses.drain():
            unit = config.units[full.split("/")[-2]]
            for row, robot in enumerate(unit):
                if (status := ROBOT_STATUS.of(payload, row)) is not None:
                    newest[robot] = status
        return newest

    try:
        statuses = bus.stream(key(config.arena.name, keys.STATUS, "*"), capacity=1024)
        yield heard
    finally:
        bus.close()


def moving(status: RobotStatus) -> bool:
    return max(abs(status.left_rad_s), abs(status.right_rad_s), abs(status.left_output_rad_s)) > 0.05


def running(browser: Chrome) -> bool:
    """Whether the page says so; a busy machine's hold is resumed."""
    phase = browser.execute_script("return window.robofleet?.state.phase")
    if phase == "hold":
        browser.find_element(By.CSS_SELECTOR, "[data-do=resume]").click()
    return bool(phase == "running")


SMALL = 700, 900  # the fewer pixels, the more is left of two cores for the robots
MOVED = """return robofleet.state.robots.map(robot => [robot.x_m, robot.y_m])"""


def test_a_robot_drives_on_the_page_until_its_emergency_stop_stops_its_wheels(
    browser: Chrome, real_run: Callable[..., RealRun]
) -> None:
    run = real_run(*ALONE, "--web")
    run.wait_for(lambda: ADDRESS.search(run.said))
    show_as(browser, SMALL)
    browser.get(ADDRESS.search(run.said)[0])  # type: ignore[index]
    run.wait_for(lambda: running(browser))
    before = np.array(browser.execute_script(MOVED))
    run.wait_for(
        lambda: running(browser) and np.linalg.norm(browser.execute_script(MOVED) - before, axis=1).min() > 0.05
    )
    with listening(run) as newest:
        run.wait_for(lambda: running(browser) and newest() and all(map(moving, newest().values())))
        browser.find_element(By.ID, "estop-button").click()
        assert wait(lambda: not any(map(moving, newest().values())), SOON_S)
        assert {status.latch for status in newest().values()} == {Latch.EMERGENCY_STOP}
    marks = "return ['estop-pressed', 'estop-shown'].map(name => performance.getEntriesByName(name)[0]?.startTime)"
    assert wait(lambda: None not in browser.execute_script(marks), SOON_S)
    pressed_ms, shown_ms = browser.execute_script(marks)
    assert 0 < shown_ms - pressed_ms < 1000  # `web_latency` measures it; here the browser shares two cores with a fleet
    button = browser.find_element(By.ID, "estop-button")
    assert "every robot has latched its gate" in browser.find_element(By.ID, "run-answer").text
    assert run.ended() == 1
    assert wait(lambda: "The run has ended" in button.text, SOON_S), "nothing is left that it could stop"
    ended = browser.find_element(By.ID, "ended-banner")
    assert wait(lambda: "Stopped: emergency stop (" in ended.text and "Open the report" in ended.text, SOON_S)
    browser.get("about:blank")
    assert run.nothing_is_left(), "the page stays only while somebody looks"
