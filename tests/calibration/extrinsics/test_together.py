"""Several cameras that are placed by one survey: how well, how surely, and what ties them together."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from robofleet import cli
from robofleet.calibration.extrinsics.consensus import agree
from robofleet.calibration.extrinsics.fiducials import Marks
from robofleet.calibration.extrinsics.placing import Lens, change_between, moved
from robofleet.calibration.extrinsics.together import SurveyView, agree_together
from robofleet.calibration.store import CalibrationError
from robofleet.config.calibrated import CameraModel
from robofleet.tracking.camera import CameraGeometry
from tests.calibration.extrinsics.test_arena import CAMERA, DOWN, LENS, PIXEL, SIZE, SURVEY_M
from tests.calibration.extrinsics.test_arena_files import SIDE, rendered, surveyed

ROOT = Path(__file__).parents[3]
BESIDE = 1.4  # of each camera from the middle [m]
TAGS = [(x, y) for x in (-2.7, -1.4, 0.0, 1.4, 2.7) for y in (-0.85, 0.0, 0.85)]  # both see those in the middle


def hung(rng: np.random.Generator) -> list[CameraGeometry]:
    """Two cameras side by side, each a little tilted."""
    sides = [DOWN + np.outer([1, 0, 0, 0], [0, 0, 0, x]) for x in (-BESIDE, BESIDE)]
    return [CAMERA.moved(moved(T, rng.normal(0.0, 1.0, 6) * [0.03, 0.03, 0.3, 0.03, 0.03, 0.05])) for T in sides]


def views(cameras: list[CameraGeometry], rng: np.random.Generator, open_: tuple[int, ...] = ()) -> list[SurveyView]:
    """What each camera sees of one survey; ``open_``: tags that nobody surveyed."""
    true = np.column_stack([TAGS, np.zeros(len(TAGS))])
    points = true + np.column_stack([rng.normal(0.0, SURVEY_M, (len(TAGS), 2)), np.zeros(len(TAGS))])
    points[list(open_), :2] = np.nan
    found = []
    for name, camera in zip(("left", "right"), cameras, strict=True):
        seen = np.flatnonzero(camera.sees(true, SIZE))
        pixels = camera.project(true[seen]) + rng.normal(0.0, PIXEL, (len(seen), 2))
        nan, n = np.full((len(seen), 2), np.nan), len(seen)
        names = tuple(f"tag {k}" for k in seen)
        marks = Marks(names, points[seen], nan[:, 0], np.full(n, 0.1), pixels, nan, np.full(n, PIXEL))
        found.append(SurveyView(name, LENS, marks))
    return found


def at_the_seam(cameras: list[CameraGeometry], found: list[Lens | CameraGeometry]) -> float:
    """How far apart two cameras that were placed see robots in the middle [m], rms."""
    robots = np.array([(x, y, 0.08) for x in (-0.1, 0.1) for y in np.linspace(-0.8, 0.8, 9)])
    pairs = zip(cameras, found, strict=True)
    first, other = (placed.to_plane(camera.project(robots), 0.08) for camera, placed in pairs)
    return float(np.sqrt(((first - other) ** 2).sum(axis=1).mean()))


@pytest.mark.slow
@pytest.mark.parametrize("open_", [(), (6, 7, 8), (9, 10, 12, 13, 14)])
def test_poses_are_as_uncertain_as_is_said(open_: tuple[int, ...]) -> None:
    """Also with tags in the middle that nobody surveyed, and a right camera that sees one surveyed tag of its own."""
    squares = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        cameras = hung(rng)
        try:
            agreements = agree_together(views(cameras, rng, open_), SURVEY_M)
        except CalibrationError as refused:
            assert open_ == (9, 10, 12, 13, 14), refused  # too few that it shares, where it hangs askew
            continue
        for camera, agreement in zip(cameras, agreements, strict=True):
            off = change_between(agreement.placement.T_world_camera, camera.T_world_camera)
            squares.append(float(off @ np.linalg.solve(agreement.placement.covariance, off)))
    assert len(squares) > 20
    assert np.mean(squares) / 6 == pytest.approx(1.0, abs=4 * math.sqrt(2 / (6 * len(squares))))


@pytest.mark.slow_after_first
@pytest.mark.parametrize("open_", [(), (7,), (6, 7, 8)])
def test_the_surveys_error_is_estimated_whatever_ties_the_cameras(open_: tuple[int, ...]) -> None:
    found = []
    for seed in range(5):
        rng = np.random.default_rng(seed)
        found += [view.placement.survey_m for view in agree_together(views(hung(rng), rng, open_), None)]
    assert np.median(found) == pytest.approx(SURVEY_M, rel=0.3)


def test_four_marks_of_a_camera_do_not_tell_how_well_they_were_surveyed() -> None:
    rng = np.random.default_rng(1)
    left, right = views(hung(rng), rng)
    four = np.isin(np.arange(len(right.marks)), [0, 2, len(right.marks) - 3, len(right.marks) - 1])
    right = right._replace(marks=right.marks.chosen(four))
    with pytest.raises(CalibrationError, match="right: four marks do not tell"):
        agree_together([left, right], None)
    agree_together([left, right], SURVEY_M)


@pytest.mark.slow
def test_at_the_seam_they_agree_better_than_cameras_that_were_placed_alone() -> None:
    together, alone = [], []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        cameras = hung(rng)
        seams = views(cameras, rng)
        found = agree_together(seams, SURVEY_M)
        together.append(at_the_seam(cameras, [each.placement.geometry for each in found]))
        single = [agree(view.lens, view.marks, SURVEY_M).placement.geometry for view in seams]
        alone.append(at_the_seam(cameras, single))
    assert np.mean(together) < np.mean(alone)


def test_a_camera_that_nothing_ties_to_the_survey_is_refused() -> None:
    rng = np.random.default_rng(1)
    with pytest.raises(CalibrationError, match="right: sees 3 tags that are surveyed or that a camera which is placed"):
        agree_together(views(hung(rng), rng, (9, 10, 11, 12, 13, 14)), SURVEY_M)


@pytest.mark.slow
def test_the_command_places_both_and_writes_a_page_of_each(tmp_path: Path) -> None:
    model = CameraModel.model_validate(yaml.safe_load((ROOT / "configs/cameras/overhead.yaml").read_text()))
    rng = np.random.default_rng(4)
    cameras, poses = hung(rng), [(x, y, 0.3 * k) for k, (x, y) in enumerate(TAGS)]
    for name, camera in zip(("left", "right"), cameras, strict=True):
        lens = model.model_copy(update={"T_world_camera": None}).model_dump(mode="json", exclude_none=True)
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(lens))
        seen = [pose if camera.sees(np.array([[*pose[:2], 0.0]]), SIZE)[0] else (1e3, 0.0, 0.0) for pose in poses]
        cv2.imwrite(str(tmp_path / f"{name}.png"), rendered(camera, seen, rng))
    tags = [tag for k, tag in enumerate(surveyed(poses, rng)) if k not in (7,)]  # one tie that nobody surveyed
    nowhere = {**tags[0], "tag": 300, "x_m": 5.0}
    (tmp_path / "survey.yaml").write_text(yaml.safe_dump({"floor_tags": [*tags, nowhere]}))
    files = ",".join(str(tmp_path / f"{name}.yaml") for name in ("left", "right"))
    arguments = ["calibrate", "arena", files, tmp_path / "survey.yaml", tmp_path / "left.png", tmp_path / "right.png",
                 "--report", tmp_path / "report.html", "--survey-mm", "0.5"]  # fmt: skip
    done = CliRunner().invoke(cli.app, list(map(str, arguments)))
    assert done.exit_code == 0, done.output
    missed = [line.split(": ")[:2] for line in done.output.splitlines() if "is in no image" in line]
    left, right = ([tag for camera, tag in missed if camera == name] for name in ("left", "right"))
    assert left == right, "one that only another camera sees is not missed"
    assert "tag 300" in left
    for name, camera in zip(("left", "right"), cameras, strict=True):
        written = CameraModel.model_validate(yaml.safe_load((tmp_path / f"{name}.yaml").read_text()))
        found = CameraGeometry.from_model(written)
        assert np.linalg.norm(found.position - camera.position) < 0.01
        assert (tmp_path / f"report-{name}.html").exists()
        assert written.marks is not None
    for names, more, why in (
        (f"{tmp_path / 'left.yaml'},{tmp_path / 'left.yaml'}", arguments[4:6], "left is written twice"),
        (files, ["--live", ROOT / "configs/platoon.yaml"], "has one `camera`, and 2 are to be placed"),
    ):
        refused = CliRunner().invoke(cli.app, list(map(str, ["calibrate", "arena", names, arguments[3], *more])))
        assert refused.exit_code == 2
        assert why in " ".join(refused.output.split())
    wrong = CliRunner().invoke(cli.app, [*map(str, arguments[:5]), "--report", str(tmp_path / "again.html")])
    assert wrong.exit_code == 2
    assert "name one for each" in wrong.output
    assert SIDE == 0.1
