"""The tracker's rows of ``bench.py``: following, the whole tracker, acquisition, rendering; peers in the same loop."""

from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.core.clock import S, stopwatch_ns
from robofleet.simulation.camera import SceneRenderer
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.tags.detection import TagDetector
from robofleet.tracking.tags.photometric import PhotometricFit
from robofleet.tracking.tags.targets import Target
from robofleet.tracking.tags.tracker import TagTracker

Row = dict[str, Any]
Image = NDArray[np.uint8]
Poses = NDArray[np.float64]

_FULL_HD, _ULTRA_HD = (1920, 1080), (3840, 2160)
_PERIOD_NS = 33_000_000
_SIDE, _HEIGHT, _SPEED = 0.07, 0.08, 0.2  # [m, m, m/s]
_LAP = 60  # images in which each robot drives a circle
_ROUNDS = 6  # laps


class Scene(NamedTuple):
    """Robots that drive circles under a camera 2.5 m up."""

    size: tuple[int, int]  # of its images [px]
    geometry: CameraGeometry
    targets: list[Target]
    images: list[Image]
    poses: list[Poses]  # of each image, (N, 3)


def rows() -> list[Row]:
    """Return the rows; ratios are to robofleet's median, or p99 where that is what the row says."""
    found = []
    for count in (4, 50):
        scene = _scene(count, _FULL_HD)
        found += [*_following(scene), *_whole(scene, _peers(scene)), *_acquisition(scene)]
    for count, size in ((20, _FULL_HD), (100, _FULL_HD), (100, _ULTRA_HD)):
        found += _whole(_scene(count, size), {})
    return found + _rendering()


def _following(scene: Scene) -> list[Row]:
    """Fit every tag near where it is expected: 0.3 px off."""
    fit = PhotometricFit(scene.geometry, scene.targets)
    rng, index = np.random.default_rng(1), np.arange(len(scene.targets))
    times = []
    for k in range(_ROUNDS * _LAP):
        poses = scene.poses[k % _LAP]
        centre = poses[:, 0] + 1j * poses[:, 1] + rng.normal(0.0, 4e-4, (2, len(poses))).T @ [1.0, 1j]
        times.append(timed(fit.fit, scene.images[k % _LAP], index, centre, poses[:, 2])[0])
    return percentiles(f"follow {len(index)} tags, 1920 x 1080", {"robofleet": times})


def _peers(scene: Scene) -> dict[str, Callable[[Image], object]]:
    """Return what a user would call on each image."""
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    default = cv2.aruco.ArucoDetector(family)
    fleet = cv2.aruco.Dictionary(family.bytesList[[t.tag for t in scene.targets]], 6, family.maxCorrectionBits)
    tuned = cv2.aruco.ArucoDetector(fleet, _tuned())
    return {
        "OpenCV, default parameters": default.detectMarkers,
        "OpenCV, tuned": tuned.detectMarkers,
        **_libraries(),
    }


def _whole(scene: Scene, others: dict[str, Callable[[Image], object]]) -> list[Row]:
    """The whole tracker, newcomer scan included, and others."""
    tracker = TagTracker(scene.geometry, scene.size, scene.targets)
    times: dict[str, list[float]] = {"robofleet": [], **{who: [] for who in others}}
    measured = 0
    for k in range(_ROUNDS * _LAP):
        image = scene.images[k % _LAP]
        ms, sightings = timed(tracker.track, image, S + k * _PERIOD_NS)
        times["robofleet"].append(ms)
        measured += sum(pose.coasted_ns == 0 for pose in sightings.poses)
        if k % 12 == 0:  # the others are slow, and need no memory of the images between
            for who, detect in others.items():
                times[who].append(timed(detect, image)[0])
    share = measured / (_ROUNDS * _LAP * len(scene.targets))
    times[f"robofleet, {100 * share:.2f} % measured"] = times.pop("robofleet")
    order = [next(reversed(times)), *others]
    what = f"whole tracker, {len(scene.targets)} tags, {scene.size[0]} x {scene.size[1]}"
    return percentiles(what, {who: times[who] for who in order})


def _acquisition(scene: Scene) -> list[Row]:
    detector = TagDetector(PhotometricFit(scene.geometry, scene.targets), scene.targets)
    found, times = 0, []
    for image in scene.images:
        ms, findings = timed(detector.detect, image)
        times.append(ms)
        found += len(findings.tags)
    share = found / (len(scene.targets) * len(scene.images))
    what = f"acquire {len(scene.targets)} tags in one image"
    return percentiles(what, {f"robofleet, {100 * share:.2f} % found": times})


