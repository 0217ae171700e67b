"""The page's stick in a real browser: whatever ends its hold lets the robots stand, and who may not drive reads so."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from selenium.webdriver import ActionChains, Chrome, Keys
from selenium.webdriver.common.by import By

from robofleet.behaviours.interface import WishKind
from robofleet.safety.supervisor import Event, Phase
from tests.operator.page.axe import violations
from tests.operator.page.browser import DESKTOP, LYING, PHONE, show_as, show_in
from tests.operator.page.openpage import Seen, opened
from tests.operator.page.secureweb import HOST, keys_in
from tests.operator.page.webstand import WebStand, web_stand
from tests.operator.test_hand import CRAWL, MOST_OMEGA, MOST_V, TELEOP, Wished

pytestmark = pytest.mark.slow

SOCKETS = """
  window.sockets = [];
  window.WebSocket = class extends WebSocket { constructor(...all) { super(...all); sockets.push(this); } };
"""
THUMB = 150  # px, the least ring


@pytest.fixture(scope="module")
def stand(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebStand]:
    with web_stand(tmp_path_factory.mktemp("run"), "tracker.source=truth", file=TELEOP) as stand:
        yield stand


@pytest.fixture
def page(browser: Chrome, stand: WebStand) -> Iterator[Seen]:
    added = browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": SOCKETS})
    with opened(browser, stand) as page:
        yield page
    browser.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", added)


@pytest.fixture
def wished(page: Seen) -> Wished:
    page.becomes(lambda: page.text("drive-words").startswith("Hold the stick to drive r1."))
    return Wished(page.stand)


def middle(page: Seen) -> tuple[float, float, float]:
    """Return the ring's middle and radius on the screen [px]."""
    x, y, width = page.run(
        "const ring = document.getElementById('drive-stick'); ring.scrollIntoView({block: 'nearest'});"
        "const box = ring.getBoundingClientRect(); return [box.x + box.width / 2, box.y + box.height / 2, box.width]"
    )
    return x, y, width / 2


def mouse(
    page: Seen, kind: str, forward: float = 0.0, turn: float = 0.0, buttons: int = 1, button: str = "left"
) -> None:
    """Do something with the mouse at a place of the ring, in its radii."""
    x, y, radius = middle(page)
    event = {"type": kind, "x": x - turn * radius, "y": y - forward * radius, "buttons": buttons, "clickCount": 1}
    page.browser.execute_cdp_cmd("Input.dispatchMouseEvent", event | {"button": button})


def touch(page: Seen, kind: str, *fingers: tuple[float, float]) -> None:
    """Let fingers be at places of the ring, in its radii."""
    x, y, radius = middle(page)
    points = [{"x": x - turn * radius, "y": y - forward * radius, "id": k} for k, (forward, turn) in enumerate(fingers)]
    page.browser.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})


def key(page: Seen, kind: str, name: str, **more: object) -> None:
    page.browser.execute_cdp_cmd("Input.dispatchKeyEvent", {"type": kind, "code": name, "key": name, **more})


def stands_for_good(page: Seen, wished: Wished) -> None:
    """The robots are told to stand at once, and nothing after it, whatever is still held."""
    page.becomes(lambda: wished.is_(WishKind.STAND))
    count, since = len(wished.all), page.stand._seq
    page.becomes(lambda: page.stand._seq > since + 60)  # ten ticks; the states and the robots' statuses alone are 50
    wished.newest()
    assert len(wished.all) == count


def test_a_finger_drives_as_far_as_it_goes_and_one_finger_only(page: Seen, wished: Wished) -> None:
    show_as(page.browser, PHONE)
    touch(page, "touchStart", (0.5, 0.0))
    page.becomes(lambda: wished.is_(WishKind.BODY, 0.5 * MOST_V))
    assert page.text("drive-words") == "You drive r1."
    scrolled = page.run("return scrollY")
    touch(page, "touchMove", (-3.0, 0.0))
    page.becomes(lambda: wished.is_(WishKind.BODY, -MOST_V))
    touch(page, "touchMove", (-3.0, 0.0), (0.0, 0.5))
    page.becomes(lambda: wished.is_(WishKind.BODY, -MOST_V))
    touch(page, "touchMove", (0.0, 3.0), (0.0, 0.5))
    page.becomes(lambda: wished.is_(WishKind.BODY, 0.0, MOST_OMEGA))
    assert page.run("return scrollY") == scrolled
    touch(page, "touchEnd")
    stands_for_good(page, wished)


