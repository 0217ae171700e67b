"""Images of several cameras in the filter, in any order; and which camera is believed."""

from dataclasses import replace

import numpy as np
import pytest

from robofleet.core.clock import MS, S
from robofleet.tracking.filter.agreement import Agreement, Verdict
from robofleet.tracking.filter.estimator import CARRIED, USED, FleetFilter
from robofleet.tracking.filter.joined import Joined, Seen
from tests.robots import GTERNAL
from tests.tracking.filter.test_estimator import NOISE

Pair = tuple[int, int]  # of what two cameras have

TICK = 33 * MS
WHEELS = np.zeros((3, 2))
NAN = np.full(3, np.nan)


def fleet() -> FleetFilter:
    return FleetFilter((GTERNAL,) * 3, (2 * MS,) * 3, NOISE)


def image(camera: int, instant_ns: int, *poses: np.ndarray) -> Seen:
    return Seen(camera, np.array(poses), np.full(3, instant_ns))


def drive(arrivals: list[list[Seen]]) -> tuple[np.ndarray, list[list[int]]]:
    """Let a filter take the images that arrived at each tick; returns its prediction and what became of them."""
    filter_ = fleet()
    joined, used = Joined(filter_, lambda _seen, _expected: True), []
    for k, images in enumerate(arrivals):
        used.append(joined.observe(images).tolist() if images else [])
        filter_.command(S + k * TICK, WHEELS)
    return filter_.predict(S + len(arrivals) * TICK)[0], used


def pose(k: int, robot: int, error: float = 0.0) -> np.ndarray:
    """What an image says of a robot that stands: each image errs in its own way."""
    noise = np.random.default_rng([k, robot]).normal(0.0, 1e-4, 3)
    return np.array([0.1 * robot + error, 0.5 * robot, 0.3]) + noise


def test_two_images_of_one_instant_are_both_used() -> None:
    """Neither is thrown away: the estimate lies between what two cameras say."""
    filter_ = fleet()
    joined = Joined(filter_, lambda _seen, _expected: True)
    at = [np.array([0.0, 0.5 * robot, 0.3]) for robot in range(3)]
    joined.observe([image(0, S, *at)])
    other = [position + np.array([0.0004, 0.0, 0.0]) for position in at]
    joined.observe([image(0, S + TICK, *at), image(1, S + TICK, *other)])
    x = filter_.predict(S + TICK)[0][:, 0]
    assert ((x > 0.00005) & (x < 0.0003)).all()


@pytest.mark.parametrize("late", [1, 3])
def test_an_image_that_comes_ticks_later_is_used_as_if_it_had_come_in_time(late: int) -> None:
    """Robot 0 is seen by one camera, robot 2 by the other, robot 1 by both."""
    ones = [image(0, S + k * TICK - 18 * MS, pose(k, 0), pose(k, 1), NAN) for k in range(8)]
    others = [image(1, S + k * TICK - 13 * MS, NAN, pose(k, 1, 1e-4), pose(k, 2)) for k in range(8)]
    # the other camera's images, from the fourth on, come a tick after the first one's; the last one is waited for
    arrivals = [[a] if k >= 3 else [a, others[k]] for k, a in enumerate(ones)]
    for k in range(3, 8 - late):
        arrivals[k + late].append(others[k])
    delayed, _ = drive(arrivals)
    missing = [[a, b] if k < 8 - late else [a] for k, (a, b) in enumerate(zip(ones, others, strict=True))]
    np.testing.assert_allclose(delayed, drive(missing)[0], atol=1e-8)  # only the newest have not come


def test_a_robot_that_passes_from_one_camera_to_the_next_makes_no_step() -> None:
    arrivals = []
    for k in range(12):
        poses = [pose(k, robot) for robot in range(3)]
        arrivals.append([image(0, S + k * TICK, *poses)] if k < 6 else [image(1, S + k * TICK, *poses)])
    _, used = drive(arrivals)
    assert used[0] == [CARRIED] * 3  # the first of all
    assert all(uses == [USED] * 3 for uses in used[1:])


