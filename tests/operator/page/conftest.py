"""A browser, and the page in it of the stand that a file of tests has."""

from collections.abc import Iterator

import pytest
from selenium.webdriver import Chrome

from tests.operator.page.browser import chromium
from tests.operator.page.openpage import Seen, opened
from tests.operator.page.webstand import WebStand


@pytest.fixture(scope="module")
def browser() -> Iterator[Chrome]:
    with chromium() as browser:
        yield browser


@pytest.fixture
def page(browser: Chrome, stand: WebStand) -> Iterator[Seen]:
    with opened(browser, stand) as page:
        yield page
