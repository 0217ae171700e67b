"""What a simulated projector shows of a run: shapes, references, halos, and discs in which tags are seen.

It draws what viewers draw, at full contrast, of what the bus told until the instant of the drawing. What moves stands
where it will be in the middle of the time for which the picture is lit.
"""

from collections import deque

import cv2
import numpy as np

from robofleet.behaviours import described
from robofleet.behaviours.interface import Dots
from robofleet.bus.bus import Arrival, Bus
from robofleet.bus.keys import POSES, TICK, key
from robofleet.bus.messages import FLEET_POSES, TICK_RECORD, FleetPoses, TickRecord
from robofleet.config import obstacles, slices
from robofleet.config.groups import descriptions
from robofleet.config.projectors import ProjectorSettings
from robofleet.config.tree import Config
from robofleet.core.arrays import Array, Image
from robofleet.core.clock import S
from robofleet.projection.brush import Brush
from robofleet.projection.disc import disc_radii
from robofleet.projection.model import Projector, gray_shares
from robofleet.projection.prediction import ahead
from robofleet.safety.supervisor import Phase
from robofleet.vehicles.differential_drive import body_from_wheels

_LINE_M, _DOT_M, _HALO_M = 0.01, 0.02, 0.008  # widths of lines and halos, a dot's radius
_LONGEST_S = 0.1  # for which robots are taken to drive on without a tick, and from which on their discs grow
_KEPT = 256  # ticks between two images