def test_an_image_that_is_far_too_late_changes_nothing() -> None:
    ones = [[image(0, S + k * TICK, *(pose(k, robot) for robot in range(3)))] for k in range(12)]
    before, _ = drive([*ones, []])
    after, used = drive([*ones, [image(1, S - TICK, *(pose(9, robot) for robot in range(3)))]])
    np.testing.assert_allclose(after, before, atol=1e-9)
    assert used[-1] != [CARRIED] * 3


class Judge:
    """Cameras that see three robots, each with an error of its own [m]; predictions are right."""

    def __init__(self, cameras: int, fixed: tuple[int, ...] = ()) -> None:
        self.agreement = Agreement(np.ones(3, np.bool_), 0.0002, np.isin(np.arange(cameras), fixed))
        self.errors, self.k = [0.0] * cameras, 0
        self.rng = np.random.default_rng(3)

    def images(self, count: int, predicted_off: float = 0.0) -> list[Verdict]:
        verdicts = []
        for _ in range(count):
            self.k += 1
            for camera, error in enumerate(self.errors):
                noise = self.rng.normal(0.0, 0.0001, (3, 3))
                seen = image(camera, S + self.k * TICK, *(pose(self.k, robot, error) for robot in range(3)))
                predicted = np.array([pose(self.k, robot, predicted_off) for robot in range(3)])
                if (verdict := self.agreement.look(seen._replace(poses=seen.poses + noise), predicted)) is not None:
                    verdicts.append(verdict)
        return verdicts


@pytest.mark.parametrize(("reported_m", "verdicts"), [(0.001, 0), (0.0, 1)])
def test_a_camera_that_says_how_unsure_it_is_is_not_accused_of_it(reported_m: float, verdicts: int) -> None:
    """Its tags are faint: a millimetre of noise, which its covariances tell, or do not."""
    judge, rng = Judge(2), np.random.default_rng(4)
    covariance = np.tile([reported_m**2, 0.0, reported_m**2, 0.0, 0.0, 1e-6], (3, 1))
    verdict_list = []
    for k in range(200):
        true = np.array([pose(k, robot) for robot in range(3)])
        for camera, sigma in enumerate((0.0, 0.001)):
            poses = np.column_stack([true + rng.normal(0.0, sigma, (3, 3)), covariance])
            verdict_list.append(judge.agreement.look(Seen(camera, poses, np.full(3, S + k * TICK)), true))
    assert len([verdict for verdict in verdict_list if verdict is not None]) >= verdicts
    assert verdicts or not any(verdict_list)


def test_of_three_the_two_that_agree_are_believed_though_the_prediction_followed_the_third() -> None:
    judge = Judge(3)
    judge.images(10)
    judge.errors = [0.0, 0.013, 0.0]
    (verdict,) = judge.images(10, predicted_off=0.013)
    assert (verdict.camera, verdict.believed, verdict.apart) == (1, False, pytest.approx(0.013, abs=0.0005))


def test_of_two_that_moved_apart_slowly_the_one_that_sees_a_floor_tag_is_believed() -> None:
    judge = Judge(2, fixed=(0,))
    judge.images(10)
    judge.errors = [0.0006, -0.0005]
    assert [v.camera for v in judge.images(30)] == [1]


