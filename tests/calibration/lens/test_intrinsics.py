"""A lens from corners with noise: right within its own sigma, refused where the views do not determine it."""

import itertools
import math
from collections.abc import Callable, Sequence

import cv2
import numpy as np
import pytest

from robofleet.calibration.lens.board import BoardView
from robofleet.calibration.lens.floor import COLUMNS as COLUMNS_ASKED
from robofleet.calibration.lens.floor import ROWS as ROWS_ASKED
from robofleet.calibration.lens.floor import Ceiling, FloorErrors
from robofleet.calibration.lens.intrinsics import Conditions, Measured, measure
from robofleet.calibration.lens.projection import Lens
from robofleet.calibration.lens.views import COLUMNS, ROWS, Lean, tilt
from robofleet.calibration.store import CalibrationError
from robofleet.tracking.camera import CameraGeometry

from .conftest import BOARD, TrueCamera

CEILING = Ceiling(2.5, 0.08)
WAYS = dict(zip(Lean, [(0, 0), (1, 0), (-1, 0), (0, 1), (0, -1)], strict=True))  # left and upper edge: away, or near


def measured(camera: TrueCamera, views: Sequence[BoardView], coefficients: int = 5) -> Measured:
    count = 4 if camera.kind == "fisheye" else coefficients
    return measure(views, Conditions(BOARD, camera.kind, count, camera.size, CEILING))


def seen(camera: TrueCamera, poses, noise_px: float, rng: np.random.Generator) -> list[BoardView]:
    views = [camera.view(f"{k:02d}.png", pose, noise_px, rng) for k, pose in enumerate(poses)]
    return [view for view in views if len(view.ids) >= 12]


def good_views(camera: TrueCamera, count: int, noise_px: float, seed: int) -> list[BoardView]:
    rng = np.random.default_rng(seed)
    return seen(camera, camera.good_poses(count, rng), noise_px, rng)


def floor_error_mm(camera: TrueCamera, result: Measured) -> float:
    lens = result.fit.lens
    (f_x, f_y, c_x, c_y), distortion = lens.values[:4], lens.values[4:]
    K = [[f_x, 0, c_x], [0, f_y, c_y], [0, 0, 1]]
    geometry = CameraGeometry(K, distortion, np.eye(4), lens.kind)
    return float(camera.floor_error_mm(lambda pixels: geometry.to_plane(pixels, 1.0)))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["true_camera", "fisheye"])
def test_every_parameter_lies_within_its_sigma(kind: str, request: pytest.FixtureRequest) -> None:
    camera = request.getfixturevalue(kind)
    noise, left_out = [], []
    for seed in range(5):
        fit = measured(camera, good_views(camera, 20, 0.15, seed)).fit
        assert fit.noise_px == pytest.approx(0.15, rel=0.1)
        off = fit.lens.values - camera.values
        # In the covariance's own axes: these are independent, the parameters are not.
        noise.append(off @ np.linalg.solve(fit.covariance, off) / len(off))
        left_out.append(np.mean(off**2 / np.diag(fit.jackknife)))
    assert np.mean(noise) == pytest.approx(1.0, abs=0.5)
    assert 0.4 < np.mean(left_out) < 1.6


def test_fifteen_centred_untilted_views_are_refused(true_camera: TrueCamera) -> None:
    rng = np.random.default_rng(3)
    result = measured(true_camera, seen(true_camera, true_camera.flat_poses(15, rng), 0.14, rng))
    residuals = np.concatenate(result.fit.residuals)
    assert math.sqrt((residuals**2).sum(axis=1).mean()) < 0.25  # it looks good
    assert not floor_error_mm(true_camera, result) < 3.0  # it is not
    faults = "\n".join(result.faults())
    for reason in (
        "upper left corner",
        "lower right corner",
        "tilted away",
        "focal length is uncertain",
        "next view: ",
    ):
        assert reason in faults
    assert result.arena_mm > 3.0


@pytest.mark.slow
def test_each_lack_is_named(true_camera: TrueCamera) -> None:
    rng = np.random.default_rng(4)
    views = seen(true_camera, true_camera.good_poses(24, rng), 0.05, rng)
    assert measured(true_camera, views).faults() == []
    assert any("8 views" in fault for fault in measured(true_camera, views[:8]).faults())

    def reasons(kept: Callable[[BoardView], bool]) -> str:
        return "\n".join(measured(true_camera, [view for view in views if kept(view)]).faults())

    w, h = true_camera.size
    cell = np.array([w / COLUMNS, h / ROWS])
    corner = reasons(lambda view: not (view.pixels < cell).all(axis=1).any())
    assert "hardly any corner of the board was in the upper left corner of the image" in corner
    assert "next view: show the board in the upper left corner" in corner

    places = itertools.product((90, 400, 710), (80, 300, 520), (-25, 25))
    poses = [true_camera.pose(u, v, 0.7, 0, upper) for u, v, upper in places]
    sideways = "\n".join(measured(true_camera, seen(true_camera, poses, 0.05, rng)).faults())
    assert "the left or right edge was tilted away by 12 deg in 0 views" in sideways
    assert "its left edge" in sideways or "its right edge" in sideways
    assert "the upper or lower edge was tilted" not in sideways


