"""A projector's page in a real browser: where its light falls, where robots' discs are, and what it says instead."""

import base64
import json
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import httpx
import numpy as np
import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By

from robofleet.behaviours import described
from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import SHOWING, TICK
from robofleet.bus.messages import TICK_RECORD, RobotTick, TickRecord
from robofleet.core.arrays import Array, Image
from robofleet.core.clock import SimulatedClock
from robofleet.projection.disc import disc_radii
from robofleet.projection.prediction import ahead
from robofleet.safety.supervisor import Event, Phase
from robofleet.simulation.run_picture import RunPicture
from robofleet.vehicles.differential_drive import body_from_wheels
from tests.operator.page.browser import show_as
from tests.operator.page.openpage import SOON_S, BrowserPage, Fleet
from tests.operator.page.test_web_projector import hanging
from tests.operator.page.webstand import WebStand, placed, web_stand
from tests.projection.projectors import SIZE, on_floor, tilted
from tests.runs.realrun import wait

STANDING = [placed(-0.9, 0.25), placed(-0.3, -0.2), placed(0.3, 0.3), placed(0.8, -0.25)]
TURNING = [robot._replace(left_rad_s=6.0, right_rad_s=10.0) for robot in STANDING]


@pytest.fixture(scope="module")
def stand(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebStand]:
    raw = {"name": "raw", "width": SIZE[0], "height": SIZE[1]}
    rows = [*json.loads(hanging("main").removeprefix("projectors=")), raw]
    with web_stand(tmp_path_factory.mktemp("run"), "tracker.source=truth", f"projectors={json.dumps(rows)}") as stand:
        yield stand


class Lit(BrowserPage):
    """A projector's page that is open."""

    def becomes(self, condition: str) -> None:
        assert wait(lambda: self.run(f"return {condition}"), SOON_S), self.run("return document.body.innerText")

    def shows(self, *show: str) -> None:
        with self.stand.page() as operator:
            operator.say(show=show)
            self.becomes(f"robofleet.state.show.join() === '{','.join(show)}'")
        self.run("robofleet.state.pictures = 0")
        self.becomes("robofleet.state.pictures > 3")

    def picture(self) -> Image:
        png = base64.b64decode(self.browser.execute_cdp_cmd("Page.captureScreenshot", {"format": "png"})["data"])
        return np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR))


@contextmanager
def lit(browser: Chrome, stand: WebStand, robots: list[RobotTick], name: str = "main") -> Iterator[Lit]:
    show_as(browser, SIZE)
    with Fleet(stand).alive() as fleet:
        fleet.robots = robots
        browser.get(stand.url.replace("/?", f"/projector?name={name}&"))
        yield Lit(browser, stand, fleet)
        browser.get("about:blank")


def arena(columns: int = 20, rows: int = 12) -> Array:
    x, y = np.meshgrid(np.linspace(-1.6, 1.6, columns), np.linspace(-1.0, 1.0, rows))
    return np.column_stack([x.ravel(), y.ravel()])


def test_light_falls_where_the_calibration_says(browser: Chrome, stand: WebStand) -> None:
    with lit(browser, stand, STANDING) as page:
        page.becomes("window.robofleet?.state.pictures > 1")
        for height_m in 0.0, 0.08:
            points = np.column_stack([arena(), np.full(len(arena()), height_m)])
            predicted = page.run("return arguments[0].map((point) => robofleet.pixel(...point))", points.tolist())
            pixels = tilted().pixels(points)
            lit_ones = np.isfinite(pixels[:, 0])
            assert lit_ones.mean() > 0.5
            off = np.array(predicted)[lit_ones] - 0.5 - pixels[lit_ones]
            assert np.abs(off).max() < 1e-6
            outside = np.array(predicted)[~lit_ones]
            assert ((outside < 0.0) | (outside > SIZE)).any(axis=1).all()
        page.shows("paths")
        picture = page.picture().max(axis=2).astype(float)
        (path,) = (shape for group in stand.groups for shape in group.shapes)
        assert _off_px(picture, path.points) < 0.35  # 2 mm are 0.5 px


