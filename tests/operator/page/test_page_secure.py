"""The operator's page beyond this computer in a real browser: what an operator and what a viewer has of it."""

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import cv2
import numpy as np
import pytest
from selenium.webdriver import ActionChains, Chrome
from selenium.webdriver.common.by import By

from tests.operator.page.axe import violations
from tests.operator.page.browser import DESKTOP, PHONE, show_as
from tests.operator.page.openpage import Seen, opened
from tests.operator.page.secureweb import HOST, keys_in
from tests.operator.page.webstand import WebStand, web_stand

pytestmark = pytest.mark.slow

TALL = 1440, 1700  # all of it is in sight


@pytest.fixture
def stand(browser: Chrome, tmp_path: Path) -> Iterator[WebStand]:
    with web_stand(tmp_path, host=HOST, keys=keys_in(tmp_path / "keys")) as stand:
        yield stand
        browser.delete_all_cookies()


@pytest.fixture
def operator(browser: Chrome, stand: WebStand) -> Iterator[Seen]:
    with opened(browser, stand) as page:
        yield page


@pytest.fixture
def viewer(browser: Chrome, stand: WebStand) -> Iterator[Seen]:
    with opened(browser, stand, stand.addresses.viewer) as page:
        yield page


def drawn(page: Seen) -> set[str]:
    """Return the run's controls that can be seen."""
    buttons = page.browser.find_elements(By.CSS_SELECTOR, "#run-controls button")
    return {str(button.get_attribute("data-do")) for button in buttons if button.is_displayed()}


def complaints(page: Seen) -> list[str]:
    """Return what the browser complains of, but that it does not know the authority."""
    return [line["message"] for line in page.browser.get_log("browser") if line["level"] != "INFO"]


def test_a_viewer_has_the_controls_that_stop_and_no_others(viewer: Seen) -> None:
    assert viewer.run("return location.pathname + location.search") == "/", "the address that let it in is gone"
    assert drawn(viewer) == {"hold"}
    assert viewer.shown("viewer-note")
    assert not viewer.shown("invite-panel")
    assert viewer.run("return document.cookie") == "", "no script reads the cookie"
    viewer.becomes(lambda: viewer.enabled() == {"hold", "stop"})
    viewer.press("hold")
    viewer.becomes(lambda: viewer.stand.requests == [b"hold"])
    ActionChains(viewer.browser).send_keys(" ").perform()
    viewer.becomes(lambda: b"estop" in viewer.stand.requests)
    assert complaints(viewer) == []


def test_an_operator_has_all_controls_and_invites_a_phone(operator: Seen, browser: Chrome) -> None:
    assert drawn(operator) == {"arm", "start", "hold", "resume", "stop", "reset"}
    assert not operator.shown("viewer-note")
    browser.find_element(By.CSS_SELECTOR, "[data-invite=viewer]").click()
    operator.becomes(lambda: operator.shown("invite-shown"))
    address = operator.text("invite-address")
    assert address.startswith(f"https://{operator.stand.authority}/open?once=")
    operator.becomes(lambda: operator.run("return document.getElementById('invite-code').naturalWidth > 0"))
    show_as(browser, TALL)
    code = browser.find_element(By.ID, "invite-code").screenshot_as_png
    image = cv2.imdecode(np.frombuffer(code, np.uint8), cv2.IMREAD_GRAYSCALE)
    text, *_ = cv2.QRCodeDetector().detectAndDecode(image)
    assert text == address
    assert complaints(operator) == []
    browser.delete_all_cookies()  # as another browser has none
    with opened(browser, operator.stand, address) as page:
        assert drawn(page) == {"hold"}


def test_a_page_that_is_loaded_again_is_still_in(operator: Seen) -> None:
    operator.browser.refresh()
    operator.becomes(lambda: operator.run("return window.robofleet?.state.drawn > 2"))
    operator.browser.get(operator.stand.url)
    operator.becomes(lambda: operator.run("return window.robofleet?.state.drawn > 2"))


def test_a_second_browser_reads_what_to_do(operator: Seen, browser: Chrome) -> None:
    browser.delete_all_cookies()
    for path, title in ("", "This browser is not logged in"), (operator.stand.url, "This address has opened its page"):
        browser.get(path or f"https://{operator.stand.authority}/")
        assert browser.find_element(By.TAG_NAME, "h1").text.startswith(title)
        assert "robofleet web --host" in browser.find_element(By.TAG_NAME, "main").text


@contextmanager
def another_site(address: str) -> Iterator[str]:
    """Serve a page with a link to an address, as a chat or a mail has one."""
    link = f'<!doctype html><title>mail</title><a id="link" href="{address}">the page</a>'.encode()
    answer = b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nConnection: close\r\n\r\n" + link
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answered() -> None:
            while True:
                try:
                    client, _ = server.accept()
                except OSError:
                    return
                with client:
                    client.recv(65536)
                    client.sendall(answer)

        thread = threading.Thread(target=answered)
        thread.start()
        try:
            yield f"http://localhost:{server.getsockname()[1]}/"
        finally:
            server.shutdown(socket.SHUT_RDWR)
            thread.join()


def test_a_link_on_another_site_lets_in_too(browser: Chrome, stand: WebStand) -> None:
    show_as(browser, DESKTOP)
    with another_site(stand.addresses.viewer) as site:
        browser.get(site)
        browser.find_element(By.ID, "link").click()
        page = Seen(browser, stand, None)  # type: ignore[arg-type]
        page.becomes(lambda: urlsplit(browser.current_url).path == "/" and page.shown("viewer-note"))


@pytest.mark.parametrize("size", [DESKTOP, PHONE])
def test_axe_finds_nothing_in_what_the_roles_add(operator: Seen, browser: Chrome, size: tuple[int, int]) -> None:
    show_as(browser, size)
    operator.run("document.querySelector('[data-invite=operator]').click()")
    operator.becomes(lambda: operator.shown("invite-shown"))
    assert violations(browser) == []
    assert operator.run("return document.documentElement.scrollWidth") <= size[0]
