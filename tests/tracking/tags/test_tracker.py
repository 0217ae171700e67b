"""The tracker on rendered images of robots whose motion is known."""

import math
from collections.abc import Sequence

import numpy as np
import pytest
from numpy.typing import NDArray

from robofleet.simulation.camera import SceneRenderer
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.events import TrackerEvent
from robofleet.tracking.tags.deep import DeepSearch
from robofleet.tracking.tags.detection import Findings
from robofleet.tracking.tags.targets import Target
from robofleet.tracking.tags.tracker import Sightings, TagSighting, TagTracker
from tests.shipped import OVERHEAD

GEOMETRY = CameraGeometry.from_model(OVERHEAD)
SIZE = (OVERHEAD.width, OVERHEAD.height)
SIDE_M, HEIGHT_M, MAX_SPEED = 0.07, 0.08, 0.2
IDS = (1, 2, 3)
PERIOD_NS = 33_000_000
SWEEP = 12  # images

Pose = tuple[float, float, float]
STANDING: list[Pose] = [(-0.6, 0.2, 0.4), (0.1, -0.3, 2.0), (0.7, 0.4, -1.0)]
GONE = (math.nan, math.nan, math.nan)


def scene(ids: tuple[int, ...] = IDS) -> SceneRenderer:
    targets = [Target(tag, SIDE_M, HEIGHT_M, MAX_SPEED) for tag in ids]
    return SceneRenderer(GEOMETRY, SIZE, targets, 3.0, np.random.default_rng(2))


@pytest.fixture(scope="module")
def renderer() -> SceneRenderer:
    return scene()


class Watched:
    """A tracker with its clock, and all that it said."""

    def __init__(self) -> None:
        self.tracker = TagTracker(GEOMETRY, SIZE, [Target(tag, SIDE_M, HEIGHT_M, MAX_SPEED) for tag in IDS])
        self.now_ns = 10**9
        self.news: list[tuple[TrackerEvent, int]] = []

    def look(self, image: NDArray[np.uint8]) -> Sightings:
        self.now_ns += PERIOD_NS
        sightings = self.tracker.track(image, self.now_ns)
        self.news += [(event, tag) for event, tag, _ in sightings.happenings]
        return sightings

    def at(self, renderer: SceneRenderer, poses: Sequence[Pose], times: int = 1) -> list[Sightings]:
        return [self.look(renderer.render(np.array(poses))) for _ in range(times)]


def driven(poses: Sequence[Pose], v: float, omega: float, t: float) -> list[Pose]:
    """Where robots are that have driven on their arcs for t."""
    half = omega * t / 2
    chord = v * t * np.sinc(half / math.pi)
    return [(x + chord * math.cos(psi + half), y + chord * math.sin(psi + half), psi + 2 * half) for x, y, psi in poses]


def measured(sightings: Sightings) -> dict[int, TagSighting]:
    return {pose.tag: pose for pose in sightings.poses if pose.coasted_ns == 0}


def error(seen: TagSighting, truth: Pose) -> float:
    return math.hypot(seen.x - truth[0], seen.y - truth[1])


def test_driving_robots_are_followed(renderer: SceneRenderer) -> None:
    watched, errors, turned = Watched(), [], []
    for k in range(40):
        truth = driven(STANDING, 0.2, 1.5, k * PERIOD_NS * 1e-9)
        (sightings,) = watched.at(renderer, truth)
        seen = measured(sightings)
        assert seen.keys() == set(IDS)
        errors += [error(seen[tag], truth[i]) for i, tag in enumerate(IDS)]
        turned += [math.remainder(seen[tag].psi - truth[i][2], math.tau) for i, tag in enumerate(IDS)]
    assert np.sqrt(np.mean(np.square(errors))) < 5e-5
    assert np.degrees(np.sqrt(np.mean(np.square(turned)))) < 0.08
    assert sorted(watched.news) == [(TrackerEvent.TAG_FOUND, tag) for tag in IDS]


