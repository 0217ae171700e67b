"""HAZARDS.md and EVIDENCE.md: each hazard has tests and faults that exist, and its stop times are measured."""

import ast
import re
from pathlib import Path
from typing import get_args

import pytest

from robofleet.config.troubles import InjectedFault
from robofleet.core.plugins import known
from robofleet.studies.storm.schedule import KINDS
from tools.measure.robots.stop_times import NEVER, SUBJECTS, measure

TESTS = Path(__file__).parents[1]
SAFETY = TESTS.parent / "robofleet" / "safety"
TEXT = "\n".join((SAFETY / name).read_text() for name in ("HAZARDS.md", "EVIDENCE.md"))
LATER_S, FURTHER = 0.04, 0.012  # the table has the worst moment between two commands: 33 ms, and as far [m]


def table(section: str) -> list[list[str]]:
    """Return the cells of a section's table, without its head."""
    text = TEXT.split(f"\n## {section}\n")[1].split("\n## ")[0]
    return [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("|")][2:]


EVIDENCE = {number: (tests, faults) for number, tests, faults in table("What shows it")}
STOPS = {re.findall(r"`(\w+)`", row[0])[0]: row[1:] for row in table("Until a robot stands")}


@pytest.fixture(scope="module")
def nightly() -> dict[str, bool]:
    """Return the name of every test that runs, and whether it does so each night only."""
    wanted = set(re.findall(r"`(\w+)`", "".join(tests for tests, _ in EVIDENCE.values())))
    found: dict[str, bool] = {}
    for file in TESTS.rglob("test_*.py"):
        text = file.read_text()
        if wanted.isdisjoint(re.findall(r"^def test_(\w+)", text, re.M)):
            continue
        module = ast.parse(text)
        marks = [ast.unparse(n) for n in module.body if isinstance(n, ast.Assign) and "pytestmark" in ast.unparse(n)]
        for function in module.body:
            if isinstance(function, ast.FunctionDef):
                own = " ".join([*marks, *(ast.unparse(d).split("(")[0] for d in function.decorator_list)])
                if not re.search(r"mark\.skip\b", own):
                    found[function.name.removeprefix("test_")] = "mark.long" in own
    return found


def test_every_hazard_has_its_evidence() -> None:
    assert sorted(n for numbers in EVIDENCE for n in numbers.split(", ")) == sorted(row[0] for row in table("Hazards"))


@pytest.mark.parametrize("number", EVIDENCE)
def test_the_tests_of_a_hazard_are_there_and_one_of_them_runs_before_a_merge(
    number: str, nightly: dict[str, bool]
) -> None:
    tests = EVIDENCE[number][0]
    if tests != "not shown":
        stated = {name: night == " (N)" for name, night in re.findall(r"`(\w+)`( \(N\))?", tests)}
        assert stated == {name: nightly.get(name) for name in stated}
        assert not all(stated.values())


def test_every_fault_is_one_of_a_hazard_and_the_storms_are_told_from_the_others() -> None:
    every = {
        kind
        for fault in get_args(get_args(InjectedFault)[0])
        for kind in get_args(fault.model_fields["kind"].annotation)
    }
    stated = ", ".join(faults for _, faults in EVIDENCE.values())
    others = set(re.findall(r"`(\w+)`", "".join(re.findall(r"\([^)]*\)", stated))))
    assert set(re.findall(r"`(\w+)`", stated)) == every
    assert others == every - set(KINDS)


def test_every_kind_of_robot_has_its_stop_times() -> None:
    assert set(known("robofleet.drivers")) <= STOPS.keys()
    assert {kind for kind, cells in STOPS.items() if cells[0] != "not measured"} == SUBJECTS.keys()


@pytest.mark.slow
@pytest.mark.parametrize("kind", SUBJECTS)
def test_a_robot_stands_as_soon_as_the_table_says(kind: str) -> None:
    cells = STOPS[kind]
    stated = dict(zip(("latched", "silent", "killed", "frozen", "gone"), cells, strict=True))
    if " in the middle of a line " in stated["gone"]:
        stated["gone"], stated["cut"] = stated["gone"].split("; in the middle of a line ")
    for event, cell in stated.items():
        done = measure(SUBJECTS[kind], event)
        if "never" in cell:
            assert done == NEVER
            continue
        seconds, millimetres = (float(figure.split()[0]) for figure in cell.split(", "))
        assert seconds - LATER_S <= done.seconds <= seconds + 0.005, event
        assert millimetres * 1e-3 - FURTHER <= done.metres <= millimetres * 1e-3 + 0.0005, event
