"""Tags of every family that a laboratory may take."""

from pathlib import Path

import numpy as np
import pytest

from robofleet.config.load import ConfigError, load_config
from robofleet.settings import FAMILIES
from robofleet.simulation.camera import SceneRenderer
from robofleet.tracking.targets import Target
from robofleet.tracking.tracker import TagTracker
from tests.tracking.test_tracker import (
    GEOMETRY,
    HEIGHT_M,
    IDS,
    MAX_SPEED,
    PERIOD_NS,
    SIDE_M,
    SIZE,
    STANDING,
    driven,
    error,
    measured,
)

PLATOON = Path(__file__).parents[2] / "configs" / "platoon.yaml"


def targets(family: str) -> list[Target]:
    return [Target(tag, SIDE_M, HEIGHT_M, MAX_SPEED, family) for tag in IDS]


@pytest.mark.parametrize("family", FAMILIES)
def test_tags_of_a_family_are_followed_and_those_of_others_are_not_there(family: str) -> None:
    renderer = SceneRenderer(GEOMETRY, SIZE, targets(family), 3.0, np.random.default_rng(2))
    trackers = {name: TagTracker(GEOMETRY, SIZE, targets(name)) for name in FAMILIES}
    for k in range(12):
        truth = driven(STANDING, 0.2, 1.5, k * PERIOD_NS * 1e-9)
        image = renderer.render(np.array(truth))
        for name, tracker in trackers.items():
            sightings = tracker.track(image, 10**9 + k * PERIOD_NS)
            seen = measured(sightings)
            assert seen.keys() == (set(IDS) if name == family else set())
            assert all(error(seen[tag], truth[i]) < 3e-4 for i, tag in enumerate(IDS) if seen)


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        (["tracker.family=36h10"], "tracker.family: "),
        (["tracker.family=16h5", "robots.2.tag=30"], "robots.2.tag: 30: the family 16h5 has the ids 0 to 29: give it"),
        (
            ["tracker.family=25h9", "tracker.floor_tags=[{tag: 35, side_m: 0.1, x_m: 0, y_m: 0}]"],
            "tracker.floor_tags.0.tag: 35: the family 25h9 has the ids 0 to 34: give it",
        ),
        (["tracker.tag_side_m=0.03"], "a cell of a 36h11 tag of 0.03 m has 1.3 px, 1.5 are needed: print it 0.035 m"),
    ],
)
def test_what_a_family_has_not_is_refused(changes: list[str], fault: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(PLATOON, changes)
    (line,) = caught.value.faults
    assert fault in line


def test_a_family_with_fewer_cells_may_be_smaller() -> None:
    load_config(PLATOON, ["tracker.tag_side_m=0.03", "tracker.family=16h5"])