def _off_px(picture: Array, points: Array) -> float:
    """Return how far the middle of a drawn line is from where it belongs: the 90th percentile, as there are arrows."""
    ends = [tilted().pixels(on_floor(shifted)) for shifted in (points[:-1], points[1:])]
    middle, along = (ends[0] + ends[1]) / 2.0, ends[1] - ends[0]
    along /= np.linalg.norm(along, axis=1)[:, None]
    across = np.column_stack([-along[:, 1], along[:, 0]])
    steps = np.linspace(-4.0, 4.0, 33)
    places = (middle[:, None] + steps[None, :, None] * across[:, None]).astype(np.float32)
    kept = np.isfinite(places).all(axis=(1, 2))
    u, v = places[kept, :, 0], places[kept, :, 1]
    light = cv2.remap(picture.astype(np.float32), u, v, cv2.INTER_LINEAR)
    assert len(light) > 20
    assert (light.max(axis=1) > 150.0).all()
    return float(np.percentile(np.abs((light * steps).sum(axis=1) / light.sum(axis=1)), 90))


@pytest.mark.slow
def test_each_robot_and_its_tag_lie_in_constant_grey(browser: Chrome, stand: WebStand) -> None:
    with lit(browser, stand, STANDING) as page:
        page.becomes("window.robofleet?.state.pictures > 1")
        page.shows("floor", "grid", "paths", "references", "trails", "halos", "barrier", "names", "countdown")
        picture = page.picture()
        angle = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
        radii = disc_radii(stand.config)
        for robot, radius in zip(STANDING, radii, strict=True):
            for height_m in 0.0, 0.04, 0.08:
                ring = [[robot.x_m, robot.y_m] + share * radius * np.column_stack([np.cos(angle), np.sin(angle)])
                        for share in (0.0, 0.5, 0.9)]  # fmt: skip
                points = np.column_stack([np.vstack(ring), np.full(72, height_m)])
                at = np.round(tilted().pixels(points)).astype(int)
                grey = picture[at[:, 1], at[:, 0]].astype(int)
                assert np.abs(grey - 255 * stand.config.projectors[0].disc_gray).max() <= 1
        page.shows("halos")
        picture = page.picture()
        for robot, radius in zip(STANDING, radii, strict=True):
            halo = [robot.x_m, robot.y_m] + (radius + 0.005) * np.column_stack([np.cos(angle), np.sin(angle)])
            at = np.round(tilted().pixels(on_floor(halo))).astype(int)
            own = picture[at[:, 1], at[:, 0]].astype(int)
            assert (np.ptp(own, axis=1) > 40).mean() > 0.4  # coloured; the far side is behind the disc
        page.fleet.robots = [robot._replace(x_m=robot.x_m + 0.3, y_m=robot.y_m - 0.1) for robot in STANDING]
        page.becomes(f"robofleet.state.seen[0][0] > {STANDING[0].x_m + 0.25}")
        page.run("robofleet.state.pictures = 0")
        page.becomes("robofleet.state.pictures > 3")
        picture = page.picture()
        for robot in STANDING:
            ((u, v),) = np.round(tilted().pixels(np.array([[robot.x_m, robot.y_m, 0.0]]))).astype(int)
            assert not picture[v - 20 : v + 20, u - 20 : u + 20].any(), "what was drawn before is still there"


def test_a_simulated_projector_lights_what_the_page_lights(browser: Chrome, stand: WebStand) -> None:
    """Words and the grid are the page's alone; all is of one size. Nothing moves, so there are no trails."""
    (main, *_), size = stand.config.projectors, described.size(stand.groups)
    bus = MemoryBus(stand.config.arena.name, SimulatedClock(), 0)
    simulated, say = RunPicture(stand.config, main, 60.0, bus), bus.publisher(SHOWING)
    head = 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, Phase.RUNNING, 0, 0, 0, 0
    tick = TickRecord(*head, tuple(STANDING), (np.nan,) * size)
    bus.publisher(TICK)(TICK_RECORD.encode(tick))
    near = np.ones((3, 3), np.uint8)
    with lit(browser, stand, STANDING) as page:
        page.becomes("window.robofleet?.state.pictures > 1")
        for show in ["paths", "halos", "large"], ["floor"], ["paths"], ["halos"], ["barrier"]:
            page.shows(*show)
            say(" ".join(show).encode())
            picture = simulated.at(1)
            assert picture is not None
            both = [each > 60 for each in (picture, page.picture().max(axis=2))]
            for some, others in (both, both[::-1]):
                unlit = some & (cv2.dilate(others.astype(np.uint8), near) == 0)
                assert unlit.sum() < 0.01 * some.sum(), show


