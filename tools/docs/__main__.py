"""Build the site of all guides, the public interface and the paper's equations.

python -m tools.docs --out build/site

Guides stay where they are. A source that a guide links to becomes a page, too. A link, an anchor or a picture that is
not there ends the build with exit code 1. Pages load nothing from elsewhere, and work without a server.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from tools.packages import needing

with needing("docs"):
    import yaml
    import zensical  # noqa: F401 - run below
    from latex2mathml.converter import convert

    import robofleet

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
FOLDERS = "configs", "drivers", "robofleet", "tests", "tools"
_PAGES = ".md", ".gif", ".ipynb", ".jpg", ".png", ".svg"  # the others become pages
_LINK = re.compile(r"^```.*?^```|`[^`\n]*`|(?<=\]\()(?P<path>[^)\s#:]+)(?=[)#])", re.MULTILINE | re.DOTALL)
_FORMULA = re.compile(r"^```math\n(?P<block>.*?)^```|\$`(?P<inline>.*?)`\$", re.MULTILINE | re.DOTALL)
_ROOMS = {  # of public names
    "scripts": "Scripts",
    "reports": "Recorded runs", "behaviours": "Behaviours", "vehicles": "Robots and their drivers",
    "tracking": "Cameras and pose sources", "control": "Laws",
}  # fmt: skip


def main() -> None:
    """Build the site into a folder; exit code 1 where something is not there."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--out", type=Path, default=ROOT / "build/site", metavar="DIR", help="What is there is replaced."
    )
    out: Path = parser.parse_args().out
    if out.exists() and not (out / "404.html").is_file():
        parser.error(f"--out: {out} is there, and is no site: name a new folder")
    with tempfile.TemporaryDirectory() as folder:
        pages = Path(folder, "pages")
        guides = [*ROOT.glob("*.md"), *(guide for name in FOLDERS for guide in (ROOT / name).rglob("*.md"))]
        files = {file for guide in guides for file in _write_page(guide, pages)} - {*guides}
        for file in files:
            _write_file(file, pages)
        _write_reference(pages / "reference")
        for name in ("extra.css", "extra.js", "iframe-worker.js"):
            shutil.copy(HERE / name, pages)
        nav = _Nav(pages).of(yaml.safe_load((HERE / "nav.yml").read_text()))
        config = Path(folder, "mkdocs.yml")
        config.write_text((HERE / "mkdocs.yml").read_text() + yaml.safe_dump({"nav": nav}))
        subprocess.run([sys.executable, "-m", "zensical", "build", "--strict", "-f", config], check=True)
        missing = [*troubles(Path(folder, "site"))]
        for trouble in missing:
            print(trouble, file=sys.stderr)
        if missing:
            raise SystemExit(1)
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(Path(folder, "site"), out)
    size = sum(file.stat().st_size for file in out.rglob("*") if file.is_file())
    print(f"{out / 'index.html'}: {len([*out.rglob('*.html')])} pages, {size / 1e6:.1f} MB")


def _write_page(guide: Path, pages: Path) -> Iterator[Path]:
    """Write a guide's page, and yield the files that it links to."""
    files = []

    def relinked(match: re.Match[str]) -> str:
        if not match["path"]:
            return match[0]  # code
        file = (guide.parent / unquote(match["path"])).resolve()
        file = file / "README.md" if file.is_dir() else file
        if not file.is_relative_to(ROOT) or not file.exists():
            return match[0]  # the check of the site names it
        files.append(file)
        return os.path.relpath(_page_of(file), guide.parent)

    def formula(match: re.Match[str]) -> str:
        return convert(match["block"], display="block") if match["block"] else convert(match["inline"])

    page = pages / guide.relative_to(ROOT)
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(_LINK.sub(relinked, _FORMULA.sub(formula, guide.read_text())))
    yield from files


