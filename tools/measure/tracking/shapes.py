"""Prints that are stretched, bowed or tilted, and tags at another height: headings, and what is named.

    python -m tools.measure.tracking.shapes [--seconds N] [--cases NAME]

A 1080p camera 2.5 m up sees four tags of 70 mm on robots that drive circles of 0.3 to 0.4 m at 0.12 m/s, at 30 images a
second, on ray-cast frames; the tracker is the whole one. Columns: the headings' rms in the first ten images, and in the
second half [deg]; the mean of their squared errors there by their variances; the position's rms there [mm], of where a
tag of the configured height would appear; what is named, the mean over the tags, and after how long the last one was
[s]. Higher tags: how much higher by the size of exact sides, the mean and the largest error [mm]; with a second camera,
0.6 m beside, the same by parallax.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from robofleet.core.arrays import Array
from robofleet.core.clock import S
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.events import TrackerEvent
from robofleet.tracking.filter.agreement import Agreement
from robofleet.tracking.filter.joined import Seen
from robofleet.tracking.filter.parallax import Parallax
from robofleet.tracking.tags.targets import Target
from robofleet.tracking.tags.tracker import TagTracker
from tests.tracking.raycamera import RayCamera
from tests.tracking.raycast import Print, RayCaster, along, clutter
from tools.measure.program import program
from tools.measure.tracking.accuracy import HEIGHT, PERIOD, SIDE, Scene, camera

TAGS = (7, 30, 211, 400)
MIDDLES = np.array([[-0.75, -0.3], [0.75, 0.3], [-0.8, 0.3], [0.85, -0.3]])
TURNS = np.array([0.3, -0.35, 0.4, -0.4])  # [rad/s]
SPEED, BESIDE = 0.12, 0.6  # [m/s], [m]
LIGHT, NOISE = 0.7, 3.5
CASES: dict[str, dict[str, Any]] = {
    "flat and level": {},
    "stretched 0.3 %": {"stretch": (0.003, 0.0)},
    "stretched 0.5 %": {"stretch": (0.005, 0.0)},
    "stretched 1 %": {"stretch": (0.0, 0.01)},
    "bowed 1 mm": {"bow": -0.001},
    "tilted 5 degrees": {"tilt": (math.radians(3.0), math.radians(-4.0))},
    "all three": {"stretch": (0.005, 0.0), "bow": 0.001, "tilt": (math.radians(2.0), 0.0)},
}
HIGHER_M = (0.0, 0.001, -0.002, 0.005)


class Drive(NamedTuple):
    """What trackers saw of a drive."""

    error: Array  # (K, 4, 3) of the first: x, y [m], psi [rad]
    variance: Array  # (K, 4, 3)
    named: dict[tuple[TrackerEvent, int], tuple[float, float]]  # by the first: the newest value, and when [s]
    parallax: Parallax


def drive(images: int, cameras: Sequence[RayCamera], higher: float = 0.0, **of_print: Any) -> Drive:
    casters, trackers, blanks = [], [], []
    for eye in cameras:
        rng = np.random.default_rng(3)
        casters.append(RayCaster(eye, clutter(eye.size, rng), rng))
        blanks.append(casters[-1].image((), LIGHT, NOISE))  # noise anew where tags are is enough
        targets = [Target(tag, SIDE, HEIGHT, 0.3, side_tolerance=0.0) for tag in TAGS]
        trackers.append(TagTracker(CameraGeometry(eye.K, eye.distortion, eye.T_world_camera), eye.size, targets))
    feet = np.array([eye.T_world_camera[:3, 3] for eye in cameras])
    parallax = Parallax(feet, np.full(len(TAGS), HEIGHT))
    agreement = Agreement(np.ones(len(TAGS), np.bool_), 1e-5, np.zeros(len(cameras), np.bool_), parallax)
    error, variance = np.full((2, images, len(TAGS), 3), np.nan)
    named: dict[tuple[TrackerEvent, int], tuple[float, float]] = {}
    for k, poses in enumerate(_circles(images)):
        prints = [Print(tag, SIDE, HEIGHT + higher, pose, (SPEED, 0.0, turn), **of_print)
                  for tag, pose, turn in zip(TAGS, poses, TURNS.tolist(), strict=True)]  # fmt: skip
        at_ns = S + round(k * PERIOD * S)
        for number, (caster, tracker, blank) in enumerate(zip(casters, trackers, blanks, strict=True)):
            sightings = tracker.track(_image(caster, blank, prints), at_ns)
            seen = np.full((len(TAGS), 9), np.nan)
            for pose in sightings.poses:
                if pose.coasted_ns == 0:
                    seen[TAGS.index(pose.tag)] = pose.x, pose.y, pose.psi, *pose.covariance
            agreement.look(Seen(number, seen, np.full(len(TAGS), at_ns)), np.full_like(seen, np.nan))
            if number:
                continue
            named |= {(event, tag): (value, k * PERIOD) for event, tag, value in sightings.happenings}
            true = np.array(poses)
            true[:, :2] += higher * (true[:, :2] - feet[0, :2]) / (feet[0, 2] - HEIGHT - higher)
            error[k], variance[k] = seen[:, :3] - true, seen[:, [3, 5, 8]]
    error[..., 2] = np.remainder(error[..., 2] + math.pi, math.tau) - math.pi
    return Drive(error, variance, named, parallax)


def _circles(images: int) -> Iterator[list[tuple[float, float, float]]]:
    heading = np.random.default_rng(11).uniform(-math.pi, math.pi, len(TAGS))
    radius = (SPEED / TURNS)[:, None] * np.column_stack([np.sin(heading), -np.cos(heading)])
    starts = np.column_stack([MIDDLES + radius, heading])
    for k in range(images):
        yield [
            (float(x), float(y), float(psi))
            for start, turn in zip(starts.tolist(), TURNS.tolist(), strict=True)
            for x, y, psi in [along(start, (SPEED, 0.0, turn), k * PERIOD)]
        ]


def _image(caster: RayCaster, blank: NDArray[np.uint8], prints: Sequence[Print]) -> NDArray[np.uint8]:
    image = blank.copy()
    for patch in map(caster.patch, prints):
        light = (caster.floor[patch.where] * (1.0 - patch.cover) + patch.light) * caster.lamps[patch.where]
        image[patch.where] = caster.exposed(light * np.float32(LIGHT), NOISE)
    return image


def _shown(event: TrackerEvent, named: dict[tuple[TrackerEvent, int], tuple[float, float]]) -> str:
    values, times = np.array([row for (kind, _), row in named.items() if kind is event]).T
    unit, scale = ("%", 100.0) if event is TrackerEvent.PRINT_STRETCHED else ("mm", 1e3)
    return f"{event.name} {scale * values.mean():+.3f} {unit}, {len(values)} of {len(TAGS)}, {times.max():.1f} s"


def main() -> None:
    parser = program(
        __doc__,
        seconds=(20, "of each drive; of higher tags half as many more"),
        cases=("", "whose name has this in it"),
    )
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    images = round(arguments.seconds / PERIOD)
    eye = camera(Scene(NOISE), 0.7)
    print(f"{'':<18}{'first deg':>10}{'deg':>8}{'chi2 psi':>10}{'mm':>8}")
    for title, of_print in CASES.items():
        if arguments.cases not in title:
            continue
        found = drive(images, [eye], **of_print)
        half, psi = found.error[images // 2 :], np.degrees(found.error[..., 2])
        chi = np.nanmean(half[..., 2] ** 2 / found.variance[images // 2 :, :, 2])
        position = 1e3 * _rms(np.hypot(half[..., 0], half[..., 1]))
        print(
            f"{title:<18}{_rms(psi[:10]):>10.4f}{_rms(psi[images // 2 :]):>8.4f}{chi:>10.2f}{position:>8.4f}", end="  "
        )
        prints = (TrackerEvent.PRINT_STRETCHED, TrackerEvent.TAG_BOWED)
        print(
            "; ".join(_shown(e, found.named) for e in prints if any(e is kind for kind, _ in found.named)), flush=True
        )
    T = eye.T_world_camera.copy()
    T[0, 3] += BESIDE
    other = replace(eye, T_world_camera=T)
    for higher in HIGHER_M:
        title = f"{1e3 * higher:+g} mm higher"
        if arguments.cases in title:
            found = drive(3 * images // 2, [eye, other], higher)
            size = np.array([v for (kind, _), (v, _) in found.named.items() if kind is TrackerEvent.TAG_SIZE])
            heights = found.parallax.heights()
            parallax = heights.higher[heights.noise < 1.0]
            shown = [
                f"by {by} {1e3 * m.mean():+.3f} mm, at most {1e3 * np.abs(m - higher).max():.3f} off ({len(m)} tags)"
                for by, m in (("size", size), ("parallax", parallax))
            ]
            print(f"{title:<18}{'; '.join(shown)}", flush=True)


def _rms(values: Array) -> float:
    return math.sqrt(np.nanmean(values**2))


if __name__ == "__main__":
    main()