def test_what_moves_is_drawn_where_it_will_be_when_its_light_falls(browser: Chrome, stand: WebStand) -> None:
    poses = np.array([[0.1, 0.2, 3.0], [0.1, 0.2, -3.0], [-1.0, 0.3, 0.4]])
    speeds = np.array([[0.2, 1.5], [-0.1, -2.0], [0.15, 0.0]])
    script = (
        "const [poses, speeds, done] = arguments;"
        "import('/prediction.js').then(({ ahead }) => done(poses.map((pose, k) => ahead(pose, speeds[k], 0.3))))"
    )
    with lit(browser, stand, TURNING) as page:
        computed = browser.execute_async_script(script, poses.tolist(), speeds.tolist())
        assert np.array(computed) == pytest.approx(ahead(poses, speeds, 0.3), abs=1e-12)
        page.becomes("window.robofleet?.state.pictures > 1")
        page.becomes("robofleet.state.light_in_s > 0.05")  # the projector's own delay, and the page's
        page.run("robofleet.state.seen = null")
        page.becomes("robofleet.state.seen !== null")
        seconds, seen = page.run("return [robofleet.state.light_in_s, robofleet.state.seen]")
        vehicle = stand.config.members[0].vehicle
        speed = body_from_wheels(6.0, 10.0, vehicle.wheel_radius_m, vehicle.wheel_base_m)
        now = np.array([[robot.x_m, robot.y_m, robot.psi_rad] for robot in TURNING])
        assert np.array(seen) == pytest.approx(ahead(now, np.array([speed] * 4), seconds), abs=1e-3)


def test_beside_a_robot_that_stops_the_run_stands_why(browser: Chrome, stand: WebStand) -> None:
    with lit(browser, stand, STANDING) as page:
        page.fleet.phase, page.fleet.cause, page.fleet.robot = Phase.HOLD, Event.BATTERY_LOW, 2
        page.becomes("robofleet.state.robots[2]?.words.startsWith('stopped: the battery is low')")
        assert page.run("return robofleet.state.robots.map((robot) => robot.trouble)") == [0, 0, 2, 0]


@pytest.mark.parametrize(
    ("name", "words"),
    [("raw", "The projector raw is not calibrated: run robofleet calibrate projector"),
     ("left", "This run has no projector left: main, raw")],
)  # fmt: skip
def test_a_projector_that_cannot_show_says_why(browser: Chrome, stand: WebStand, name: str, words: str) -> None:
    with lit(browser, stand, STANDING, name) as page:
        page.becomes(f"document.getElementById('words').textContent === '{words}'")


def test_a_window_of_another_size_and_a_run_that_is_silent_are_told(browser: Chrome, stand: WebStand) -> None:
    with lit(browser, stand, STANDING) as page:
        page.becomes("window.robofleet?.state.pictures > 1")
        show_as(browser, (900, 540))
        page.becomes("robofleet.state.words.startsWith('This page has 900 x 540 pixels, the projector main has 960 x')")
        show_as(browser, SIZE)
        page.becomes("robofleet.state.words === ''")
        page.fleet.controlled = False
        page.becomes("robofleet.state.words === 'No link to the run. The controller is silent.'")
        assert page.run("return document.getElementById('light').hidden")
        page.fleet.controlled = True
        page.becomes("robofleet.state.words === ''")


@pytest.mark.slow
def test_an_operator_sees_who_shows_the_run_and_switches_it(browser: Chrome, stand: WebStand) -> None:
    with Fleet(stand).alive() as fleet, stand.page() as projector:
        show_as(browser, (1440, 1300))
        browser.get(stand.url)
        page = Lit(browser, stand, fleet)
        items = "document.getElementById('projection-pages').innerText.replace(/\\s+/g, ' ').trim()"
        page.becomes(
            f"{items} === 'main: no browser has it open (its page) raw: not calibrated: robofleet calibrate projector'"
        )
        assert httpx.get(page.run("return document.querySelector('#projection-pages a').href")).is_success
        projector.say(projector="main", size_px=[800, 600])
        page.becomes(f"{items}.startsWith('main: its browser shows 800 x 600 px: make it full-screen')")
        projector.say(projector="main", size_px=list(SIZE))
        page.becomes(f"{items}.startsWith('main: is shown')")
        browser.find_element(By.CSS_SELECTOR, "[data-only]").click()
        teacher = projector.next("showing", lambda frame: "large" in frame["show"])["show"]
        assert teacher == ["paths", "halos", "names", "countdown", "large"]
        page.becomes("document.querySelector('[data-only]').getAttribute('aria-pressed') === 'true'")
        browser.find_element(By.CSS_SELECTOR, "[data-show=names]").click()
        assert projector.next("showing", lambda frame: "names" not in frame["show"])["show"] == [
            "paths", "halos", "countdown", "large",
        ]  # fmt: skip