def _write_file(file: Path, pages: Path) -> None:
    """Copy a picture, or write a page that shows a source; the search leaves sources out."""
    page = pages / _page_of(file).relative_to(ROOT)
    page.parent.mkdir(parents=True, exist_ok=True)
    if file.suffix in _PAGES:
        shutil.copy(file, page)
    else:
        head = f"---\nsearch: {{exclude: true}}\n---\n\n# {file.relative_to(ROOT)}\n\n"
        page.write_text(f"{head}````{file.suffix[1:]}\n{file.read_text()}\n````\n")


def _page_of(file: Path) -> Path:
    """Return where a file of the project stands among the pages; a folder whose name begins with a dot is not built."""
    name = str(file.relative_to(ROOT)).removeprefix(".")
    return ROOT / (name if file.suffix in _PAGES else f"{name}.md")


def _write_reference(folder: Path) -> None:
    """Write the pages of the public names, one for each room, which mkdocstrings fills."""
    folder.mkdir()
    rooms: dict[str, list[str]] = {}
    for name in sorted(set(robofleet.__all__) - {"__version__"}):
        room = robofleet._MODULES[name].split(".")[1]
        rooms.setdefault(_ROOMS.get(room, "More"), []).append(name)
    for title, names in rooms.items():
        page = folder / f"{title.lower().replace(' ', '-')}.md"
        page.write_text(f"# {title}\n\n" + "".join(f"::: robofleet.{name}\n\n" for name in names))
    (folder / "testing.md").write_text("# Testing\n\n::: robofleet.testing\n    options: {show_root_heading: false}\n")


class _Nav:
    """Fills in the pages of folders."""

    def __init__(self, pages: Path) -> None:
        self._pages = pages
        self._named: set[str] = set()

    def of(self, entries: Any) -> Any:
        """Return the entries, with a list of pages in place of each folder."""
        self._named |= {*_names(entries)}
        filled = [(title, self._filled(entry)) for item in entries for title, entry in item.items()]
        return [{title: entry} for title, entry in filled if entry]

    def _filled(self, entry: Any) -> Any:
        if isinstance(entry, list):
            return self.of(entry)
        if not entry.endswith("/"):
            return entry
        inside = {str(page.relative_to(self._pages)) for page in (self._pages / entry).rglob("*.md")}
        sources = {name for name in inside if "." in Path(name).stem or Path(name).stem == "LICENSE"}
        return sorted(inside - sources - self._named, key=lambda name: (name.count("/"), name))


def _names(entry: Any) -> Iterator[str]:
    if isinstance(entry, str):
        yield entry
    else:
        for part in entry if isinstance(entry, list) else entry.values():
            yield from _names(part)


class _Html(HTMLParser):
    """The anchors of a page, what it links to, and what it loads."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.links: set[str] = set()
        self.loaded: set[str] = set()
        self.feed(page.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value for name, value in attrs if value}
        self.anchors |= {values[name] for name in ("id", "name") if name in values}
        if link := values.get("href") or values.get("src"):
            (self.links if tag == "a" else self.loaded).add(link)


def troubles(site: Path) -> Iterator[str]:
    """Yield a line for each link, anchor or picture that is not there, and for what is loaded from elsewhere."""
    parsed = cache(_Html)
    for page in sorted(site.rglob("*.html")):
        if page.name == "404.html":  # has no folder of its own
            continue
        html = parsed(page)
        for link in sorted(html.links | html.loaded):
            url = urlsplit(link)
            target = (page.parent / unquote(url.path)).resolve() if url.path else page
            target = target / "index.html" if target.is_dir() else target
            where = f"{page.relative_to(site)}: {link}"
            if url.scheme or url.netloc:
                if link in html.loaded and url.scheme != "data":
                    yield f"{where} is loaded from elsewhere"
            elif not target.is_file():
                yield f"{where} is not there"
            elif url.fragment and target.suffix == ".html" and unquote(url.fragment) not in parsed(target).anchors:
                yield f"{where}: its page has no such anchor"


if __name__ == "__main__":
    main()