@pytest.mark.slow
def test_a_good_reprojection_does_not_outweigh_an_uncertain_arena(true_camera: TrueCamera) -> None:
    result = measured(true_camera, good_views(true_camera, 13, 0.6, 5))
    assert any("mm rms over the arena: at most 0.5 mm" in fault for fault in result.faults())


@pytest.mark.slow
def test_views_that_do_not_fit_are_named_and_left_out(true_camera: TrueCamera) -> None:
    rng = np.random.default_rng(6)
    views = seen(true_camera, true_camera.good_poses(24, rng), 0.08, rng)
    clean = measured(true_camera, views)
    assert clean.outliers == ()
    blurred = views[4]._replace(pixels=views[4].pixels + rng.normal(0, 0.6, views[4].pixels.shape))
    skew = np.array([[0.0, 0.0], [0.02, 0.0]])  # 2 px over 100 rows, as a rolling shutter makes of a move
    middle = views[9].pixels.mean(axis=0)
    skewed = views[9]._replace(pixels=views[9].pixels + (views[9].pixels - middle) @ skew)
    spoilt = [*views[:4], blurred, *views[5:9], skewed, *views[10:]]
    spoilt[17] = spoilt[17]._replace(
        pixels=spoilt[17].pixels + np.eye(len(spoilt[17].pixels), 2) * 5
    )  # two bad corners
    result = measured(true_camera, spoilt)
    named = {outlier.view.name for outlier in result.outliers}
    assert named == {"04.png", "09.png"}
    assert "04.png" in result.warnings()[0]
    assert floor_error_mm(true_camera, result) < 3 * result.arena_mm
    assert result.faults() == []


@pytest.mark.slow
def test_views_that_share_an_error_widen_the_uncertainty(true_camera: TrueCamera) -> None:
    rng = np.random.default_rng(7)
    bent = BOARD.corners - BOARD.corners.mean(axis=0)
    height = 0.004 * (bent[:, 0] / bent[:, 0].max()) ** 2  # bowed by 4 mm
    shapes = {True: BOARD.corners + np.array([0, 0, 1]) * height[:, None], False: BOARD.corners}
    ratios = {}
    for bowed, shape in shapes.items():

        class Printed:
            corners = shape

        views = [
            view._replace(points=BOARD.corners[view.ids])
            for k, pose in enumerate(true_camera.good_poses(24, np.random.default_rng(1)))
            if len((view := true_camera.view(str(k), pose, 0.05, rng, Printed)).ids) >= 12
        ]
        result = measured(true_camera, views)
        ratios[bowed] = result.shared_errors
        assert any("contradict" in warning for warning in result.warnings()) == bowed
    assert ratios[False] < 1.7
    assert ratios[True] > 2.0


@pytest.mark.slow
def test_held_out_error_is_the_corners_noise(true_camera: TrueCamera) -> None:
    rng = np.random.default_rng(8)
    views = seen(true_camera, true_camera.good_poses(20, rng), 0.2, rng)
    result = measured(true_camera, views)
    held_out = result.held_out()
    free = 1 - 6 / (2 * np.mean([len(view.ids) for view in views]))  # each held-out view still has its own pose
    assert held_out.rms_px == pytest.approx(0.2 * math.sqrt(2 * free), rel=0.1)
    assert held_out.rms_mm == pytest.approx(held_out.rms_px * 2500 / 641, rel=0.01)
    # A lens of four fifths of the views scatters about the whole's by half of its sigma: 1 / 0.8 - 1 = 0.5 squared.
    assert held_out.lenses_mm == pytest.approx(0.5 * result.floor.rms_mm(result.fit.covariance), rel=0.5)
    # A model that is too poor is found out by the images it has not seen.
    poor = TrueCamera(distortion=np.array([-0.3, 0.15, 0.0005, -0.0004, -0.05]))
    views = seen(poor, poor.good_poses(20, rng), 0.02, rng)
    rich_px, poor_px = (measured(poor, views, count).held_out().rms_px for count in (5, 4))
    assert poor_px > 1.3 * rich_px