def test_a_robot_that_brakes_and_turns_round_is_not_lost(renderer: SceneRenderer) -> None:
    watched = Watched()
    watched.at(renderer, STANDING)
    t = 0.0
    for k in range(30):
        t += PERIOD_NS * 1e-9 * (1 if k < 15 else -1)  # from one image to the next: 0.4 m/s and 3 rad/s of change
        truth = driven(STANDING, 0.2, 1.5, t)
        (sightings,) = watched.at(renderer, truth)
        assert all(error(measured(sightings)[tag], truth[i]) < 3e-4 for i, tag in enumerate(IDS))


def test_a_hidden_robot_is_predicted_for_a_while_then_lost_then_found_again(renderer: SceneRenderer) -> None:
    watched, ages, found_after = Watched(), [], []
    for k in range(60):
        truth = driven(STANDING, 0.1, 0.5, k * PERIOD_NS * 1e-9)
        shown = [GONE, *truth[1:]] if 10 <= k < 40 else truth
        (sightings,) = watched.at(renderer, shown)
        seen = {pose.tag: pose for pose in sightings.poses}
        assert {2, 3} <= measured(sightings).keys()
        if 10 <= k < 40 and 1 in seen:
            ages.append(seen[1].coasted_ns)
            assert error(seen[1], truth[0]) < 0.01
        if k >= 40 and 1 in measured(sightings):
            found_after.append(k)
    assert ages == [PERIOD_NS * (i + 1) for i in range(len(ages))]
    assert 0.4e9 < ages[-1] <= 0.5e9
    assert found_after[0] <= 40 + SWEEP
    assert watched.news[3:] == [(TrackerEvent.TAG_LOST, 1), (TrackerEvent.TAG_FOUND, 1)]


def test_a_robot_behind_something_small_is_found_in_the_next_image(renderer: SceneRenderer) -> None:
    watched = Watched()
    watched.at(renderer, STANDING, 5)
    (hidden,) = watched.at(renderer, [GONE, *STANDING[1:]])
    assert [pose.tag for pose in hidden.poses if pose.coasted_ns] == [1]
    (back,) = watched.at(renderer, driven(STANDING, 0.2, 0.0, 2 * PERIOD_NS * 1e-9))
    assert measured(back).keys() == set(IDS)


def beside_where_two_tiles_meet() -> list[Pose]:
    x, y = GEOMETRY.to_plane(np.array([[SIZE[0] / 4, SIZE[1] / 2]]), HEIGHT_M)[0]
    return [(x, y, 0.3), (x - 0.3, y, 1.0), STANDING[2]]


@pytest.mark.slow
@pytest.mark.parametrize(
    "acts",
    [
        [(STANDING, 3 * SWEEP)],
        [([GONE, GONE, STANDING[2]], 3), (STANDING, 8 * SWEEP)],
        [(beside_where_two_tiles_meet(), 8 * SWEEP)],
        [(STANDING, 2 * SWEEP), ([GONE, *STANDING[1:]], 20 * SWEEP)],
    ],
    ids=["from the beginning", "newcomers", "in two tiles", "one is covered"],
)
def test_of_two_prints_with_one_id_neither_is_believed(acts: list[tuple[list[Pose], int]]) -> None:
    twins, watched = scene((1, 1, 2)), Watched()
    for poses, images in acts:
        for sightings in watched.at(twins, poses, images):
            assert measured(sightings).keys() == {2}
            assert sightings.refused <= 2
    assert (TrackerEvent.TAG_TWICE, 1) in watched.news


@pytest.mark.slow
def test_a_second_print_that_appears_later_is_refused_and_the_robot_followed_on() -> None:
    twins, watched = scene((1, 1, 2)), Watched()
    for k in range(4 * SWEEP):
        robot = driven(STANDING[:1], 0.1, 0.3, k * PERIOD_NS * 1e-9)[0]
        (sightings,) = watched.at(twins, [robot, STANDING[1] if k > 5 else GONE, STANDING[2]])
        assert error(measured(sightings)[1], robot) < 3e-4
    assert set(watched.news[2:]) == {(TrackerEvent.TAG_TWICE, 1)}
    assert len(watched.news) <= 4  # said once a second, not in every image


