"""What a person should know of a run beside its figures."""

from typing import Any

import pytest

from robofleet.config.load import load_config
from robofleet.reports.metrics import remarks
from tests.shipped import PLATOON


def errors(timed_mm: float, control_mm: float) -> dict[str, Any]:
    return {"platoon": {"timed_error_mm": {"mean": timed_mm}, "control_error_mm": {"mean": control_mm}}}


def test_robots_that_are_not_at_their_goals_are_named() -> None:
    off = {"r3": {"distance_to_goal_mm": 2.31, "heading_error_deg": 1.44}}
    (line,) = remarks(load_config(PLATOON), {"go_to": {"not_at_goal": off}})
    assert line == "go_to: not within the accuracy of their goals: r3 2.3 mm and 1.4 degrees"
    assert remarks(load_config(PLATOON), {"go_to": {"not_at_goal": {}}, "other": {"not_at_goal": None}}) == []


def test_where_a_robot_is_not_where_its_law_takes_it_the_estimate_is_named() -> None:
    (line,) = remarks(load_config(PLATOON), errors(7.8, 0.2))
    assert line.startswith("the timed error is 7.8 mm, the control error 0.2 mm:")
    assert "`controller.disturbance: estimated`" in line


@pytest.mark.slow
@pytest.mark.parametrize(
    ("figures", "changes"),
    [
        (errors(1.5, 0.2), []),
        (errors(7.8, 5.0), []),
        (errors(7.8, 0.2), ["controller.disturbance=estimated"]),
        ({"platoon": {"timed_error_mm": None, "control_error_mm": None}}, []),
    ],
    ids=["as at home", "the law lags", "it is estimated", "not measured"],
)
def test_where_it_would_not_help_it_is_not_named(figures: dict[str, Any], changes: list[str]) -> None:
    assert remarks(load_config(PLATOON, changes), figures) == []
