"""What a simulated projector shows of a run: what its page would, but at full contrast, without words and grid.

It draws what the bus told until the instant of the drawing. What moves stands where it will be in the middle of the
time for which the picture is lit.
"""

import math
from collections import deque

import cv2
import numpy as np

from robofleet.behaviours import described
from robofleet.behaviours.interface import Dots, Shape
from robofleet.bus.bus import Arrival, Bus
from robofleet.bus.keys import NOTE, POSES, SHOWING, TICK, key
from robofleet.bus.messages import FLEET_POSES, TICK_RECORD, FleetPoses, TickRecord
from robofleet.bus.notes import Marks, noted
from robofleet.config import barrier, obstacles, slices
from robofleet.config.groups import descriptions, scripted
from robofleet.config.projectors import ProjectorSettings, shown
from robofleet.config.tree import Config
from robofleet.core.arrays import Array, Image
from robofleet.core.clock import S
from robofleet.projection.brush import Brush
from robofleet.projection.disc import disc_radii
from robofleet.projection.drawing import SIZES, unit_m
from robofleet.projection.model import Projector, gray_shares
from robofleet.projection.prediction import ahead
from robofleet.vehicles.differential_drive import body_from_wheels

_LONGEST_S = 0.1  # for which robots are taken to drive on without a tick, and from which on their discs grow
_KEPT = 256  # ticks, or a group's notes, between two images


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
        self._config, self._projector = config, projector
        self._brush, self._lit_after_s = Brush(projector), settings.calibration.delay_s + 0.5 / rate_hz
        self._white, self._gray = round(255 * settings.brightness), round(255 * settings.disc_gray)
        self._show: tuple[str, ...] = config.projection.show
        self._groups, self._robots = descriptions(config), config.bodies
        self._sizes = len(config.members), described.size(self._groups, len(config.camera_names))
        self._radii = disc_radii(config)
        self._apart = np.array([barrier.disc_radius_m(config, robot) for robot in self._robots])
        self._heights = np.array([slices.tag_height_m(config, robot) for robot in self._robots])
        self._rows = {robot.tag: row for row, robot in enumerate(self._robots)}
        self._ticks, self._coming = bus.stream(key(config.arena.name, TICK), capacity=_KEPT), deque[Arrival]()
        self._views = [bus.newest(POSES, camera) for camera in config.camera_names] if config.bystanders else []
        self._showing = bus.newest(SHOWING)
        self._notes = {
            group: bus.stream(key(config.arena.name, NOTE, group), capacity=_KEPT) for group in scripted(config)
        }
        self._marks = {group.name: Marks() for group in self._groups}
        trail = round(SIZES["trail_s"] / (SIZES["trail_ticks"] * config.controller.tick_s))
        self._trails: list[deque[tuple[float, float]]] = [deque(maxlen=trail) for _ in config.members]
        self._ticks_taken = 0
        self._tick: TickRecord | None = None
        self._measured_ns = np.zeros(len(config.members), np.int64)  # stamps of the ticks that measured each
        self._standing: dict[int, tuple[float, float]] = {}  # bystanders, by row
        self._still: Image | None = None  # what does not move; None: it is to be drawn

    def at(self, instant_ns: int) -> Image | None:
        """Return the picture (H, W) that is drawn at an instant of the bus's clock; None before the first tick."""
        self._coming.extend(self._ticks.drain())
        while self._coming and self._coming[0].at_ns <= instant_ns:
            self._take(TICK_RECORD.decode(self._coming.popleft().payload))
        for view in self._views:
            self._see(FLEET_POSES.decode(view.take() or b""))
        if (words := self._showing.take()) is not None and (show := shown(words)) is not None:
            self._show, self._still = show, None
        for group, notes in self._notes.items():
            for note in (noted(payload) for *_, payload in notes.drain()):
                if note is not None and note.mark is not None and self._marks[group].take(note.mark):
                    self._still = None
        return None if self._tick is None else self._drawn(self._tick, instant_ns)

    def _take(self, tick: TickRecord | None) -> None:
        if tick is not None and (len(tick.robots), len(tick.figures)) == self._sizes:
            self._tick = tick
            self._measured_ns[[robot.measured > 0 for robot in tick.robots]] = tick.stamp_ns
            if self._ticks_taken % SIZES["trail_ticks"] == 0:
                for trail, robot in zip(self._trails, tick.robots, strict=True):
                    if math.isfinite(robot.x_m):
                        trail.append((robot.x_m, robot.y_m))
            self._ticks_taken += 1

    def _see(self, image: FleetPoses | None) -> None:
        for pose in () if image is None else image.poses:
            row = self._rows.get(pose.tag, 0)
            if row >= self._sizes[0] and pose.coasted_ns == 0:
                self._standing[row] = pose.x_m, pose.y_m

    def _drawn_once(self) -> Image:
        """Draw what does not move."""
        config, projector = self._config, self._projector
        picture = self._background(config, projector) if "background" in self._show else None
        picture = np.zeros(projector.size[::-1], np.uint8) if picture is None else picture
        if "floor" in self._show:
            corner = np.array(config.arena.size_m) / 2.0
            outlines = [
                corner * [(-1, -1), (1, -1), (1, 1), (-1, 1)],
                *(solid.outline for solid in obstacles.every(config.arena)),
            ]
            for outline in outlines:
                self._line(picture, outline, "edge", closed=True)
        if "paths" in self._show:
            for group in self._groups:
                for shape in (*group.shapes, *self._marks[group.name].shapes):
                    self._shape(picture, shape)
        return picture

    def _shape(self, picture: Image, shape: Shape) -> None:
        points = shape.points[np.isfinite(shape.points).all(axis=1)]
        if isinstance(shape, Dots):
            self._rings(picture, points, np.full(len(points), self._size("dot")), "line")
        elif len(points):
            self._line(picture, points, "line", closed=shape.closed)
            if shape.directed:
                legs, arrows = len(points) - 1, int(SIZES["directions"])
                for k in np.arange(min(arrows, legs)) * legs // arrows:
                    heading = math.atan2(*(points[k + 1] - points[k])[::-1])
                    self._brush.fill(picture, _arrow(points[k], heading, self._size("direction")), self._white)

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

    def _size(self, what: str) -> float:
        return SIZES[what] * unit_m(self._config.arena.size_m[0], large="large" in self._show)

    def _line(self, picture: Image, points: Array, width: str, *, closed: bool = False) -> None:
        points = np.vstack([points, points[:1]]) if closed else points
        self._brush.line(picture, points, self._size(width), self._white)

    def _rings(self, picture: Image, centres: Array, radii: Array, width: str) -> None:
        self._brush.rings(picture, centres, radii, self._size(width), self._white)

    def _drawn(self, tick: TickRecord, instant_ns: int) -> Image:
        self._still = self._drawn_once() if self._still is None else self._still
        picture = self._still.copy()
        poses, radii = self._members(tick, instant_ns)
        if "trails" in self._show:
            for trail in self._trails:
                if len(trail) > 1:
                    self._line(picture, np.array(trail), "line")
        if "references" in self._show:
            self._draw_references(picture, tick)
        rows = [*range(len(poses)), *self._standing]
        places = np.vstack([poses[:, :2], np.reshape([*self._standing.values()], (-1, 2))])
        radii = np.concatenate([radii, self._radii[rows[len(radii) :]]])
        if "barrier" in self._show:
            self._rings(picture, places, self._apart[rows], "thin")
        if "halos" in self._show:
            halo, arrow = self._size("halo"), self._size("arrow")
            self._rings(picture, places, radii + halo / 2.0, "halo")
            for (x, y, psi), radius in zip(poses, radii, strict=False):
                off = radius + halo / 2.0 + arrow
                middle = np.array([x + off * math.cos(psi), y + off * math.sin(psi)])
                self._brush.fill(picture, _arrow(middle, psi, arrow), self._white)
        self._brush.discs(picture, places, radii, self._gray, self._heights[rows])
        if self._shares is not None:
            cv2.multiply(picture, self._shares, picture, scale=1 / 255)
        return picture

    def _draw_references(self, picture: Image, tick: TickRecord) -> None:
        """Draw from each robot's point p to its reference, and a cross there."""
        parts = described.parts(self._groups, np.array([tick.figures]))
        references = np.concatenate([numbers[0, :, :2] for numbers in parts])
        cross = self._size("cross") * np.array([(0, 0), (1, 1), (-1, -1), (0, 0), (1, -1), (-1, 1)])
        for robot, reference in zip(tick.robots, references, strict=True):
            way = np.vstack([(robot.point_x_m, robot.point_y_m), reference + cross])
            if np.isfinite(way).all():
                self._line(picture, way, "thin")

    def _members(self, tick: TickRecord, instant_ns: int) -> tuple[Array, Array]:
        """Return where the driven robots will be (N, 3), and their discs' radii (N,): a robot that was not measured may
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
        return ahead(poses, np.array(speeds), late_s), self._radii[: len(robots)] + fastest * unseen_s


def _arrow(middle: Array, heading: float, size_m: float) -> Array:
    """Return a triangle (3, 2) [m]; ``size_m``: from its middle to its tip."""
    angles = heading + np.array([0.0, 2.4, -2.4])
    return np.asarray(middle + size_m * np.column_stack([np.cos(angles), np.sin(angles)]))
