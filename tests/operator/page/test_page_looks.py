"""How the operator's page, the report and the calibrations' pages look and are used: by anybody, on any screen."""

import math
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from selenium.webdriver import ActionChains, Chrome, Keys
from selenium.webdriver.common.actions.wheel_input import ScrollOrigin
from selenium.webdriver.common.by import By

from robofleet.calibration.robots import heights, offsets
from robofleet.calibration.robots.results import offsets_page
from robofleet.config.load import load_config
from robofleet.nodes.unit.state_store import FileStateStore, StoredRobot
from robofleet.recording.log import FILE
from robofleet.reports import after
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import Event, Phase
from tests.calibration.robots.conftest import drive, shots
from tests.calibration.robots.conftest import found as identified
from tests.operator.page.axe import violations
from tests.operator.page.browser import LYING, PHONE, show_as, show_in
from tests.operator.page.openpage import Seen, opened
from tests.operator.page.webstand import WebStand, web_stand
from tests.runs.realrun import PLATOON

pytestmark = pytest.mark.slow

TWO = Path(__file__).parents[1] / "two_groups.yaml"
RECORDINGS = Path(__file__).parents[2] / "recordings"
LAPTOP = 1280, 800
THUMB = 44  # px, the least that a finger meets
PHASES = {  # what the page shows, and why
    Phase.IDLE: Event.NOTHING,
    Phase.ARMED: Event.NOTHING,
    Phase.POSITIONING: Event.SET_OUT,
    Phase.RUNNING: Event.PROVED,
    Phase.PARKING: Event.OFF_TO_PARK,
    Phase.HOLD: Event.HOLD_REQUESTED,
    Phase.FAULT: Event.CAMERA_LOST,
    Phase.ESTOP: Event.ESTOP_REQUESTED,
}


@pytest.fixture(scope="module")
def stand(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebStand]:
    with web_stand(tmp_path_factory.mktemp("run")) as stand:
        yield stand


def found_by_axe(browser: Chrome, what: str) -> list[str]:
    """Return what axe finds on a laptop and on a phone; in the dark, where only colours are others, in the colours."""
    found = []
    for size in (LAPTOP, PHONE):
        show_as(browser, size)
        for scheme, rules in (("light", ()), ("dark", ("color-contrast",))):
            show_in(browser, scheme)
            found += [f"{what}, {size[0]} px, {scheme}: {line}" for line in violations(browser, *rules)]
    show_in(browser, "light")
    return found


@pytest.mark.parametrize(
    "phases", [(Phase.RUNNING, Phase.ESTOP), pytest.param(tuple(PHASES), marks=pytest.mark.long)], ids=["two", "all"]
)
def test_axe_finds_nothing_in_any_state_of_the_run(browser: Chrome, tmp_path: Path, phases: tuple[Phase, ...]) -> None:
    found = []
    with web_stand(tmp_path, file=TWO) as stand, opened(browser, stand) as page:
        for phase in phases:
            page.fleet.latched = set(stand.robots[:2]) if phase is Phase.ESTOP else set()
            page.fleet.phase, page.fleet.cause = phase, PHASES[phase]
            page.becomes(lambda phase=phase: page.run("return robofleet.state.phase") == phase.name.lower())
            found += found_by_axe(browser, phase.name)
        page.fleet.supervised = False
        page.becomes(lambda: page.shown("lost-banner"))
        found += found_by_axe(browser, "link lost")
        page.fleet.supervised, page.fleet.phase = True, Phase.IDLE
        page.becomes(lambda: not page.shown("lost-banner") and page.run("return robofleet.state.phase") == "idle")
        FileStateStore(stand.config.arena.name, simulated=True).save("r1", StoredRobot(3, Latch.EMERGENCY_STOP, 2))
        stand.over.set()
        page.becomes(lambda: page.shown("ended-reset"))
        found += found_by_axe(browser, "ended")
    assert found == []


def sideways(browser: Chrome) -> float:
    """Return how far the page scrolls to the side [px]."""
    return float(browser.execute_script("return document.documentElement.scrollWidth - innerWidth"))


@pytest.mark.long
@pytest.mark.parametrize("what", ["report", "calibration"])
def test_axe_finds_nothing_in_a_report_nor_in_a_calibration(browser: Chrome, tmp_path: Path, what: str) -> None:
    if what == "report":
        shutil.copy(RECORDINGS / "held.mcap", tmp_path / FILE)
        page = after.report(tmp_path, tmp_path / "figures").page
    else:
        made = drive()
        page = tmp_path / "page.html"
        config = load_config(PLATOON)
        vehicle = config.members[0].vehicle
        tags = [offsets.of(identified(made))]
        offsets_page(tags, [heights.find(config, made)], [shots(made)], [vehicle]).write(page)
    browser.get(page.as_uri())
    assert found_by_axe(browser, what) == []
    show_as(browser, PHONE)
    assert sideways(browser) <= 0
    show_in(browser, "dark")
    ground = browser.execute_script("return getComputedStyle(document.body).backgroundColor")
    assert max(map(int, re.findall(r"\d+", ground))) < 64, "it is light in the dark"
    show_in(browser, "light")


