"""Poses of tags in recordings, without a fleet: as a program of a user's own asks for them."""

import math
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from robofleet.config.calibrated import CameraModel
from robofleet.simulation.camera import SceneRenderer
from robofleet.tracking import TrackedImage, track
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.sources import CameraError, Frame
from robofleet.tracking.tags.targets import Target
from tests.tracking.raycamera import RayCamera
from tests.tracking.raycast import Print, RayCaster, clutter

SIZE, SIDE, HEIGHT, RATE_HZ, COUNT = (640, 360), 0.07, 0.05, 25, 40
IDS = (1, 2, 3, 7)
MODEL = CameraModel(
    width=SIZE[0], height=SIZE[1], focal_px=(500.0, 500.0), centre_px=(322.0, 178.0), distortion=(-0.05, 0.01, 0, 0)
)


def pose(t: float) -> NDArray[np.float64]:
    """Return the true poses (N, 3) of the tags."""
    angle = 0.4 * t + np.arange(len(IDS)) * math.tau / len(IDS)
    return np.stack([0.5 * np.cos(angle), 0.28 * np.sin(angle), angle + math.pi / 2], axis=1)


@pytest.fixture(scope="module")
def geometry() -> CameraGeometry:
    T = np.eye(4)
    T[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ cv2.Rodrigues(np.radians([5.0, -4.0, 0.0]))[0]
    T[:3, 3] = 0.05, -0.02, 1.4
    (f, _), (c_x, c_y) = MODEL.focal_px, MODEL.centre_px
    return CameraGeometry([[f, 0, c_x], [0, f, c_y], [0, 0, 1]], MODEL.distortion, T)


@pytest.fixture(scope="module")
def images(geometry: CameraGeometry) -> list[NDArray[np.uint8]]:
    robots = [Target(tag, SIDE, HEIGHT, 0.5) for tag in IDS]
    renderer = SceneRenderer(geometry, SIZE, robots, 2.0, np.random.default_rng(1))
    return [renderer.render(pose(k / RATE_HZ)).copy() for k in range(COUNT)]


@pytest.fixture(scope="module")
def video(images: list[NDArray[np.uint8]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("video") / "robots.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), RATE_HZ, SIZE, False)
    for image in images:
        writer.write(image)
    writer.release()
    return path


def off_mm(found: list[TrackedImage]) -> NDArray[np.float64]:
    """Return how far off positions are when the frames are laid over each other."""
    measured = [(image.t_s, pose) for image in found for pose in image.poses if pose.coasted_ns == 0]
    seen = np.array([p.x_m + 1j * p.y_m for _, p in measured])
    true = np.array([complex(*pose(t)[IDS.index(p.tag), :2]) for t, p in measured])
    seen, true = seen - seen.mean(), true - true.mean()
    turn = (true * seen.conj()).sum()
    return np.asarray(1e3 * np.abs(seen * turn / abs(turn) - true))


def test_a_video_alone_gives_poses(video: Path) -> None:
    tracks = track(video, ids=IDS, side_m=SIDE)
    found = list(tracks)
    assert (tracks.count, len(found), tracks.rate_hz) == (COUNT, COUNT, RATE_HZ)
    assert [image.t_s for image in found] == pytest.approx(np.arange(COUNT) / RATE_HZ, abs=1e-3)
    assert {pose.tag for image in found for pose in image.poses} == set(IDS)
    off = off_mm(found)
    assert len(off) > 0.98 * COUNT * len(IDS)
    assert off.max() < 3.0
    assert np.sqrt((off**2).mean()) < 1.0
    (note,) = tracks.notes
    assert "not calibrated" in note


def test_a_calibrated_camera_gives_poses_in_the_laboratorys_frame(video: Path, geometry: CameraGeometry) -> None:
    T = {
        "position_m": geometry.position.tolist(),
        "rotation_rad": cv2.Rodrigues(geometry.T_world_camera[:3, :3])[0][:, 0].tolist(),
    }
    model = CameraModel.model_validate(MODEL.model_dump() | {"T_world_camera": T})
    tracks = track(video, ids=IDS, side_m=SIDE, camera=model, height_m=HEIGHT)
    assert tracks.notes == ()
    last = list(tracks)[-1]
    for found in last.poses:
        x, y, psi = pose(last.t_s)[IDS.index(found.tag)]
        assert (found.x_m, found.y_m) == pytest.approx((x, y), abs=2e-4)
        assert math.remainder(found.psi_rad - psi, math.tau) == pytest.approx(0.0, abs=0.02)
    outlines = tracks.outlines(last.poses)
    centres = geometry.project(np.column_stack([pose(last.t_s)[:, :2], np.full(len(IDS), HEIGHT)]))
    for tag, corners in outlines.items():
        assert corners.mean(0) == pytest.approx(centres[IDS.index(tag)], abs=1.0)
    with pytest.raises(CameraError, match=r"side seems to be 70\.\d mm, not 50 mm"):
        track(video, ids=IDS, side_m=0.05, camera=model, height_m=HEIGHT)


@pytest.mark.slow
def test_a_live_camera_is_tracked_from_its_images_on(images: list[NDArray[np.uint8]]) -> None:
    class Live:
        identity = "live"

        def __init__(self) -> None:
            self.shown = 0

        def read(self) -> Frame:
            self.shown += 1
            if self.shown > 5 * COUNT:
                raise EOFError("over")
            return Frame(images[self.shown % COUNT], self.shown * 10**9 // RATE_HZ)

        def close(self) -> None:
            pass

    live = Live()
    tracks = track(live, ids=IDS, side_m=SIDE)
    assert tracks.count == 0
    before = live.shown
    assert before < 4 * RATE_HZ, "it looks for three seconds"
    assert [len(image.poses) for image in islice(tracks, 3)] == [4, 4, 4]
    assert live.shown == before + 3


def test_what_is_seen_in_place_of_the_tags_is_said(images: list[NDArray[np.uint8]], tmp_path: Path) -> None:
    def why(image: NDArray[np.uint8], family: str = "36h11", ids: tuple[int, ...] = IDS) -> str:
        assert cv2.imwrite(str(tmp_path / "one.png"), image)
        with pytest.raises(CameraError) as error:
            track(tmp_path / "one.png", ids=ids, side_m=SIDE, family=family)
        return str(error.value)

    assert "but tags 1 to 3, 7: name these ids" in why(images[0], ids=(5,))
    assert "but tags 1 to 3, 7 of 36h11: name that family" in why(images[0], "25h9")
    assert "mirrored: switch a horizontal flip off" in why(np.ascontiguousarray(images[0][:, ::-1]))
    small = np.asarray(cv2.resize(images[0], None, fx=0.33, fy=0.33, interpolation=cv2.INTER_AREA), np.uint8)
    assert "but tags with a side of 8 px: at least 14 px are needed" in why(small)
    assert "and no other tag" in why(np.full_like(images[0], 128))


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        ({"family": "36h12"}, "'36h12' is not known"),
        ({"ids": (600,)}, "600: the family 36h11 has the ids 0 to 586"),
        ({"ids": (1, 1)}, "each once"),
        ({"side_m": 70.0}, "70000 mm is not between"),
        ({"fov_deg": 0.5}, "it is horizontal"),
    ],
)
def test_arguments_that_cannot_be_are_refused(arguments: dict[str, object], why: str) -> None:
    with pytest.raises(CameraError, match=why):
        track("none.mp4", **{"ids": (1,), "side_m": SIDE} | arguments)  # type: ignore[arg-type]


@pytest.mark.slow
def test_times_of_a_folder_come_from_a_rate_or_its_names(images: list[NDArray[np.uint8]], tmp_path: Path) -> None:
    for k in range(4):
        assert cv2.imwrite(str(tmp_path / f"{k}.png"), images[k])
    with pytest.raises(CameraError, match="numbers, and no times"):
        track(tmp_path, ids=IDS, side_m=SIDE)
    assert [image.t_s for image in track(tmp_path, ids=IDS, side_m=SIDE, rate_hz=10.0)] == [0.0, 0.1, 0.2, 0.3]


@pytest.mark.slow
def test_frames_of_an_independent_renderer_become_poses_without_any_calibration(tmp_path: Path) -> None:
    rng, size = np.random.default_rng(3), (1280, 720)
    T = np.eye(4)
    T[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ cv2.Rodrigues(np.radians([6.0, -4.0, 0.0]))[0]
    T[:3, 3] = 0.1, 0.0, 1.6
    K = np.array([[860.0, 0.0, 644.0], [0.0, 860.0, 356.0], [0.0, 0.0, 1.0]])
    camera = RayCamera(size, K, np.array([-0.12, 0.02, 0.0005, -0.0004, 0.0]), T, exposure=0.004)
    caster = RayCaster(camera, clutter(size, rng), rng)
    places = [0.8 * math.cos(a) + 0.42j * math.sin(a) for a in 0.35 * np.arange(18)]  # of five tags in turn
    for k in range(12):
        prints = [Print(tag, SIDE, HEIGHT, (places[k + tag].real, places[k + tag].imag, 0.7 * tag)) for tag in range(5)]
        assert cv2.imwrite(str(tmp_path / f"{k}.png"), caster.image(prints, 1.0, 2.0))
    seen, true = [], []
    for image in track(tmp_path, ids=range(5), side_m=SIDE, rate_hz=2.0):
        seen += [found.x_m + 1j * found.y_m for found in image.poses]
        true += [places[image.number + found.tag] for found in image.poses]
    assert len(seen) == 60
    off = np.array(seen) - np.mean(seen), np.array(true) - np.mean(true)
    turn = (off[1] * off[0].conj()).sum()
    assert np.abs(off[0] * turn / abs(turn) - off[1]).max() < 0.001
