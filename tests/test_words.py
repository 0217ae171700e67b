"""Names of values are nouns. A word that fits every value is none; the field's word goes before one of our own."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LINKS = ROOT / "robofleet" / "drivers", ROOT / "robofleet" / "configs"
FILES = [
    file
    for folder in ("robofleet", "drivers", "tools", "configs", "tests")
    for file in sorted((ROOT / folder).rglob("*.py"))
    if not set(LINKS) & set(file.parents)
]
FIT_EVERY_VALUE = {"said", "told", "its", "there", "of", "one", "place", "asked", "heard"}
FIT_EVERY_CLASS = {"Kept", "Told", "Part", "Place", "Memory", "View"}
OF_OUR_OWN = {  # and what the field says
    "Sighting": "measurement update", "Deciding": "behaviour runner", "Attached": "reconnecting driver",
    "Keeping": "state store", "Places": "connection limiter", "Greeting": "TLS handshake", "Ticket": "one-time token",
    "Witness": "probe", "witness": "probe", "Telling": "status scheduling",
    "Wishes": "setpoints", "wishes": "setpoints", "Hurry": "link state", "keeping": "state store",
}  # fmt: skip
BANNED = FIT_EVERY_VALUE | FIT_EVERY_CLASS | OF_OUR_OWN.keys()

# Fields of users' behaviours, of messages and of recordings: they end with the next version of interface or wire.
STANDING = {
    "robofleet/behaviours/interface.py": {"told", "of", "asked"},
    "robofleet/behaviours/track.py": {"of"},
    "robofleet/bus/messages.py": {"place", "told"},
    "robofleet/recording/columns.py": {"of"},
    "robofleet/recording/gauge.py": {"of", "asked"},
    "robofleet/recording/reading.py": {"place"},
}


def named(source: str) -> Iterator[str]:
    """Yield the names that a program gives to values and classes."""
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Name(id=name, ctx=ast.Store()) | ast.Attribute(attr=name, ctx=ast.Store()):
                yield name
            case ast.arg(arg=name) | ast.ClassDef(name=name) | ast.alias(asname=str(name)):
                yield name
            case ast.ExceptHandler(name=str(name)):
                yield name


def banned(source: str) -> set[str]:
    return {word for name in named(source) if (word := name.strip("_")) in BANNED}


@pytest.mark.slow
def test_names_say_what_they_name() -> None:
    found = {str(file.relative_to(ROOT)): banned(file.read_text()) for file in FILES}
    assert {name: words for name, words in found.items() if words} == STANDING


def test_files_are_looked_at() -> None:
    assert len(FILES) > 800


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("said = 1", {"said"}),
        ("def f(told): ...", {"told"}),
        ("for one in x: ...", {"one"}),
        ("self._heard = 1", {"heard"}),
        ("class Kept: ...", {"Kept"}),
        ("import x as there", {"there"}),
        ("class A:\n    of: int", {"of"}),
        ("def place(x): return one(x).of(x)", set()),  # a function is a verb
        ("position = 1", set()),
    ],
)
def test_a_name_is_found_wherever_it_is_given(source: str, words: set[str]) -> None:
    assert banned(source) == words
