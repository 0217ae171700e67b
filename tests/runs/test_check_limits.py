"""Two things that were proved to be able to run, and could not."""

import pytest

from robofleet.config.load import load_config
from robofleet.runs.check import refusals
from tests.shipped import PLATOON

KNOTS = "[{at_m: [0.5, 0], derivative_m: [0, 0.8]}, {at_m: [0, 0.5], derivative_m: [-0.8, 0]}, \
{at_m: [-0.5, 0], derivative_m: [0, -0.8]}, {at_m: [0, -0.5], derivative_m: [0.8, 0]}]"


def complaints(*overrides: str) -> list[str]:
    return [path for path, _ in refusals(load_config(PLATOON, overrides))]


@pytest.mark.parametrize(("tick_s", "wrong"), [(0.05, []), (0.095, ["controller.tick_s"])])
def test_a_tick_longer_than_a_command_is_valid(tick_s: float, wrong: list[str]) -> None:
    assert complaints(f"controller.tick_s={tick_s}") == wrong


@pytest.mark.parametrize(("spacing_m", "wrong"), [(0.95, []), (1.05, ["groups.0.settings.spacing_m"])])
def test_a_spacing_that_no_two_points_of_the_path_have(spacing_m: float, wrong: list[str]) -> None:
    circle = (
        f"groups.0.settings.path={{knots: {KNOTS}}}",
        "groups.0.robots=[r1, r2]",
        f"groups.0.settings.spacing_m={spacing_m}",
    )
    assert complaints(*circle) == wrong
