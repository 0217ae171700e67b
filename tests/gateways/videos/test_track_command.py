"""``robofleet track``: what it writes, what it says, how it ends."""

import csv
import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from robofleet.core.refusal import RefusedError
from robofleet.gateways.videos.command import COLUMNS, numbers
from robofleet.simulation.camera import SceneRenderer
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.targets import Target
from tests.command import robofleet

SIZE, RATE_HZ, COUNT = (480, 270), 20, 16


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a video of tags 4 and 5 on a circle."""
    T = np.eye(4)
    T[:3, :3], T[2, 3] = np.diag([1.0, -1.0, -1.0]), 1.0
    geometry = CameraGeometry([[400.0, 0, 240], [0, 400.0, 135], [0, 0, 1]], [], T)
    robots = [Target(tag, 0.07, 0.0, 0.5) for tag in (4, 5)]
    renderer = SceneRenderer(geometry, SIZE, robots, 2.0, np.random.default_rng(1))
    path = tmp_path_factory.mktemp("video") / "robots.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), RATE_HZ, SIZE, False)
    for k in range(COUNT):
        angle = 0.8 * k / RATE_HZ + np.array([0.0, math.pi])
        writer.write(renderer.render(np.stack([0.2 * np.cos(angle), 0.2 * np.sin(angle), angle], axis=1)))
    writer.release()
    return path


def run(folder: Path, monkeypatch: pytest.MonkeyPatch, *words: object) -> tuple[int, str, str]:
    """Return exit code, stdout and stderr."""
    monkeypatch.chdir(folder)
    done = robofleet("track", *words, env={"COLUMNS": "100"}, prog_name="robofleet")
    return done.exit_code, done.stdout, done.stderr


@pytest.mark.slow
def test_a_video_becomes_poses_a_picture_and_a_film(
    video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = video, "--ids", "4-6", "--side-mm", 70, "--film", "film.mp4"
    code, shown, errors = run(tmp_path, monkeypatch, *given)
    assert code == 0, errors
    assert shown.splitlines()[-3:] == ["robots-poses.csv", "robots-poses.png", "film.mp4"]
    assert "100.0" in shown
    assert "tag 6 was never seen" in errors
    assert "above them" in errors
    with (tmp_path / "robots-poses.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == 2 * COUNT
    assert {row["tag"] for row in rows} == {"4", "5"}
    assert float(rows[-1]["t_s"]) == pytest.approx((COUNT - 1) / RATE_HZ, abs=1e-3)
    first, other = (complex(float(row["x_m"]), float(row["y_m"])) for row in rows[:2])
    assert abs(first - other) == pytest.approx(0.4, abs=0.004)
    assert all(0 < float(row["x_sigma_m"]) < 0.001 for row in rows)
    picture = cv2.imread(str(tmp_path / "robots-poses.png"))
    assert picture.shape[1] == SIZE[0]
    assert np.ptp(picture.astype(int), axis=2).max() > 50, "it has colours"
    film = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    assert (film.get(cv2.CAP_PROP_FRAME_COUNT), film.get(cv2.CAP_PROP_FPS)) == (COUNT, RATE_HZ)
    assert run(tmp_path, monkeypatch, *given)[0] == 2, "no file is overwritten"


@pytest.mark.slow
def test_a_video_that_breaks_off_keeps_what_was_read(
    video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cut.avi").write_bytes(video.read_bytes()[: round(0.6 * video.stat().st_size)])
    code, shown, errors = run(tmp_path, monkeypatch, "cut.avi", "--ids", "4,5", "--side-mm", 70)
    assert code == 1
    assert "the video is truncated" in errors
    assert "all images before it are kept" in errors
    rows = (tmp_path / "cut-poses.csv").read_text().splitlines()[1:]
    assert f"{len(rows) // 2} images" in shown
    assert 0 < len(rows) < 2 * COUNT


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["none.mp4", "--ids", "1", "--side-mm", "70"], "none.mp4: No such file or directory"),
        (["VIDEO", "--ids", "1", "--side-mm", "70"], "no tag 1 of 36h11 is seen, but tags 4, 5: name these ids"),
        (["VIDEO", "--ids", "one", "--side-mm", "70"], "--ids: 'one' is no number and no range"),
        (["VIDEO", "--ids", "4", "--side-mm", "70", "--film", "film.avi"], "ends with .mp4"),
        (["VIDEO", "--ids", "4", "--side-mm", "70", "--rate", "0"], "--rate: 0 is not between"),
        (["VIDEO", "--ids", "4", "--side-mm", "70", "--camera", "none.yaml"], "none.yaml: No such file or directory"),
        (["/dev/none", "--ids", "4", "--side-mm", "70"], "/dev/none cannot be opened"),
    ],
)
def test_bad_input_ends_with_one_line(
    words: list[str], why: str, video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, shown, errors = run(tmp_path, monkeypatch, *(str(video) if word == "VIDEO" else word for word in words))
    assert (code, shown) == (2, "")
    assert why in errors.replace("\n", " ")
    assert list(tmp_path.iterdir()) == []


def test_poses_may_be_printed(video: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code, shown, _ = run(tmp_path, monkeypatch, video, "--ids", "4,5", "--side-mm", 70, "--out", "-")
    assert code == 0
    assert len(list(csv.DictReader(shown.splitlines()))) == 2 * COUNT
    assert list(tmp_path.iterdir()) == []


def test_numbers_are_ranges_and_lists() -> None:
    assert numbers("1-3, 7,2") == [1, 2, 3, 7]
    for wrong in ("", "3-1", "1-", "a", "0-99999", "-1"):
        with pytest.raises(RefusedError, match="--ids"):
            numbers(wrong)