LEAST = """return [...document.querySelectorAll("button, a[href], summary")].filter((one) => one.checkVisibility())
    .map((one) => [one.id || one.textContent, one.getBoundingClientRect()])
    .filter(([, box]) => Math.min(box.width, box.height) < arguments[0]).map(([name]) => name)"""
COVERED = """const name = arguments[0], bar = document.getElementById("estop-button");
    const one = document.querySelectorAll("button, [tabindex='0']")[name];
    if (one === bar || !one.checkVisibility() || one.disabled) return null;
    scrollTo(0, 0);
    one.focus();
    const [box, of, head] = [one, bar, document.querySelector(".head")].map((it) => it.getBoundingClientRect());
    const tall = box.height > innerHeight - head.bottom - (innerHeight - of.top);
    const under = of.top > head.bottom && box.bottom > of.top + 1 && !tall;
    return under || box.top < head.bottom - 1 ? one.id || one.textContent : null"""


@pytest.mark.parametrize("size", [PHONE, LYING])
def test_on_a_phone_fingers_meet_every_control_and_none_is_under_the_stop(page: Seen, size: tuple[int, int]) -> None:
    show_as(page.browser, size)
    assert page.run(LEAST, THUMB) == []
    count = page.run("return document.querySelectorAll(`button, [tabindex='0']`).length")
    covered = [page.run(COVERED, k) for k in range(count)]
    assert [name for name in covered if name] == []
    assert page.run("return document.documentElement.scrollWidth") <= size[0]


def test_on_a_phone_the_table_shows_figures_without_a_scroll(page: Seen) -> None:
    show_as(page.browser, PHONE)
    page.becomes(lambda: len(page.run("return document.querySelector('tbody tr').innerText").split()) > 4)
    for column, words in enumerate(("Control error", "Estimated path error", "Estimated spacing"), start=3):
        head, box = page.run(
            "const cell = document.querySelector(`thead th:nth-child(${arguments[0]})`);"
            "return [cell.innerText, cell.getBoundingClientRect().toJSON()]",
            column,
        )
        assert " ".join(head.split()) == f"{words} mm"
        assert box["left"] >= 0 and box["right"] <= PHONE[0] and box["width"] > 40


CELLS = """return [...document.querySelectorAll("#robots-tables table")].map((table) => [
    table.caption.innerText, [...table.tHead.rows[0].cells].map((cell) => cell.innerText.replace(/\\s+/g, " ")),
    [...table.tBodies[0].rows].map((row) => [...row.cells].map((cell) => cell.innerText))])"""
COLUMNS = ["Robot", "State", "Wheels rad/s", "Battery %", "Age ms"]


def test_each_group_has_a_table_with_its_own_figures(browser: Chrome, tmp_path: Path) -> None:
    with web_stand(tmp_path, file=TWO) as stand, opened(browser, stand) as page:
        show_as(page.browser, (1600, 1000))
        page.fleet.figures = {"control_error": [0.00012345] * 5, "radius_error": [0.25] * 5, "turned": [-0.5] * 5}
        page.becomes(lambda: page.run(CELLS)[0][2][0][2] == "0.12")
        platoon, inner, parked = page.run(CELLS)
        page.fleet.latched = {"s2"}
        page.becomes(lambda: page.run(CELLS)[0][0].startswith("inner"))
        (latched, *_), *_ = page.run(CELLS)[0][2]
        plots = page.run("return [...document.querySelectorAll('.plot')].map((plot) => plot.innerText)")
        legend = page.text("shapes-legend").splitlines()
    assert [platoon[0], " ".join(inner[0].split()), " ".join(parked[0].split())] == [
        "platoon", "inner tests.nodes.swirl:Swirl", "no group parked",
    ]  # fmt: skip
    own = ["Control error mm", "Estimated path error mm", "Estimated spacing mm"]
    assert [platoon[1], inner[1], parked[1]] == [
        [*COLUMNS[:2], *own, *COLUMNS[2:]], [*COLUMNS[:2], "Radius error mm", "Turned deg", *COLUMNS[2:]], COLUMNS,
    ]  # fmt: skip
    assert [row[0] for row in platoon[2]] == ["r1", "r2", "r3"]
    assert inner[2][0][2:4] == ["250.0", "-28.6"]
    assert latched == "s2", "the worst is first"
    assert [" ".join(plot.split()) for plot in plots][-2:] == ["Radius error 250.0 mm", "Turned -28.6 deg"]
    assert legend == ["platoon: path", "inner: circle", "inner: marks"]


def seen_place(page: Seen, x_m: float, y_m: float) -> tuple[float, float]:
    """Return where a place of the arena is on the screen [px from the stage's corner]."""
    x, y = page.run("return robofleet.place(...arguments)", x_m, y_m)
    return float(x), float(y)