def _rendering() -> list[Row]:
    result = []
    for width, height, count in ((1280, 720, 4), (1920, 1080, 50)):
        renderer = _renderer(_geometry(width, height), (width, height), count)
        poses = [_circles(count, k) for k in range(_LAP)]
        times = [timed(renderer.render, p)[0] for p in poses * 3]
        result += percentiles(f"render {count} tags, {width} x {height}", {"robofleet": times})
    return result


def _scene(count: int, size: tuple[int, int]) -> Scene:
    geometry = _geometry(*size)
    renderer = _renderer(geometry, size, count)
    poses = [_circles(count, k) for k in range(_LAP)]
    images = [renderer.render(p).copy() for p in poses]
    return Scene(size, geometry, _targets(count), images, poses)


def _geometry(width: int, height: int) -> CameraGeometry:
    focal = 830.0 * width / 1280  # as configs/cameras/overhead.yaml
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array([3.1411141738120056, 0.0, 0.0548283518508331]))[0]
    T[2, 3] = 2.5
    K = [[focal, 0.0, width / 2 + 5], [0.0, focal, height / 2 - 1], [0.0, 0.0, 1.0]]
    return CameraGeometry(K, [-0.1, 0.015, 0.0004, -0.0003, 0.0], T)


def _renderer(geometry: CameraGeometry, size: tuple[int, int], count: int) -> SceneRenderer:
    return SceneRenderer(geometry, size, _targets(count), 3.5, np.random.default_rng(1))


def _targets(count: int) -> list[Target]:
    return [Target(tag + 1, _SIDE, _HEIGHT, _SPEED) for tag in range(count)]


def _circles(count: int, k: int) -> Poses:
    """Return poses (N, 3) on circles around the places of a grid, at up to the fastest speed."""
    columns = 2 if count < 10 else 10 if count < 100 else 13
    i = np.arange(count)
    phase = 2.0 * np.pi * (k / _LAP + i * 0.618)
    radius = np.linspace(0.02, 0.06 if count < 100 else 0.045, count)
    x = np.linspace(-1.35, 1.35, columns)[i % columns] + radius * np.cos(phase)
    y = np.linspace(-0.75, 0.75, -(-count // columns))[i // columns] + radius * np.sin(phase)
    return np.column_stack([x, y, phase + np.pi / 2])


def _tuned() -> cv2.aruco.DetectorParameters:
    parameters = cv2.aruco.DetectorParameters()
    parameters.adaptiveThreshWinSizeMin = parameters.adaptiveThreshWinSizeMax = 13
    parameters.adaptiveThreshConstant = 15
    parameters.minMarkerPerimeterRate = 0.04
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    return parameters


def _libraries() -> dict[str, Callable[[Image], object]]:
    found: dict[str, Callable[[Image], object]] = {}
    for module in ("pyapriltags", "pupil_apriltags"):
        try:
            library = __import__(module)
        except ImportError:
            print(f"{module} is not installed (pip install -e '.[bench]'): its row is left out")
            continue
        name = module.replace("_", "-")
        if module == "pupil_apriltags":  # it frees its families before the detector that reads them, and crashes
            library.Detector.__del__ = lambda _: None
        found[f"{name}, decimate 2"] = library.Detector(families="tag36h11", nthreads=1, quad_decimate=2.0).detect
    return found


def timed(run: Callable[..., Any], *arguments: object) -> tuple[float, Any]:
    """Return how long a call takes [ms], and what it gives."""
    started = stopwatch_ns()
    result = run(*arguments)
    return (stopwatch_ns() - started) / 1e6, result


def percentiles(what: str, times: dict[str, list[float]]) -> list[Row]:
    """Return rows of the median and the 99th percentile [ms]; of peers the median alone."""
    result = []
    for label, percent in (("p50", 50), ("p99", 99)):
        values = {who: float(np.percentile(ms[3:], percent)) for who, ms in times.items()}
        first = next(iter(values.values()))
        for who, value in values.items():
            if who.startswith("robofleet") or percent == 50:
                row = {"what": f"{what}, {label}", "who": who, "value": value, "unit": "ms", "ratio": value / first}
                result.append(row)
    return result
