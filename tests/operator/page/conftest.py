"""A server of the page for each test, where a file of tests has none of its own; a browser, and the page in it."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from selenium.webdriver import Chrome

from tests.operator.page.browser import chromium
from tests.operator.page.openpage import Seen, opened
from tests.operator.page.webstand import WebStand, web_stand


@pytest.fixture(autouse=True)
def no_latches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Read none that a run of this user has left."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))


@pytest.fixture
def stand(tmp_path: Path) -> Iterator[WebStand]:
    with web_stand(tmp_path, "tracker.source=truth") as stand:
        yield stand


@pytest.fixture(scope="module")
def browser() -> Iterator[Chrome]:
    with chromium() as browser:
        yield browser


@pytest.fixture
def page(browser: Chrome, stand: WebStand) -> Iterator[Seen]:
    with opened(browser, stand) as page:
        yield page
