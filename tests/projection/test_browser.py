"""The page that shows pictures, in Chromium: one to one, and only where it can."""

import base64
import socket
import threading
from collections.abc import Iterator
from contextlib import closing

import cv2
import numpy as np
import pytest

from robofleet.config.projectors import ProjectorSettings
from robofleet.core.clock import WallClock
from robofleet.projection.browser import BrowserDisplay
from robofleet.projection.display import DisplayError
from tests.operator.page.browser import chromium, show_as

SIZE = 320, 240


def settings() -> ProjectorSettings:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    return ProjectorSettings(name="main", width=SIZE[0], height=SIZE[1], port=port)


@pytest.fixture
def display() -> Iterator[BrowserDisplay]:
    with closing(BrowserDisplay(settings(), WallClock(), wait_s=20.0)) as opened:
        yield opened


@pytest.mark.slow
def test_a_picture_is_shown_pixel_by_pixel_when_it_is_said_to_be(display: BrowserDisplay) -> None:
    picture = np.random.default_rng(1).integers(0, 256, SIZE[::-1], dtype=np.uint8)
    with chromium() as browser:
        show_as(browser, SIZE)
        browser.get(display.address)
        for shown in (255 - picture, picture):
            before_ns = WallClock().now_ns()
            assert before_ns < display.show(shown) <= WallClock().now_ns()
            png = base64.b64decode(browser.execute_cdp_cmd("Page.captureScreenshot", {"format": "png"})["data"])
            seen = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_GRAYSCALE)
            assert np.array_equal(seen, shown)
        show_as(browser, (300, 240))
        browser.execute_async_script("requestAnimationFrame(() => requestAnimationFrame(arguments[0]))")
        with pytest.raises(DisplayError, match="shows 300 x 240 px, not 320 x 240: make it full-screen"):
            while True:  # until the page has told its new size
                display.show(picture)


def test_a_browser_that_is_away_is_told() -> None:
    away = pytest.raises(DisplayError, match="projector main: no browser has opened http://")
    with closing(BrowserDisplay(settings(), WallClock(), wait_s=0.0)) as display, away:
        display.show(np.zeros(SIZE[::-1], np.uint8))


def test_a_port_that_is_taken_is_named() -> None:
    taken = settings()
    with socket.create_server((taken.host, taken.port)), pytest.raises(DisplayError, match="mend its `host` or `port`"):
        BrowserDisplay(taken, WallClock(), wait_s=0.0)


def test_closing_ends_the_server() -> None:
    display = BrowserDisplay(settings(), WallClock(), wait_s=0.0)
    display.close()
    display.close()
    assert "display" not in [thread.name for thread in threading.enumerate()]
