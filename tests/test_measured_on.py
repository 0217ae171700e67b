"""Guides say what their figures were measured on, in the words of TERMS.md."""

import re
from pathlib import Path

import pytest

from tests.test_readme_commands import GUIDES

TERMS = Path(__file__).parent.parent / "configs" / "TERMS.md"
FIGURE = re.compile(r"\d\.\d+ ?(mm|cm|µm|°|degrees?)(?![\w/²])")
ACCURACY = re.compile(r"\b(errors?|rms|right to|accura\w+|deviations?)\b")


def words() -> list[str]:
    table = TERMS.read_text().partition("| measured on |")[2]
    return re.findall(r"^\| ([^|]+?) \|", table, re.MULTILINE)


def claims(guide: str) -> list[str]:
    """Return the paragraphs, points and tables that tell of an accuracy."""
    return [part for part in re.split(r"\n\s*\n|\n- ", guide) if FIGURE.search(part) and ACCURACY.search(part)]


@pytest.mark.parametrize(
    "guide",
    [guide for guide in GUIDES if claims(guide.read_text())],
    ids=lambda guide: str(guide.relative_to(TERMS.parents[1])),
)
def test_a_guide_with_figures_of_accuracy_says_what_they_were_measured_on(guide: Path) -> None:
    named = re.findall(rf"[Mm]easured\s+on\s+({'|'.join(words())})\b", guide.read_text())
    assert named, f"{guide}: what was this measured on? {claims(guide.read_text())[0]}"
