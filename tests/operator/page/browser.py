"""A real Chromium, without a window, for tests that look at the operator's page."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from selenium.webdriver import Chrome, ChromeOptions, ChromeService

DESKTOP = 1440, 900
PHONE = 390, 844
LYING = 844, 390  # a phone on its side
_FLAGS = "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-background-networking"
_NEEDS = "chromium", "chromedriver"


@contextmanager
def chromium() -> Iterator[Chrome]:
    """Open a browser, or skip the test and say why."""
    browser, driver = (shutil.which(name) for name in _NEEDS)
    if browser is None or driver is None:
        pytest.skip(f"NO BROWSER: the operator's page is not tested: install Debian's {' and '.join(_NEEDS)}")
    options = ChromeOptions()
    options.binary_location = browser
    for flag in _FLAGS:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    options.accept_insecure_certs = True  # it does not know the authority of a test's arena
    opened = Chrome(options=options, service=ChromeService(driver))
    opened.set_script_timeout(10)
    try:
        yield opened
    finally:
        opened.quit()


def show_as(browser: Chrome, size: tuple[int, int]) -> None:
    """Give the browser's window a size; a phone's has fingers."""
    width, height = size
    phone = size in (PHONE, LYING)
    metrics: dict[str, Any] = {
        "width": width,
        "height": height,
        "screenWidth": width,
        "screenHeight": height,
        "deviceScaleFactor": 2 if phone else 1,
        "mobile": phone,
    }
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": phone, "maxTouchPoints": 2})


def show_in(browser: Chrome, scheme: str) -> None:
    """Prefer a ``light`` or a ``dark`` scheme."""
    feature = {"name": "prefers-color-scheme", "value": scheme}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