OF_POINTERS: dict[str, Callable[[Seen], None]] = {
    "the system takes the touch": lambda page: touch(page, "touchCancel"),
    "the button is let go while another is down": lambda page: mouse(page, "mouseMoved", 1.0, 0.0, 2, "right"),
}
ENDINGS: dict[str, Callable[[Seen], None]] = {
    "another element takes the focus": lambda page: page.run("document.getElementById('look-in').focus()"),
    "the window loses the focus": lambda page: page.run("window.dispatchEvent(new Event('blur'))"),
    "another tab": lambda page: page.browser.switch_to.new_window("tab"),
    "the socket is cut": lambda page: page.run("sockets.at(-1).close()"),
    "the run is held": lambda page: setattr(page.fleet, "phase", Phase.HOLD),
    "the emergency stop": lambda page: key(page, "keyDown", "Space"),
    "another key": lambda page: key(page, "keyDown", "Escape"),
    "a key of the system": lambda page: key(page, "keyDown", "KeyW", modifiers=4),
    "the controller is silent": lambda page: setattr(page.fleet, "controlled", False),
}


@pytest.mark.parametrize(
    ("ending", "how"),
    [*((ending, "pointer") for ending in OF_POINTERS | ENDINGS), *((name, "key") for name in ENDINGS)],
)
def test_whatever_ends_the_hold_lets_the_robots_stand_until_a_new_press(
    page: Seen, wished: Wished, ending: str, how: str
) -> None:
    window = page.browser.current_window_handle
    if ending == "the system takes the touch":
        touch(page, "touchStart", (1.0, 0.0))
    elif how == "pointer":
        mouse(page, "mousePressed", 1.0)
    else:
        page.run("document.getElementById('drive-stick').focus()")
        key(page, "keyDown", "ArrowUp")
    page.becomes(lambda: wished.is_(WishKind.BODY, MOST_V))
    (OF_POINTERS | ENDINGS)[ending](page)
    stands_for_good(page, wished)
    if ending == "another tab":
        page.browser.close()
        page.browser.switch_to.window(window)
    page.fleet.controlled, page.fleet.phase = True, Phase.RUNNING
    if ending == "the emergency stop":
        assert b"estop" in page.stand.requests
    page.becomes(lambda: page.text("drive-words").startswith(("Hold the stick", "Let go")))
    if how == "key":
        key(page, "keyDown", "ArrowUp", autoRepeat=True)
    else:
        mouse(page, "mouseMoved", 0.9)
    stands_for_good(page, wished)
    key(page, "keyUp", "ArrowUp")
    for kind in ("mouseReleased", "mousePressed"):
        mouse(page, kind, 1.0, buttons=int(kind == "mousePressed"))
    page.becomes(lambda: wished.is_(WishKind.BODY, MOST_V))
    mouse(page, "mouseReleased", 1.0, buttons=0)


def test_a_key_that_repeats_sends_no_more_than_the_screens_pictures(page: Seen, wished: Wished) -> None:
    page.run("document.getElementById('drive-stick').focus()")
    key(page, "keyDown", "KeyA")
    page.becomes(lambda: wished.is_(WishKind.BODY, 0.0, MOST_OMEGA))
    tick, count = page.fleet.ticks, len(wished.all)
    for _ in range(200):
        key(page, "keyDown", "KeyA", autoRepeat=True)
    page.becomes(lambda: page.fleet.ticks > tick + 10)
    wished.newest()
    assert 0 < len(wished.all) - count <= 4 * (page.fleet.ticks - tick)
    key(page, "keyDown", "KeyW")
    page.becomes(lambda: wished.is_(WishKind.BODY, MOST_V, MOST_OMEGA))
    key(page, "keyUp", "KeyA")
    page.becomes(lambda: wished.is_(WishKind.BODY, MOST_V))
    key(page, "keyUp", "KeyW")
    stands_for_good(page, wished)


def test_who_comes_second_is_told_and_drives_after_a_new_press(page: Seen, wished: Wished) -> None:
    page.fleet.figures = {"wish_epoch": [77.0] * 4, "command_age": [0.033, *[float("nan")] * 3]}
    page.becomes(lambda: page.text("drive-words").startswith("Another person drives r1."))
    mouse(page, "mousePressed", 1.0)
    stands = page.fleet.ticks
    page.becomes(lambda: page.fleet.ticks > stands + 10)
    assert wished.newest() is None
    page.fleet.figures = {}
    page.becomes(lambda: page.text("drive-words") == "Let go, then press again.")
    mouse(page, "mouseReleased", 1.0, buttons=0)
    mouse(page, "mousePressed", 1.0)
    page.becomes(lambda: wished.is_(WishKind.BODY, MOST_V))
    page.fleet.figures = {"wish_epoch": [float(wished.all[-1].epoch)] * 4, "command_age": [0.033] * 4}
    tick = page.fleet.ticks
    page.becomes(lambda: page.fleet.ticks > tick + 10)
    assert wished.is_(WishKind.BODY, MOST_V) and page.text("drive-words") == "You drive r1."
    mouse(page, "mouseReleased", 1.0, buttons=0)