def test_the_arena_is_made_larger_moved_and_shown_whole_again(page: Seen) -> None:
    stage = page.browser.find_element(By.ID, "arena-stage")
    width = float(page.run("return arguments[0].clientWidth", stage))
    whole = seen_place(page, 0.0, 0.0), seen_place(page, 1.0, 0.0)

    def scale() -> float:
        return seen_place(page, 1.0, 0.0)[0] - seen_place(page, 0.0, 0.0)[0]

    once = scale()
    scrolled = page.run("return scrollY")
    ActionChains(page.browser).scroll_from_origin(ScrollOrigin.from_element(stage, 60, 40), 0, -400).perform()
    page.becomes(lambda: scale() > 1.5 * once)
    assert page.run("return scrollY") == scrolled
    before = seen_place(page, 0.0, 0.0)
    ActionChains(page.browser).drag_and_drop_by_offset(stage, -50, 30).perform()
    page.becomes(lambda: np.allclose(np.subtract(seen_place(page, 0.0, 0.0), before), (-50, 30), atol=2))
    ActionChains(page.browser).double_click(stage).perform()
    page.becomes(lambda: np.allclose([seen_place(page, 0.0, 0.0), seen_place(page, 1.0, 0.0)], whole, atol=0.5))
    page.run("arguments[0].focus()", stage)
    keys = ActionChains(page.browser)
    keys.send_keys("+", "+").perform()
    page.becomes(lambda: scale() > 1.9 * once)
    before = seen_place(page, 0.0, 0.0)
    keys.send_keys(Keys.ARROW_LEFT).perform()
    page.becomes(lambda: seen_place(page, 0.0, 0.0)[0] > before[0] + 30)
    page.browser.find_element(By.ID, "look-reset").click()
    page.becomes(lambda: abs(scale() - once) < 0.5)
    assert not page.browser.find_element(By.ID, "look-reset").is_enabled()
    assert 0 < once < width


@pytest.mark.parametrize(("where", "key"), [("arena-stage", " "), ("look-in", " "), ("events-list", "e")])
def test_space_and_e_stop_the_robots_wherever_the_focus_is(page: Seen, where: str, key: str) -> None:
    page.run("document.getElementById(arguments[0]).focus()", where)
    before = seen_place(page, 1.0, 0.0)
    ActionChains(page.browser).send_keys(key).perform()
    page.becomes(lambda: b"estop" in page.stand.requests)
    assert seen_place(page, 1.0, 0.0) == before


def test_two_fingers_make_the_arena_larger(page: Seen) -> None:
    show_as(page.browser, PHONE)
    x, y = page.run(
        "const b = document.getElementById('arena-stage').getBoundingClientRect(); return [b.x + 150, b.y + 90]"
    )
    once = seen_place(page, 1.0, 0.0)[0] - seen_place(page, 0.0, 0.0)[0]
    for kind, apart in (("touchStart", 20), ("touchMove", 40), ("touchMove", 60), ("touchEnd", None)):
        fingers = [] if apart is None else [{"x": x + way * apart, "y": y, "id": k} for k, way in enumerate((-1, 1))]
        page.browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})
    page.becomes(lambda: seen_place(page, 1.0, 0.0)[0] - seen_place(page, 0.0, 0.0)[0] > 2 * once)


INKS = """const canvas = document.querySelectorAll(".plot canvas")[arguments[0]], inks = new Set();
    const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
    for (let k = 0; k < pixels.length; k += 4) if (pixels[k + 3] > 120) inks.add(pixels.slice(k, k + 3).join());
    return [...inks].map((ink) => ink.split(",").map(Number))"""


def test_figures_of_the_last_minute_are_plotted(page: Seen) -> None:
    def drawn(plot: int, robots: list[int]) -> bool:
        """Whether a plot has something in the colour of each of these robots, in light."""
        inks = np.array(page.run(INKS, plot)).reshape(-1, 3)
        colours = page.run("return robofleet.state.hello.robots.map((robot) => robot.colour)")
        wanted = [[int(colours[row][at : at + 2], 16) for at in (1, 3, 5)] for row in robots]
        return all(np.abs(inks - colour).max(axis=1).min(initial=255) < 8 for colour in wanted)

    page.fleet.figures = {
        "control_error": [0.0002, 0.0004, 0.0006, 0.0008],
        "estimated_spacing": [math.nan, 0.2562, 0.2618, 0.2672],  # between the lines of the scale
    }
    page.becomes(lambda: drawn(0, [0, 1, 2, 3]))
    page.becomes(lambda: drawn(2, [1, 2, 3]))
    plots = page.run("return [...document.querySelectorAll('.plot')].map((plot) => plot.innerText)")
    assert [" ".join(plot.split()) for plot in plots] == [
        "Control error 0.20 to 0.80 mm", "Estimated path error –", "Estimated spacing 256.2 to 267.2 mm",
    ]  # fmt: skip
    assert page.text("plots-legend").split() == page.stand.robots
