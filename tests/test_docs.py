"""The site of all guides: what is missing ends its build, it loads nothing from elsewhere, and axe finds nothing."""

import importlib.util
import subprocess
import sys
from _thread import interrupt_main
from collections.abc import Iterator
from pathlib import Path
from threading import Thread
from urllib.request import urlopen

import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.support.ui import WebDriverWait

from robofleet.operator import docs_command
from tests.command import robofleet
from tests.operator.page import axe, browser

ROOT = Path(__file__).parents[1]
needs_builder = pytest.mark.skipif(
    importlib.util.find_spec("zensical") is None, reason="NO DOCS: pip install -e '.[docs]'"
)
IN_SEARCH = """return [...document.querySelectorAll("div")].map(box => box.shadowRoot).filter(Boolean)
    .flatMap(root => [...root.querySelectorAll(arguments[0])].map(found => found.href || found.type));"""
LOOKED_AT = (
    "index.html",
    "configs/LESSON.html",
    "configs/keys/camera.html",
    "reference/scripts.html",
    "robofleet/control/EQUATIONS.html",
)
ASKED = {  # a page or an answer that the search finds first, or nearly so
    "two arenas on one computer": "QUESTIONS.html",
    "camera height": "QUESTIONS.html",
    "headless": "QUESTIONS.html",
    "metric of my own": "QUESTIONS.html",
    "video": "QUESTIONS.html",
    "wi-fi": "QUESTIONS.html",
    "uninstall": "QUESTIONS.html",
    "gpu": "QUESTIONS.html",
    "reproduce a run": "QUESTIONS.html",
    "lens calibration": "calibration/index.html",
}  # fmt: skip


@needs_builder
@pytest.mark.parametrize(
    ("text", "trouble"),
    [
        ('<a href="b.html#there">', None),
        ('<a href="b.html#nowhere">', "a.html: b.html#nowhere: its page has no such anchor"),
        ('<a href="c.html">', "a.html: c.html is not there"),
        ('<img src="picture.jpg">', "a.html: picture.jpg is not there"),
        ('<script src="https://example.org/x.js">', "a.html: https://example.org/x.js is loaded from elsewhere"),
        ('<a href="https://example.org">', None),
    ],
)
def test_what_is_not_there_is_named(tmp_path: Path, text: str, trouble: str | None) -> None:
    from tools.docs.__main__ import troubles

    (tmp_path / "a.html").write_text(text)
    (tmp_path / "b.html").write_text('<h2 id="there">')
    assert [*troubles(tmp_path)] == ([trouble] if trouble else [])


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build it once; a broken link in any guide fails here."""
    out = tmp_path_factory.mktemp("site") / "site"
    subprocess.run([sys.executable, "-m", "tools.docs", "--out", out], cwd=ROOT, check=True, timeout=600)
    return out


@pytest.fixture(scope="module")
def chromium() -> Iterator[Chrome]:
    with browser.chromium() as opened:
        yield opened


@needs_builder
@pytest.mark.slow
def test_every_guide_and_every_public_name_has_its_place(site: Path) -> None:
    import robofleet

    guides = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True)
    for guide in guides.stdout.split():
        assert (site / guide.replace("README.md", "index.html").replace(".md", ".html")).is_file(), guide
    reference = "".join(page.read_text() for page in (site / "reference").glob("*.html"))
    assert [name for name in robofleet.__all__ if f'id="robofleet.{name}"' not in reference] == ["__version__"]
    assert (site / "robofleet/control/EQUATIONS.html").read_text().count("<math") > 20


@needs_builder
@pytest.mark.slow
@pytest.mark.parametrize("page", LOOKED_AT)
def test_axe_finds_nothing(site: Path, chromium: Chrome, page: str) -> None:
    for size in (browser.DESKTOP, browser.PHONE):
        for scheme in ("light", "dark"):
            browser.show_as(chromium, size)
            browser.show_in(chromium, scheme)
            chromium.get((site / page).as_uri())
            chromium.execute_script("localStorage.clear()")
            chromium.refresh()
            assert axe.violations(chromium) == []


@needs_builder
@pytest.mark.slow
@pytest.mark.parametrize(("question", "answer"), ASKED.items())
def test_the_search_finds_the_answer(site: Path, chromium: Chrome, question: str, answer: str) -> None:
    browser.show_as(chromium, browser.DESKTOP)
    chromium.get((site / "index.html").as_uri())
    patient = WebDriverWait(chromium, 60)
    patient.until(lambda page: page.find_element("css selector", ".md-search__button")).click()
    patient.until(lambda page: page.execute_script(IN_SEARCH, "input"))
    chromium.switch_to.active_element.send_keys(question)
    patient.until(lambda page: any(answer in link for link in page.execute_script(IN_SEARCH, "a[role=option]")[:3]))


def test_docs_serves_the_site_of_a_wheel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(docs_command, "SITE", tmp_path)
    refused = robofleet("docs")
    assert (refused.exit_code, refused.stderr.count("\n")) == (2, 1)
    assert "python -m tools.docs" in refused.stderr
    (tmp_path / "index.html").write_text("all guides")
    read = []

    def reader(address: str) -> None:
        with urlopen(address) as page:
            read.append(page.read())
        interrupt_main()

    monkeypatch.setattr(docs_command, "open_page", lambda address: Thread(target=reader, args=[address]).start())
    done = robofleet("docs")
    assert (done.exit_code, read) == (0, [b"all guides"])
