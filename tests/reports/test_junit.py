"""A run as a CI reads it: each bound is a case; what was not judged is skipped."""

from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from robofleet.recording.run import Recording
from robofleet.reports import junit

Make = Callable[..., Any]
BOUNDS = "run.bounds={control_error_mean_mm: 1.0, path_error_mean_mm: 4, overruns: 30}"
CONTROL = "control error, mean: at most 1 mm"


@pytest.fixture
def suite(tmp_path: Path) -> Callable[..., ElementTree.Element]:
    """Return what writes a summary and reads its suite, whose counts are checked."""

    def written(summary: dict[str, Any], lost: list[str] | None = None) -> ElementTree.Element:
        junit.write(summary, lost or [], tmp_path / "bounds.xml")
        (found,) = ElementTree.parse(tmp_path / "bounds.xml").getroot()
        cases = found.findall("testcase")
        assert found.get("tests") == str(len(cases))
        for attribute, kind in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
            attributes = {"message"} if kind == "skipped" else {"message", "type"}
            assert all(set(each.attrib) == attributes for each in found.iter(kind))
            assert found.get(attribute) == str(sum(case.find(kind) is not None for case in cases))
        assert [child.tag for child in found] == ["properties", *["testcase"] * len(cases), "system-out", "system-err"]
        return found

    return written


def verdicts(suite: ElementTree.Element) -> dict[str, str]:
    return {case.get("name", ""): case[0].tag if len(case) else "passed" for case in suite.findall("testcase")}


def test_each_bound_is_a_case_with_its_value_and_its_limit(story: Make, figures: Make, suite: Make) -> None:
    run = story(BOUNDS)
    run.control_error[:] = 0.0025
    found = suite(figures(run.recording()) | {"began": "2026-01-02T03:04:05Z"})
    assert list(verdicts(found).values()) == ["passed", "failure", "passed", "passed"]
    (failure,) = found.findall(f"testcase[@name='{CONTROL}']/failure")
    assert failure.get("message") == "2.5 mm; limit 1 mm"
    values = {each.get("name"): each.get("value") for each in found.iter("property")}
    assert (values["path_error_mean_mm"], values["run.bounds.path_error_mean_mm"]) == ("0.0", "4.0")
    assert "path error, mean: 0 mm; limit 4 mm: met" in (found.findtext("system-out") or "")
    assert found.get("timestamp") == "2026-01-02T03:04:05"


@pytest.mark.parametrize(("outcome", "kind"), [("fault", "error"), ("stopped", "failure"), ("unknown", "error")])
def test_an_aborted_run_is_no_success_and_what_it_did_not_measure_is_skipped(
    story: Make, figures: Make, suite: Make, outcome: str, kind: str
) -> None:
    run = story(BOUNDS)
    found = suite(figures(run.recording(truth=False)) | {"outcome": outcome, "cause": "r1: <its> \x1b[31m & \udcff"})
    assert list(verdicts(found).values()) == [kind, "passed", "skipped", "passed"]
    (case,) = found.findall("testcase[@name='completed']")
    assert str(case[0].get("message")).startswith("r1: <its> ")
    assert set(verdicts(suite(figures(Recording(run.config)) | {"outcome": outcome})).values()) == {kind, "skipped"}


def test_what_a_completed_run_did_not_measure_has_failed(story: Make, figures: Make, suite: Make) -> None:
    found = verdicts(suite(figures(story(BOUNDS).recording(truth=False))))
    assert found["path error, mean: at most 4 mm"] == "failure"


def test_lost_results_are_an_error(story: Make, figures: Make, suite: Make) -> None:
    found = suite(figures(story(BOUNDS).recording()), ["results are lost: run.mcap"])
    assert verdicts(found)["completed"] == "error"
    assert found.findtext("system-err") == "results are lost: run.mcap"
