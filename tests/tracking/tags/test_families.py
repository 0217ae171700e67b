"""Tags of every family that a laboratory may take."""

import numpy as np
import pyapriltags
import pytest

from robofleet.config.load import ConfigError, load_config
from robofleet.core.settings import FAMILIES, FamilyName
from robofleet.simulation.camera import SceneRenderer
from robofleet.tracking.tags.families import pattern
from robofleet.tracking.tags.finder import TagFinder
from robofleet.tracking.tags.targets import Target
from robofleet.tracking.tags.tracker import TagTracker
from tests.shipped import PLATOON
from tests.tracking.library import drawn
from tests.tracking.peers import OURS, Setting, apriltag
from tests.tracking.tags.test_tracker import (
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
from tools.measure.tracking.acquisition import SCENES, evaluate
from tools.measure.tracking.certainty import Scene as Certainty
from tools.measure.tracking.certainty import certainty


def targets(family: str) -> list[Target]:
    return [Target(tag, SIDE_M, HEIGHT_M, MAX_SPEED, family) for tag in IDS]


@pytest.mark.parametrize("family", FAMILIES)
def test_each_tag_looks_as_the_apriltag_library_draws_it_half_a_turn_further(family: str) -> None:
    cells = FAMILIES[family].cells
    for tag in range(FAMILIES[family].ids):
        known = np.rot90(drawn(tag, family), 2)
        paper = (len(known) - cells) // 2
        assert np.array_equal(pattern(tag, family), known[paper : paper + cells, paper : paper + cells])


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_the_apriltag_library_sees_rendered_tags_where_they_are(family: str) -> None:
    renderer = SceneRenderer(GEOMETRY, SIZE, targets(family), 3.0, np.random.default_rng(2))
    see = apriltag(pyapriltags.Detector, 1.0)(Setting(GEOMETRY, SIZE, targets(family), 0.0))
    seen = see(renderer.render(np.array(STANDING)), 0)  # of 16h5 also tags that are not there
    for tag, (x, y, psi) in zip(IDS, STANDING, strict=True):
        (found,) = [each for each in seen if each.tag == tag and abs(complex(each.x - x, each.y - y)) < 1e-3]
        assert np.exp(1j * found.psi) == pytest.approx(np.exp(1j * psi), abs=0.02)


@pytest.mark.slow_after_first
@pytest.mark.parametrize("family", FAMILIES)
def test_surveyed_tags_of_a_family_are_found_in_an_image(family: FamilyName) -> None:
    renderer = SceneRenderer(GEOMETRY, SIZE, targets(family), 3.0, np.random.default_rng(2))
    found = TagFinder(family).find(renderer.render(np.array(STANDING)))
    assert found.keys() == set(IDS)
    for tag, (x, y, psi) in zip(IDS, STANDING, strict=True):
        (seen,) = found[tag]
        edge = complex(x, y) + SIDE_M / 2.0 * np.exp(1j * psi)
        corners = GEOMETRY.project(np.array([[x, y, HEIGHT_M], [edge.real, edge.imag, HEIGHT_M]]))
        assert seen.centre == pytest.approx(corners[0], abs=0.05)
        assert seen.ahead == pytest.approx(corners[1], abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("title", "least"), [("contrast 60", 1.0), ("contrast 20", 0.93), ("tags of 22 px", 1.0)])
def test_faint_and_small_tags_with_bits_around_are_acquired(title: str, least: float) -> None:
    row = evaluate(SCENES[title]._replace(family="Standard41h12"), [OURS], 2)[OURS]
    assert row["wrong"] == 0
    assert row["acquired"] >= least


@pytest.mark.slow
def test_tags_with_bits_around_are_placed_as_well_as_their_covariances_say() -> None:
    row = certainty(Certainty(family="Standard41h12"), 200)
    assert row["alike"] == 1.0
    assert row["rms_mm"] < 0.0105
    assert 0.75 < row["chi2_xy"] < 1.35


@pytest.mark.slow
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
        (
            ["tracker.family=Standard41h12", "robots.2.tag=2115"],
            "robots.2.tag: 2115: the family Standard41h12 has the ids 0 to 2114: give it",
        ),
        (
            ["tracker.family=Standard41h12", "tracker.tag_side_m=0.02"],
            "a cell of a Standard41h12 tag of 0.02 m has 1.37 px, 1.5 are needed: print it 0.022 m",
        ),
        (["tracker.family=Standard41h12", "tracker.tag_side_m=1.2"], "a tag of 1.2 m fills the image"),
        (["tracker.tag_side_m=0.03"], "a cell of a 36h11 tag of 0.03 m has 1.28 px, 1.5 are needed: print it 0.035 m"),
    ],
)
def test_what_a_family_has_not_is_refused(changes: list[str], fault: str) -> None:
    with pytest.raises(ConfigError) as caught:
        load_config(PLATOON, changes)
    (line,) = caught.value.faults
    assert fault in line


def test_a_family_with_fewer_cells_may_be_smaller() -> None:
    load_config(PLATOON, ["tracker.tag_side_m=0.03", "tracker.family=16h5"])
