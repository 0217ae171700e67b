"""Several cameras in a configuration: what they come to, and what is refused."""

from pathlib import Path

import pytest

from robofleet.config import slices
from robofleet.config.load import ConfigError, load_config
from robofleet.runs import table
from robofleet.runs.check import refusals

EXAMPLE = Path(__file__).parents[2] / "configs" / "two-cameras.yaml"
PLATOON = EXAMPLE.with_name("platoon.yaml")


def test_each_camera_has_a_tracker_whose_camera_is_its_own() -> None:
    config = load_config(EXAMPLE)
    assert list(config.trackers) == ["tracker-left", "tracker-right"]
    for name, view in config.trackers.items():
        assert view.camera.name == name.removeprefix("tracker-")
        assert slices.build(view) == slices.build(config), "every process of a run has one build"
    commands = [process.command for process in table.processes(config) if process.row is table.TRACKER]
    assert commands == [("node", "tracker", "--camera", "left"), ("node", "tracker", "--camera", "right")]
    assert load_config(EXAMPLE, ["tracker.source=truth"]).trackers.keys() == {"tracker"}


def test_one_camera_is_the_list_of_one() -> None:
    config = load_config(PLATOON)
    assert config.camera_names == ("overhead",)
    assert list(config.trackers) == ["tracker"]


@pytest.mark.slow
def test_cameras_that_nothing_ties_together_are_refused() -> None:
    """Their frames may differ by anything: no robot, no floor and no survey would show it."""
    apart = "cameras.1.model.T_world_camera.position_m=[5.5, 0.0, 2.6]"
    found = [line for line in refusals(load_config(EXAMPLE, [apart]), lockstep=True) if line[0] == "cameras.1.model"]
    assert len(found) == 1
    assert "shares no survey" in found[0][1]
    assert not [line for line in refusals(load_config(EXAMPLE), lockstep=True) if "survey" in line[1]]


def test_tags_that_are_too_small_are_told_once_of_the_worst_camera_and_with_a_size_that_is_enough() -> None:
    higher = "cameras.1.model.T_world_camera.position_m=[1.5, 0.0, 2.9]"
    with pytest.raises(ConfigError) as error:
        load_config(EXAMPLE, ["tracker.tag_side_m=0.02", higher])
    (line,) = error.value.faults
    assert "tracker.tag_side_m" in line
    assert "right" in line
    least_m = float(line.partition("print it ")[2].split()[0])
    load_config(EXAMPLE, [f"tracker.tag_side_m={least_m}", higher])


@pytest.mark.slow_after_first
@pytest.mark.parametrize(("surveys", "count"), [(("a", "a"), 0), (("a", "b"), 1)])
def test_two_cameras_of_one_lens_share_no_survey_by_that(surveys: tuple[str, str], count: int) -> None:
    """Their files were copies, so the hashes of these are one; only the survey places them."""
    placed = [
        f"cameras.{k}.model.arena={{date: today, tool: t, figures: {{}}, "
        f"inputs: {{{name}.yaml: copied, survey.yaml: {by}}}}}"
        for k, (name, by) in enumerate(zip(("left", "right"), surveys, strict=True))
    ]
    apart = "cameras.1.model.T_world_camera.position_m=[5.5, 0.0, 2.6]"
    found = [why for _, why in refusals(load_config(EXAMPLE, [apart, *placed]), lockstep=True) if "no survey" in why]
    assert len(found) == count
