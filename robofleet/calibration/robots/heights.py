"""How high a robot's tag lies: by its size in one camera's images, and by the parallax of two cameras.

A tag that appears larger is larger, or is nearer to the camera. So the size tells the height no better than the side of
the tag is known; with a height by parallax it tells the side.
"""

import math
from dataclasses import dataclass

import numpy as np

from robofleet.bus.keys import NEWS, POSES, key
from robofleet.bus.messages import FLEET_POSES, TRACKER_NEWS
from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.core.clock import S
from robofleet.recording.run import Recording
from robofleet.tracking.events import TrackerEvent
from robofleet.tracking.filter.agreement import Agreement
from robofleet.tracking.filter.estimator import COLUMNS, measurements, rows_of
from robofleet.tracking.filter.joined import Seen
from robofleet.tracking.filter.parallax import Parallax

_WORST_M = 0.0005  # standard deviation with which a height is kept
_SIZE_SIGMA_M = 0.0003  # of a height by a tag's size: noise, and what the model of blur misses at corners
_KNOWN_M = 0.01  # standard deviation of a height, from which on it is not known at all


@dataclass(frozen=True, kw_only=True)
class TagHeight:
    """What a drive says of one tag's height; each estimate with its standard deviation [m], None: unknown."""

    robot: str
    tag: int
    configured_m: float
    side_m: float
    camera_m: float  # height of the cameras, their mean
    by_size: tuple[float, float] | None  # higher than configured, if the side is right; without the side's tolerance
    by_parallax: tuple[float, float] | None  # likewise, whatever the side
    side_tolerance_m: float

    @property
    def higher(self) -> tuple[float, float] | None:
        """How much higher than configured the tag lies, by both estimates, and the standard deviation [m]."""
        known = [self.by_parallax] if self.by_parallax else []
        if self.by_size:
            known.append((self.by_size[0], math.hypot(self.by_size[1], self.side_tolerance_m * self._per_side)))
        weight = sum(1.0 / sigma**2 for _, sigma in known)
        return (sum(m / sigma**2 for m, sigma in known) / weight, weight**-0.5) if known else None

    @property
    def measured_m(self) -> float | None:
        """The height, where it is known well enough to be kept."""
        if self.higher is None or self.higher[1] > _WORST_M:
            return None
        return self.configured_m + self.higher[0]

    @property
    def _per_side(self) -> float:
        """By how much a height changes by the size, with the side."""
        return (self.camera_m - self.configured_m) / self.side_m

    @property
    def sentence(self) -> str:
        """What was found, for people."""
        name = f"{self.robot}: tag {self.tag}"
        if self.higher is None:
            return f"{name}: its height was not measured: no camera saw it long enough, or all poses are simulated"
        found, higher = [], 0.0
        if self.by_parallax is not None:
            higher, sigma = self.by_parallax
            found.append(f"lies {_way(higher)} than configured by two cameras (± {1e3 * sigma:.1f} mm)")
        if self.by_size is not None:
            larger = self.by_size[0] / (self._per_side * self.side_m)
            side_m = self.side_m + (self.by_size[0] - higher) / self._per_side
            side = f"its side is {1e3 * side_m:.2f} mm"
            either = "" if self.by_parallax else f"it lies {_way(self.by_size[0])} than configured, or "
            found.append(f"appears {abs(larger):.2%} {'larger' if larger > 0 else 'smaller'}: {either}{side}")
        return f"{name} {', and '.join(found)}"


def by_size(recording: Recording) -> dict[int, Array]:
    """Return how much higher than configured each tag appears by its size (H, 2), by the newest of each tracker's news;
    see ``drive_file``."""
    config, newest = recording.config, dict[tuple[str, int], float]()
    for camera in config.camera_names:
        for payload in recording.messages.get(key(config.arena.name, NEWS, camera), ()):
            news = TRACKER_NEWS.decode(payload)
            if news is not None and news.event == TrackerEvent.TAG_SIZE:
                newest[camera, news.tag] = news.value
    heights = {robot.tag: [m for (_, tag), m in newest.items() if tag == robot.tag] for robot in config.members}
    return {tag: np.array([[np.mean(m), _SIZE_SIGMA_M]] if m else np.empty((0, 2))) for tag, m in heights.items()}


def by_parallax(recording: Recording) -> dict[int, Array]:
    """Return how much higher than configured each tag lies by two cameras (H, 2); see ``drive_file``."""
    config, images = recording.config, list[Seen]()
    robots, cameras = config.members, config.camera_names
    rows, latest_ns = rows_of({robot.tag: row for row, robot in enumerate(robots)}), np.iinfo(np.int64).max
    for number, camera in enumerate(cameras):
        for payload in recording.messages.get(key(config.arena.name, POSES, camera), ()):
            if (message := FLEET_POSES.view(payload)) is not None and message[0].echo_tick:
                poses, instants_ns = np.empty((len(robots), COLUMNS)), np.empty(len(robots), np.int64)
                exposure_ns = message[0].echo_tick * round(config.controller.tick_s * S) + message[0].since_tick_ns
                measurements(message[1], rows, exposure_ns, latest_ns, poses, instants_ns)
                images.append(Seen(number, poses, instants_ns))
    parallax, everybody = Parallax.of(config), np.ones(len(robots), np.bool_)
    noise = config.controller.filter.position_noise_m
    agreement = Agreement(everybody, noise, np.ones(len(cameras), np.bool_), parallax)
    for seen in sorted(images, key=lambda seen: seen.exposed_ns):
        agreement.look(seen, np.full_like(seen.poses, np.nan))
    higher, by_noise, by_calibration = parallax.heights()
    sigma = np.hypot(by_noise, by_calibration)
    known = np.isfinite(sigma) & (sigma < _KNOWN_M)
    heights = np.column_stack([higher, sigma])
    return {robot.tag: heights[row : row + known[row]] for row, robot in enumerate(robots)}


def find(config: Config, drive: RobotDrive) -> TagHeight:
    """Return what a drive says of a tag's height."""
    robot, poses = config.robot(drive.robot), [view.camera.model.T_world_camera for view in config.views]
    heights = [pose.position_m[2] for pose in poses if pose is not None]
    return TagHeight(
        robot=drive.robot, tag=robot.tag, configured_m=slices.tag_height_m(config, robot),
        side_m=config.tracker.tag_side_m, camera_m=sum(heights) / max(len(heights), 1),
        by_size=_estimate(drive.higher_by_size), by_parallax=_estimate(drive.higher_by_parallax),
        side_tolerance_m=config.tracker.tag_side_tolerance_m,
    )  # fmt: skip


def _estimate(rows: Array) -> tuple[float, float] | None:
    return (float(rows[0, 0]), float(rows[0, 1])) if len(rows) else None


def _way(higher: float) -> str:
    return f"{1e3 * abs(higher):.1f} mm {'higher' if higher > 0 else 'lower'}"