@pytest.mark.slow
def test_the_view_that_is_asked_for_helps_most(true_camera: TrueCamera) -> None:
    rng = np.random.default_rng(9)
    views = seen(true_camera, true_camera.good_poses(14, rng), 0.3, rng)
    result = measured(true_camera, views)
    assert not result.coverage.empty.any() and not result.coverage.missing_leans
    wanted = result.wanted
    pose = as_asked(true_camera, wanted, rng, spread=0.0)
    with_it = measured(true_camera, [*views, true_camera.view("asked", pose, 0.3, rng)])
    middle = true_camera.pose(400, 300, 0.9, 0, 0)
    with_another = measured(true_camera, [*views, true_camera.view("another", middle, 0.3, rng)])
    uncertainty = [view.floor.rms_mm(view.fit.covariance) for view in (with_it, with_another)]
    assert uncertainty[0] < uncertainty[1]
    assert uncertainty[0] == pytest.approx(wanted.rms_mm, rel=0.15)  # as it was foretold


def as_asked(camera: TrueCamera, wanted, rng: np.random.Generator, spread: float = 1.0):
    """Return the pose of a board that an operator shows as the tool asked."""
    angle = 30 + spread * rng.normal(0, 4)
    left, upper = (way * angle for way in WAYS[wanted.lean])
    (w, h), (du, dv) = camera.size, spread * rng.normal(0, 15, 2)
    u, v = (wanted.column + 0.5) * w / COLUMNS + du, (wanted.row + 0.5) * h / ROWS + dv
    return camera.pose(u, v, wanted.distance_m, left, upper, spread * rng.uniform(-8, 8))


@pytest.mark.slow
def test_doing_as_asked_leads_to_a_lens_that_is_accepted(true_camera: TrueCamera) -> None:
    rng = np.random.default_rng(10)
    views = seen(true_camera, true_camera.flat_poses(3, rng), 0.1, rng)
    result = measured(true_camera, views)
    while result.faults():
        assert len(views) < 25
        views.append(true_camera.view(f"{len(views)}", as_asked(true_camera, result.wanted, rng), 0.1, rng))
        result = measured(true_camera, views)
    assert floor_error_mm(true_camera, result) < 2.5 * result.arena_mm


@pytest.mark.parametrize("lean", list(Lean))
def test_a_lean_names_the_edge_that_is_away(lean: Lean, true_camera: TrueCamera) -> None:
    rng = np.random.default_rng(11)
    for spin in (0, 70, 180, -100):  # of the print: the edges are the image's, not the board's
        pose = true_camera.pose(420, 310, 0.9, *(25 * way or 5 for way in WAYS[lean]), spin)
        assert tilt(pose)[0] is lean
        if lean is Lean.FLAT:
            continue
        view = true_camera.view("", pose, 0.0, rng)
        depth = view.points @ cv2.Rodrigues(pose[:3])[0][2] + pose[5]
        axis, sign = (0, 1) if lean in (Lean.LEFT, Lean.RIGHT) else (1, 1)
        along = view.pixels[:, axis] * sign
        farther_first = lean in (Lean.LEFT, Lean.UPPER)
        assert (np.corrcoef(along, depth)[0, 1] < 0) == farther_first


@pytest.mark.slow_after_first
@pytest.mark.parametrize("coefficients", [4, 8, 14])
def test_richer_models_fit_no_worse(coefficients: int, true_camera: TrueCamera) -> None:
    views = good_views(true_camera, 24, 0.05, 12)
    result = measured(true_camera, views, coefficients)
    assert result.fit.noise_px == pytest.approx(0.05, rel=0.1)
    assert len(result.fit.lens.names) == len(result.fit.lens.values) == 4 + coefficients
    assert floor_error_mm(true_camera, result) < 0.5
    assert np.isfinite(result.fit.covariance).all()


def chi_square(camera: TrueCamera, result: Measured) -> float:
    """Return the squared error of the written lens, in terms of the written covariance."""
    model = result.model("", result.held_out())
    assert model.intrinsics is not None
    true = np.zeros(len(model.distortion) + 4)
    true[: len(camera.values)] = camera.values
    off = np.array([*model.focal_px, *model.centre_px, *model.distortion]) - true
    return float(off @ np.linalg.solve(np.array(model.intrinsics.covariance), off))


@pytest.mark.long
@pytest.mark.parametrize("coefficients", [5, 8, 12, 14])
def test_predicted_uncertainty_is_true_of_every_model(coefficients: int, true_camera: TrueCamera) -> None:
    # What the views leave open stays near the prior's middle, which is the truth here: up to five values of a rich
    # lens are nearer to it than their sigma says.
    results = [measured(true_camera, good_views(true_camera, 20, 0.1, seed), coefficients) for seed in range(12)]
    assert all(result.outliers == () and result.faults() == result.warnings() == [] for result in results)
    count = 12 * (4 + coefficients)
    sigma = math.sqrt(2 * count)
    open_values = 12 * max(0, min(5, coefficients - 5))
    assert count - open_values - 3 * sigma < sum(chi_square(true_camera, r) for r in results) < count + 3 * sigma
    errors = [floor_error_mm(true_camera, result) for result in results]
    predicted = [result.floor.rms_mm(result.fit.covariance) for result in results]
    assert np.mean(np.square(errors)) / np.mean(np.square(predicted)) == pytest.approx(1.0, abs=0.5)