class RunPicture:
    """Draws one projector's pictures of a run."""

    def __init__(self, config: Config, settings: ProjectorSettings, rate_hz: float, bus: Bus) -> None:
        assert settings.calibration is not None
        calibrated = {
            each.name: Projector.from_model(each.calibration) for each in config.projectors if each.calibration
        }
        projector = calibrated[settings.name]
        self._shares = None
        if len(calibrated) > 1:
            self._shares = np.rint(255 * gray_shares(calibrated, settings.name)).astype(np.uint8)
        self._brush, self._lit_after_s = Brush(projector), settings.calibration.delay_s + 0.5 / rate_hz
        self._white, self._gray = round(255 * settings.brightness), round(255 * settings.disc_gray)
        self._show = config.projection.show
        self._groups, self._robots = descriptions(config), config.bodies
        self._sizes = len(config.members), described.size(self._groups, len(config.camera_names))
        self._radii = disc_radii(config)
        self._heights = np.array([slices.tag_height_m(config, robot) for robot in self._robots])
        self._rows = {robot.tag: row for row, robot in enumerate(self._robots)}
        self._ticks, self._coming = bus.stream(key(config.arena.name, TICK), capacity=_KEPT), deque[Arrival]()
        self._views = [bus.newest(POSES, camera) for camera in config.camera_names] if config.bystanders else []
        self._tick: TickRecord | None = None
        self._measured_ns = np.zeros(len(config.members), np.int64)  # stamps of the ticks that measured each
        self._standing: dict[int, tuple[float, float]] = {}  # bystanders, by row
        self._still = self._drawn_once(config, projector)

    def at(self, instant_ns: int) -> Image | None:
        """Return the picture (H, W) that is drawn at an instant of the bus's clock; None before the first tick."""
        self._coming.extend(self._ticks.drain())
        while self._coming and self._coming[0].at_ns <= instant_ns:
            self._take(TICK_RECORD.decode(self._coming.popleft().payload))
        for view in self._views:
            self._see(FLEET_POSES.decode(view.take() or b""))
        return None if self._tick is None else self._drawn(self._tick, instant_ns)

    def _take(self, tick: TickRecord | None) -> None:
        if tick is not None and (len(tick.robots), len(tick.figures)) == self._sizes:
            self._tick = tick
            self._measured_ns[[robot.measured > 0 for robot in tick.robots]] = tick.stamp_ns

    def _see(self, image: FleetPoses | None) -> None:
        for pose in () if image is None else image.poses:
            row = self._rows.get(pose.tag, 0)
            if row >= self._sizes[0] and pose.coasted_ns == 0:
                self._standing[row] = pose.x_m, pose.y_m

    def _drawn_once(self, config: Config, projector: Projector) -> Image:
        """Draw what does not move."""
        picture = self._background(config, projector) if "background" in self._show else None
        picture = np.zeros(projector.size[::-1], np.uint8) if picture is None else picture
        if "paths" in self._show:
            for shape in (shape for group in self._groups for shape in group.shapes):
                if isinstance(shape, Dots):
                    self._dots(picture, shape.points)
                else:
                    self._line(picture, shape.points, closed=shape.closed)
        if "floor" in self._show:
            for solid in obstacles.standing(config.arena):
                self._line(picture, solid.outline, closed=True)
        return picture

    def _background(self, config: Config, projector: Projector) -> Image | None:
        """Return the image that fills the arena, as this projector shows it; None where there is none."""
        image = None if config.projection.background is None else cv2.imread(config.projection.background, 0)
        if image is None:
            return None
        u, v = np.meshgrid(*(np.arange(side, dtype=np.float64) for side in projector.size))
        floor = projector.floor(np.column_stack([u.ravel(), v.ravel()])).reshape(*u.shape, 2)
        scale = np.array(image.shape[1::-1]) / config.arena.size_m
        x, y = np.moveaxis(floor * scale * (1, -1) + (np.array(image.shape[1::-1]) - 1) / 2, 2, 0).astype(np.float32)
        shown = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        inside = (np.abs(floor) <= np.array(config.arena.size_m) / 2).all(axis=2)
        return np.asarray(np.rint(shown * inside * (self._white / 255)), np.uint8)

    def _line(self, picture: Image, points: Array, *, closed: bool) -> None:
        self._brush.line(picture, np.vstack([points, points[:1]]) if closed else points, _LINE_M, self._white)

    def _dots(self, picture: Image, points: Array) -> None:
        self._brush.discs(picture, points, np.full(len(points), _DOT_M), self._white)

    def _drawn(self, tick: TickRecord, instant_ns: int) -> Image:
        picture = self._still.copy()
        if tick.phase == Phase.RUNNING and "references" in self._show:
            parts = described.parts(self._groups, np.array([tick.figures]))
            references = np.concatenate([numbers[0, :, :2] for numbers in parts])
            self._dots(picture, references[np.isfinite(references).all(axis=1)])
        places, radii = self._members(tick, instant_ns)
        rows = [*range(len(places)), *self._standing]
        places = np.vstack([places, np.reshape([*self._standing.values()], (-1, 2))])
        radii = np.concatenate([radii, self._radii[rows[len(radii) :]]])
        if "halos" in self._show:
            self._brush.rings(picture, places, radii + _HALO_M, _HALO_M, self._white)
        self._brush.discs(picture, places, radii, self._gray, self._heights[rows])
        if self._shares is not None:
            cv2.multiply(picture, self._shares, picture, scale=1 / 255)
        return picture

    def _members(self, tick: TickRecord, instant_ns: int) -> tuple[Array, Array]:
        """Return where the driven robots will be (N, 2), and their discs' radii (N,): a robot that was not measured may
        have driven anywhere meanwhile."""
        robots = self._robots[: self._sizes[0]]
        speeds = [
            body_from_wheels(
                item.left_rad_s, item.right_rad_s, robot.vehicle.wheel_radius_m, robot.vehicle.wheel_base_m
            )
            for item, robot in zip(tick.robots, robots, strict=True)
        ]
        poses = np.nan_to_num([(item.x_m, item.y_m, item.psi_rad) for item in tick.robots])
        late_s = min((instant_ns - tick.stamp_ns) / S, _LONGEST_S) + self._lit_after_s
        unseen_s = np.maximum((instant_ns - self._measured_ns) / S - _LONGEST_S, 0.0)
        fastest = np.array([robot.vehicle.max_speed_m_s for robot in robots])
        return ahead(poses, np.array(speeds), late_s)[:, :2], self._radii[: len(robots)] + fastest * unseen_s