def test_in_a_held_run_the_chosen_robot_is_driven_out(page: Seen, wished: Wished) -> None:
    page.fleet.phase, page.fleet.cause = Phase.HOLD, Event.DEADLOCKED
    page.becomes(lambda: page.shown("drive-robot"))
    page.browser.find_element(By.CSS_SELECTOR, "#drive-robot option:nth-child(3)").click()
    page.becomes(lambda: page.text("drive-words") == "Hold the stick to drive r3 out at a crawl. All others stand.")
    ActionChains(page.browser).send_keys(Keys.TAB).perform()
    assert page.run("return document.activeElement.id") == "drive-stick"
    key(page, "keyDown", "ArrowUp")
    page.becomes(lambda: (wish := wished.newest()) is not None and wish.kind == WishKind.RESCUE)
    assert [tuple(robot)[:2] for robot in wished.all[-1].robots] == [
        (0, 0.0), (0, 0.0), (1, pytest.approx(CRAWL)), (0, 0.0),
    ]  # fmt: skip
    key(page, "keyUp", "ArrowUp")
    stands_for_good(page, wished)


def test_of_several_groups_the_chosen_ones_first_robot_is_driven(browser: Chrome, tmp_path: Path) -> None:
    file, other = tmp_path / "two.yaml", "robots: [r1, r2]\n  - {name: other, behaviour: teleop, robots: [r3, r4]}\n#"
    file.write_text(TELEOP.read_text().replace("robots: [r1, r2, r3, r4]", other).replace("    settings: {max", "# {"))
    with web_stand(tmp_path, "tracker.source=truth", file=file) as stand, opened(browser, stand) as page:
        page.becomes(lambda: page.shown("drive-robot"))
        wished = Wished(stand, "other")
        assert page.run("return [...document.getElementById('drive-robot').options].map(({ text }) => text)") == [
            "r1", "r3",
        ]  # fmt: skip
        page.browser.find_element(By.CSS_SELECTOR, "#drive-robot option:nth-child(2)").click()
        mouse(page, "mousePressed", 1.0)
        page.becomes(lambda: wished.is_(WishKind.BODY, MOST_V))
        page.run("document.getElementById('drive-robot').value = 'r1'")
        stands_for_good(page, wished)
        mouse(page, "mouseReleased", 1.0, buttons=0)


def test_a_viewer_has_no_stick_and_drives_nothing(browser: Chrome, tmp_path: Path) -> None:
    secure = web_stand(
        tmp_path, "tracker.source=truth", "arena.name=hall", file=TELEOP, host=HOST, keys=keys_in(tmp_path / "keys")
    )
    with secure as stand, opened(browser, stand, stand.addresses.viewer) as page:
        assert not page.shown("drive-panel")
        browser.delete_all_cookies()
        with opened(browser, stand) as operator:
            operator.becomes(lambda: operator.shown("drive-panel"))
        browser.delete_all_cookies()


BOXES = """return ["drive-stick", "estop-button"]
    .map((name) => document.getElementById(name).getBoundingClientRect().toJSON())"""


@pytest.mark.parametrize("size", [DESKTOP, PHONE, LYING])
def test_the_stick_is_large_far_from_the_stop_and_axe_finds_nothing(
    page: Seen, wished: Wished, size: tuple[int, int]
) -> None:
    show_as(page.browser, size)
    for phase in Phase.RUNNING, Phase.HOLD:
        page.fleet.phase = phase
        page.becomes(lambda phase=phase: page.run("return robofleet.state.phase") == phase.name.lower())
        for scheme in "light", "dark":
            show_in(page.browser, scheme)
            known = ["page-has-heading-one"] if size == LYING else []
            assert [line for line in violations(page.browser) if line.split(":")[0] not in known] == []
    show_in(page.browser, "light")
    page.run("scrollTo(0, 0)")
    ring, stop = page.run(BOXES)
    assert min(ring["width"], ring["height"]) >= THUMB
    beside = max(ring["left"] - stop["right"], stop["left"] - ring["right"])
    assert max(beside, ring["top"] - stop["bottom"], stop["top"] - ring["bottom"]) > 40
    assert page.run("return document.documentElement.scrollWidth") <= size[0]
    assert wished.newest() is None
