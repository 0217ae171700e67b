"""A page that is open in a browser, and the fleet that it shows."""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By

from robofleet.bus.messages import RobotTick
from robofleet.safety.latches import GateStatus, Latch
from robofleet.safety.supervisor import NOBODY, Event, Phase
from tests.operator.page.browser import DESKTOP, show_as
from tests.operator.page.webstand import WebStand, placed
from tests.runs.realrun import wait

SOON_S = 15.0


class Fleet:
    """Says at every tick what a fleet would, with what a test changes."""

    def __init__(self, stand: WebStand) -> None:
        self._stand, self._end = stand, threading.Event()
        self.phase, self.cause = Phase.RUNNING, Event.PROVED
        self.robot = NOBODY  # who caused it
        self.supervised = self.controlled = True
        self.latched: set[str] = set()
        self.ticks = 0
        self.robots: list[RobotTick] = []  # where a test places them; else they move
        self.figures: dict[str, Sequence[float]] = {}  # their figures, as ``say_tick`` takes them

    def step(self) -> None:
        if self.supervised:
            self._stand.say_state(self.phase, self.cause, self.robot)
        for robot in self._stand.robots:
            held = (GateStatus.LATCHED, Latch.EMERGENCY_STOP) if robot in self.latched else ()
            self._stand.say_status(robot, *held)
        if self.controlled:
            self.ticks += 1
            ahead = [0.4 * row - 0.6 + 0.001 * self.ticks for row in range(len(self._stand.robots))]
            self._stand.say_tick(self.ticks, *(self.robots or [placed(x, 0.2) for x in ahead]), figures=self.figures)

    def until_ended(self) -> None:
        while not self._end.wait(0.033):
            self.step()

    @contextmanager
    def alive(self) -> "Iterator[Fleet]":
        thread = threading.Thread(target=self.until_ended)
        thread.start()
        try:
            yield self
        finally:
            self._end.set()
            thread.join()


class BrowserPage:
    """A page of any kind in a browser, and the fleet that it shows."""

    def __init__(self, browser: Chrome, stand: WebStand, fleet: Fleet) -> None:
        self.browser, self.stand, self.fleet = browser, stand, fleet

    def run(self, script: str, *arguments: Any) -> Any:
        return self.browser.execute_script(script, *arguments)


class Seen(BrowserPage):
    """A page that is open."""

    def text(self, name: str) -> str:
        return str(self.browser.find_element(By.ID, name).text)

    def shown(self, name: str) -> bool:
        return bool(self.browser.find_element(By.ID, name).is_displayed())

    def enabled(self) -> set[str]:
        buttons = self.browser.find_elements(By.CSS_SELECTOR, "#run-controls button")
        return {str(button.get_attribute("data-do")) for button in buttons if button.is_enabled()}

    def press(self, what: str) -> None:
        self.browser.find_element(By.CSS_SELECTOR, f"[data-do={what}]").click()

    def estop_is_dead(self) -> bool:
        return self.browser.find_element(By.ID, "estop-button").get_attribute("aria-disabled") == "true"

    def becomes(self, condition: Callable[[], Any]) -> None:
        assert wait(condition, SOON_S), self.run("return document.body.innerText")


@contextmanager
def opened(browser: Chrome, stand: WebStand, address: str = "") -> Iterator[Seen]:
    show_as(browser, DESKTOP)
    stand.requests.clear()
    with Fleet(stand).alive() as fleet:
        browser.get(address or stand.url)
        page = Seen(browser, stand, fleet)
        page.becomes(lambda: page.run("return window.robofleet?.state.drawn > 2"))
        yield page
        browser.get("about:blank")