def test_a_tag_that_jumps_is_refused_until_it_stays(renderer: SceneRenderer) -> None:
    watched = Watched()
    watched.at(renderer, STANDING, 5)
    moved = (-0.6, -0.5, 1.0)
    believed = 0
    for k in range(10 * SWEEP):
        (sightings,) = watched.at(renderer, [moved, *STANDING[1:]])
        if 1 in measured(sightings):
            believed = believed or k
            assert error(measured(sightings)[1], moved) < 3e-4
    assert believed * PERIOD_NS > 2.5e9  # the supervisor has ended the run by then
    events = [event for event, tag in watched.news if tag == 1]
    assert events[:2] == [TrackerEvent.TAG_FOUND, TrackerEvent.TAG_JUMPED]
    assert TrackerEvent.TAG_LOST in events
    assert events[-1] is TrackerEvent.TAG_CARRIED


@pytest.mark.slow
def test_two_tags_that_are_exchanged_are_not_believed_at_once(renderer: SceneRenderer) -> None:
    watched = Watched()
    watched.at(renderer, STANDING, 5)
    exchanged = [STANDING[1], STANDING[0], STANDING[2]]
    for sightings in watched.at(renderer, exchanged, SWEEP):
        assert measured(sightings).keys() == {3}
    assert {(TrackerEvent.TAG_MISTAKEN, 1), (TrackerEvent.TAG_MISTAKEN, 2)} <= set(watched.news)
    last = watched.at(renderer, exchanged, 12 * SWEEP)[-1]
    assert all(error(measured(last)[tag], exchanged[i]) < 3e-4 for i, tag in enumerate(IDS))


def test_a_newcomer_is_found_within_three_sweeps(renderer: SceneRenderer) -> None:
    watched = Watched()
    watched.at(renderer, [*STANDING[:2], GONE], 40)
    sightings = watched.at(renderer, STANDING, 3 * SWEEP)
    assert 3 not in measured(sightings[0])  # a second print of it could be elsewhere
    assert error(measured(sightings[-1])[3], STANDING[2]) < 3e-4


@pytest.mark.slow
def test_in_the_dark_robots_are_followed_on(renderer: SceneRenderer) -> None:
    rng, watched = np.random.default_rng(1), Watched()
    for k in range(20):
        truth = driven(STANDING, 0.2, 1.0, k * PERIOD_NS * 1e-9)
        image = renderer.render(np.array(truth)).astype(float)
        dark = 0.15 * image + rng.normal(0.0, 3.0, image.shape) if k > 2 else image
        sightings = watched.look(np.clip(dark, 0, 255).astype(np.uint8))
        assert all(error(measured(sightings)[tag], truth[i]) < 5e-4 for i, tag in enumerate(IDS))


def test_a_flash_that_hides_everything_is_survived(renderer: SceneRenderer) -> None:
    watched = Watched()
    watched.at(renderer, STANDING, 3)
    for _ in range(5):
        blind = watched.look(np.full((OVERHEAD.height, OVERHEAD.width), 255, np.uint8))
        assert [pose.coasted_ns > 0 for pose in blind.poses] == [True] * 3
    (after,) = watched.at(renderer, STANDING)
    assert measured(after).keys() == set(IDS)