class Hall:
    """Three robots that drive at up to 0.2 m/s and 2 rad/s in the views of two cameras; camera 1 may be knocked.

    ``offsets`` and ``latencies`` of the cameras: from a period's begin to the exposure, from there to the poses.
    ``radius``: of the robots' wheels over that which the filter believes.
    """

    def __init__(
        self, period_ns: int, offsets: Pair, latencies: Pair, radius: float = 1.0, noise: float = 2e-5
    ) -> None:
        self.period_ns, self.offsets, self.latencies, self.noise = period_ns, offsets, latencies, noise
        drive = replace(GTERNAL, wheel_radius=GTERNAL.wheel_radius * radius)
        self.truth, self.estimator = FleetFilter((drive,) * 3, (2 * MS,) * 3, NOISE), fleet()
        self.agreement = Agreement(np.ones(3, np.bool_), 0.0002, np.zeros(2, np.bool_))
        self.joined = Joined(self.estimator, self.judge)
        self.verdicts: list[tuple[float, int, bool]] = []  # when, of which camera, whether it is believed
        self.rng = np.random.default_rng(7)
        self.k, self.knock, self.knocked_ns = 0, np.zeros(3), 0
        self.blocked = False
        self.sent = [0, 0]  # images of each camera so far
        at = np.array([[0.0, 0.5 * robot, 0.3] for robot in range(3)])
        for fleet_filter in (self.truth, self.estimator):
            fleet_filter.observe(np.full(3, S), at)

    def judge(self, seen: Seen, expected: np.ndarray) -> bool:
        if (verdict := self.agreement.look(seen, expected)) is not None:
            self.verdicts.append(((self.now_ns - self.knocked_ns) / S, verdict.camera, verdict.believed))
        return bool(self.agreement.believed[seen.camera])

    @property
    def now_ns(self) -> int:
        return S + self.k * TICK

    def drive(self, seconds: float) -> float:
        """Drive on; returns the largest error of a position [m]."""
        worst = 0.0
        for _ in range(round(seconds * S / TICK)):
            self.k += 1
            images = [self.image(camera) for camera in range(2)]
            self.joined.observe([seen for seen in images if seen is not None])
            off = self.estimator.predict(self.now_ns)[0] - self.truth.predict(self.now_ns)[0]
            worst = max(worst, float(np.hypot(off[:, 0], off[:, 1]).max()))
            t = self.k * TICK / S
            v, omega = 0.1 + 0.1 * np.sin(1.3 * t + np.arange(3)), 2.0 * np.sin(1.9 * t + 2.0 * np.arange(3))
            half = omega * GTERNAL.wheel_base / 2
            wheels = np.stack([v - half, v + half], axis=1) / GTERNAL.wheel_radius
            self.estimator.command(self.now_ns, wheels)
            self.truth.command(self.now_ns, np.zeros((3, 2)) if self.blocked else wheels)
            self.truth.observe(np.full(3, self.now_ns - 500 * MS), np.full((3, 3), np.nan))
        return worst

    def image(self, camera: int) -> Seen | None:
        """Return the newest image whose poses have come by now; None if it came before."""
        count = (self.now_ns - S - self.offsets[camera] - self.latencies[camera]) // self.period_ns
        if count <= self.sent[camera]:
            return None
        self.sent[camera] = count
        exposed_ns = S + count * self.period_ns + self.offsets[camera]
        poses = self.truth.predict(exposed_ns)[0] + self.rng.normal(0.0, self.noise, (3, 3))
        moved = self.knock if camera == 1 and exposed_ns >= self.knocked_ns else 0.0
        return Seen(camera, poses + moved, np.full(3, exposed_ns))


CAMERAS = {
    "same tick": (TICK, (0, 0), (20 * MS, 20 * MS)),
    "one tick late": (TICK, (0, 0), (20 * MS, 20 * MS + TICK)),
    "webcams": (TICK, (0, 7 * MS), (30 * MS, 70 * MS)),
    "10 Hz, 25 ms apart": (100 * MS, (0, 25 * MS), (20 * MS, 20 * MS)),
}


@pytest.mark.slow_after_first
@pytest.mark.parametrize("knock", [0.02, 0.002])
@pytest.mark.parametrize("cameras", CAMERAS.values(), ids=CAMERAS)
def test_a_knocked_camera_is_named_whenever_its_images_come(cameras: tuple[int, Pair, Pair], knock: float) -> None:
    hall = Hall(*cameras)
    hall.drive(2.0)
    hall.knocked_ns, hall.knock = hall.now_ns, np.array([knock, 0.0, 0.0])
    hall.drive(1.0)
    ((after_s, camera, believed),) = hall.verdicts
    assert (camera, believed) == (1, False)
    assert after_s <= 1.0
    assert hall.drive(2.0) <= 2e-4
    hall.knock = np.zeros(3)
    hall.drive(4.0)
    assert [(camera, believed) for _, camera, believed in hall.verdicts[1:]] == [(1, True)]


@pytest.mark.slow
@pytest.mark.parametrize("cameras", CAMERAS.values(), ids=CAMERAS)
def test_cameras_that_hang_well_are_believed_for_long(cameras: tuple[int, Pair, Pair]) -> None:
    """Though the wheels are larger than believed, and the robots are held for a while."""
    hall = Hall(*cameras, radius=1.05, noise=1e-4)
    hall.drive(8.0)
    hall.blocked = True
    hall.drive(3.0)
    hall.blocked = False
    hall.drive(4.0)
    assert hall.verdicts == []