@pytest.mark.slow
def test_the_warning_leads_to_a_lens_that_fits(true_camera: TrueCamera) -> None:
    rational = TrueCamera(distortion=np.array([0.5, 0.02, 0.0005, -0.0004, 0.0, 0.9, 0.1, 0.0]))
    views = good_views(rational, 24, 0.02, 16)
    (warning,) = measured(rational, views, 4).warnings()
    assert "views contradict one another" in warning and warning.endswith("try --coefficients 5")
    assert sum(view.name in warning for view in views) == 3
    result = measured(rational, views, 8)
    assert result.warnings() == [] and result.faults() == [] and result.outliers == ()
    assert floor_error_mm(rational, result) < 2.5 * result.arena_mm


def test_a_lens_that_folds_has_no_rays_there() -> None:
    folding = Lens("pinhole", (800, 600), np.array([640.0, 640.0, 400.0, 300.0, -0.9, 0.0, 0.0, 0.0, 0.0]))
    slopes = folding.slopes(np.array([[400.0, 300.0], [5.0, 5.0]]))
    assert slopes[0] == pytest.approx([0.0, 0.0])
    assert np.isnan(slopes[1]).all()


@pytest.mark.slow
def test_the_arena_that_matters_can_be_smaller_than_the_image(fisheye: TrueCamera) -> None:
    views = good_views(fisheye, 24, 0.08, 13)
    everything, small = (
        measure(views, Conditions(BOARD, "fisheye", 4, fisheye.size, Ceiling(2.5, 0.08, arena)))
        for arena in (None, (3.2, 2.0))
    )
    assert small.arena_mm < everything.arena_mm
    assert small.coverage.needed.sum() < everything.coverage.needed.sum() <= ROWS * COLUMNS
    assert small.faults() == []


@pytest.mark.slow
def test_corners_that_no_lens_explains(true_camera: TrueCamera) -> None:
    rng = np.random.default_rng(14)
    views = seen(true_camera, true_camera.good_poses(14, rng), 0.1, rng)
    for spoilt in (
        [view._replace(pixels=rng.uniform(0, 600, view.pixels.shape)) for view in views],
        [view._replace(points=rng.permutation(view.points)) for view in views],
        [view._replace(pixels=np.full_like(view.pixels, 300.0)) for view in views],
    ):
        with pytest.raises(CalibrationError, match="no lens explains the views"):
            measured(true_camera, spoilt)


def test_an_arena_that_no_pixel_sees_is_not_certain(true_camera: TrueCamera) -> None:
    views = good_views(true_camera, 14, 0.1, 15)
    result = measure(views, Conditions(BOARD, "pinhole", 5, true_camera.size, Ceiling(2.5, 0.08, (0.001, 0.001))))
    assert any("uncertain by inf mm" in fault for fault in result.faults())


@pytest.mark.parametrize("tag_height_m", [0.0, 0.08, 0.3])
def test_a_wrong_focal_length_is_absorbed_on_the_floor_but_not_above_it(tag_height_m: float) -> None:
    # Focal length and height of the camera are too large by the same share: the floor's scale is right. At a height
    # t above it, a ray of slope s meets s (h - t / (1 + share)) in place of s (h - t): s t share too far.
    lens = Lens("pinhole", (801, 601), np.array([640.0, 640.0, 400.0, 300.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    share = 0.01
    change = np.array([640.0 * share, 640.0 * share, *[0.0] * 7])
    errors = FloorErrors(lens, Ceiling(2.5, tag_height_m))
    u, v = np.meshgrid(np.linspace(0, 800, COLUMNS_ASKED), np.linspace(0, 600, ROWS_ASKED))
    slopes = np.hypot(u - 400, v - 300).ravel() / 640
    wrong_mm = 1e3 * slopes * tag_height_m * share
    assert errors.sigma_mm(np.outer(change, change)) == pytest.approx(wrong_mm, abs=1e-4)
    assert errors.shift_mm(change) == pytest.approx(math.sqrt(np.mean(wrong_mm**2)), abs=1e-4)
    fixed = errors.sigma_mm(np.outer(change, change), refitted=False)
    assert fixed == pytest.approx(1e3 * slopes * (2.5 - tag_height_m) * share)