@pytest.mark.slow
def test_a_flash_that_hides_floor_tags_and_robots_costs_a_few_searches_an_image(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    looks: list[str] = []
    speeds = [0.0] * 9 + [MAX_SPEED] * 9
    targets = [Target(1 + i, SIDE_M, 0.0 if speed == 0.0 else HEIGHT_M, speed) for i, speed in enumerate(speeds)]
    image = SceneRenderer(GEOMETRY, SIZE, targets, 3.0, np.random.default_rng(2)).render(
        np.array([(-1.2 + 0.3 * (i % 9), 0.4 if i < 9 else -0.4, 0.3) for i in range(18)])
    )
    tracker = TagTracker(GEOMETRY, SIZE, targets)
    for k in range(3):
        seen = tracker.track(image, 10**9 + k * PERIOD_NS, lambda _: None)
    assert len(seen.poses) == 18
    monkeypatch.setattr(DeepSearch, "near", lambda *_, **__: looks.append("near"))
    monkeypatch.setattr(DeepSearch, "detect", lambda *_: (looks.append("detect"), Findings((), 0))[1])
    tracker.track(np.full_like(image, 255), 10**9 + 3 * PERIOD_NS, lambda _: None)
    assert looks.count("near") == 8
    assert looks.count("detect") == 1


@pytest.mark.slow
def test_a_robot_that_leaves_the_image_is_not_seen_elsewhere(renderer: SceneRenderer) -> None:
    watched = Watched()
    edge = GEOMETRY.to_plane(np.array([[1279.0, 300.0]]), HEIGHT_M)[0, 0]
    for k in range(60):
        x = edge - 0.1 + 0.2 * k * PERIOD_NS * 1e-9
        (sightings,) = watched.at(renderer, [(x, 0.0, 0.0), *STANDING[1:]])
        if 1 in measured(sightings):
            assert error(measured(sightings)[1], (x, 0.0, 0.0)) < 1e-3
            assert x < edge
    assert (TrackerEvent.TAG_LOST, 1) in watched.news
    assert 1 not in {pose.tag for pose in sightings.poses}


@pytest.mark.slow
def test_tags_of_different_heights_are_placed_at_their_own() -> None:
    low, high = 0.0, 0.08
    targets = [Target(1, SIDE_M, low, 0.0), Target(2, SIDE_M, high, MAX_SPEED)]
    for target in targets:
        tracker = TagTracker(GEOMETRY, SIZE, targets)
        flat = SceneRenderer(GEOMETRY, SIZE, [target], 3.0, np.random.default_rng(1))
        (seen,) = tracker.track(flat.render(np.array([(1.2, 0.6, 0.7)])), 10**9).poses
        assert seen.tag == target.tag
        assert error(seen, (1.2, 0.6, 0.7)) < 2e-4


def test_a_corrected_camera_is_used_from_the_next_image_on(renderer: SceneRenderer) -> None:
    watched = Watched()
    watched.at(renderer, STANDING, 3)
    T = GEOMETRY.T_world_camera.copy()
    T[0, 3] += 0.004
    watched.tracker.moved(GEOMETRY.moved(T))
    (seen,) = watched.at(renderer, STANDING)
    assert all(measured(seen)[tag].x - STANDING[i][0] == pytest.approx(0.004, abs=2e-4) for i, tag in enumerate(IDS))


@pytest.mark.slow
def test_a_print_that_was_a_second_one_is_not_taken_for_the_robot_that_is_hidden() -> None:
    twins, watched = scene((1, 1, 2)), Watched()
    poster = (-0.45, 0.2, 0.0)  # so near that the robot could have driven there
    watched.at(twins, [STANDING[0], GONE, STANDING[2]])
    watched.at(twins, [STANDING[0], poster, STANDING[2]], 2 * SWEEP)
    for sightings in watched.at(twins, [GONE, poster, STANDING[2]], 10 * SWEEP):
        assert 1 not in measured(sightings)
    back = watched.at(twins, [STANDING[0], poster, STANDING[2]], SWEEP)[-1]
    assert error(measured(back)[1], STANDING[0]) < 3e-4


def test_a_stamp_from_the_future_is_survived(renderer: SceneRenderer) -> None:
    watched = Watched()
    watched.at(renderer, STANDING, 3)
    now_ns, watched.now_ns = watched.now_ns, watched.now_ns + 10**10
    watched.at(renderer, STANDING)
    watched.now_ns = now_ns
    watched.at(renderer, [GONE, *STANDING[1:]], 3)
    assert measured(watched.at(renderer, STANDING, 2 * SWEEP)[-1]).keys() == set(IDS)


@pytest.mark.slow
def test_a_print_that_is_taken_for_a_hidden_robot_is_given_up_when_the_robot_is_back() -> None:
    twins, watched = scene((1, 1, 2)), Watched()
    robot, poster = STANDING[0], (-0.5, 0.2, 0.0)  # so near that the robot could have driven there
    watched.at(twins, [robot, GONE, STANDING[2]], 40)
    watched.at(twins, [GONE, poster, STANDING[2]], SWEEP)
    both = watched.at(twins, [robot, poster, STANDING[2]], 12 * SWEEP)
    assert all(1 not in measured(sightings) for sightings in both[SWEEP:])
    assert (TrackerEvent.TAG_TWICE, 1) in watched.news
    alone = watched.at(twins, [robot, GONE, STANDING[2]], 32 * SWEEP)
    assert error(measured(alone[-1])[1], robot) < 3e-4
