"""Draws a run at any instant: robots, trails and references on the arena, or on a camera's image."""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from numpy.typing import NDArray

from robofleet.behaviours.interface import Line
from robofleet.core.arrays import Array
from robofleet.core.figures import FAINT, INK, QUIET
from robofleet.gateways.exports.strokes import SHIFT, WHITE, Colour, Image, blend, label, line, mixed, rgb, text, trail
from robofleet.reports.canvas import WIDTH, RunView
from robofleet.reports.overview import floor

_TRAIL_S, _TRAIL_SHOWN_S = 8.0, 2.0  # of the run, and of the film: the longer of the two
_HEADER = 0.05  # [widths]: title and time
_PALE: Colour = (235, 235, 235)


class Artist:
    """Draws robots, trails and references at any instant of a run, over an image of the floor."""

    def __init__(self, view: RunView, title: str, speed: float, width: int) -> None:
        self._view, self.width = view, width
        self._trail_s = max(_TRAIL_S, _TRAIL_SHOWN_S * speed)
        self._pace = "" if speed == 1 else f"  ×{speed:g}"
        self._colours = [rgb(colour) for colour in view.colours]
        self._names = [text(robot, round(width / 52), bold=True) for robot in view.run.robots]
        self._heading = text(title, round(width * 0.021), bold=True)
        self._t, self._poses, self._points = view.run.clock_time_s, view.run.poses(), view.run.points()
        self._references = view.run.references
        self._lines = [
            np.concatenate([shape.points, shape.points[:1]]) if shape.closed else shape.points
            for group in view.run.groups
            for shape in group.shapes
            if isinstance(shape, Line)
        ]
        self._radii = [robot.vehicle.body_radius_m for robot in view.config.members]

    @property
    def header(self) -> int:
        """Height of title and time above the image [px]; even."""
        return 2 * round(_HEADER * self.width / 2)

    @cached_property
    def arena(self) -> Image:
        """The arena from above."""
        figure, _ = floor(self._view)
        figure.set_dpi(self.width / WIDTH)
        canvas: Any = FigureCanvasAgg(figure)
        canvas.draw()
        image = np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])
        image = image[: image.shape[0] // 2 * 2, : self.width].copy()
        legend, y = text("reference", round(self.width / 64)), image.shape[0] - round(self.width * 0.05 / 3.4)
        x = self.width - round(self.width * 0.1 / 3.4) - legend.shape[1]
        blend(image, legend, x, y - legend.shape[0] // 2, rgb(INK))
        _ring(image, np.array([x - self.width / 60, y]), rgb(INK), self.width / 180)
        return image

    def on_arena(self, points: Array) -> Array:
        """Return the pixels (n, 2) of points (n, 2) [m] of the floor."""
        size_m = np.array(self._view.config.arena.size_m)
        scale = self.width / (size_m[0] + 2 * 0.1)
        height = scale * (size_m[1] + 2 * 0.1)
        return np.asarray(np.array([self.width, height]) / 2 + points * (scale, -scale) - 0.5)

    def frame(self, t: float, background: Image, pixels: Callable[[Array], Array], *, solid: bool) -> Image:
        """Return the image of an instant: ``background``, on which ``pixels`` says where a point of the floor is.

        ``solid``: draw the robots' bodies, which a camera's image has already.
        """
        image = np.empty((self.header + background.shape[0], background.shape[1], 3), np.uint8)
        image[self.header :] = background
        self._head(image, t)
        on = image[self.header :]
        for points in () if solid else self._lines:
            line(on, pixels(points), _PALE, max(1, round(self.width / 900)))
        k = min(max(int(np.searchsorted(self._t, t, "right")) - 1, 0), len(self._t) - 1)
        first = int(np.searchsorted(self._t, self._t[k] - self._trail_s))
        for row, colour in enumerate(self._colours):
            points = pixels(_finite(self._points[first : k + 1, row]))
            trail(on, points, colour, round(self.width / 280), pale=0.85 if solid else 0.0)
        for row, colour in enumerate(self._colours):
            pose, reference = self._poses[k, row], self._references[k, row]
            if not np.isfinite(pose).all():
                continue
            if solid:
                _body(on, pixels, pose, self._radii[row], colour)
            if np.isfinite(reference).all():
                _ring(on, pixels(reference[None])[0], colour, self.width / 180)
            self._name(on, pixels, row, pose, solid=solid)
        return image

    def _head(self, image: Image, t: float) -> None:
        image[: self.header] = 255
        margin, (first_s, last_s) = round(0.02 * self.width), self._view.span
        blend(image, self._heading, margin, self.header // 2 - self._heading.shape[0] // 2, rgb(INK))
        clock = text(f"{t:.1f} s{self._pace}", round(self.width * 0.021), fixed=True)
        blend(image, clock, self.width - margin - clock.shape[1], self.header // 2 - clock.shape[0] // 2, rgb(INK))
        y = self.header - max(2, round(0.004 * self.width))
        share = min(max((t - first_s) / (last_s - first_s), 0.0), 1.0)
        image[y : self.header, margin : self.width - margin] = rgb(FAINT)
        image[y : self.header, margin : margin + round(share * (self.width - 2 * margin))] = rgb(QUIET)

    def _name(self, image: Image, pixels: Callable[[Array], Array], row: int, pose: Array, *, solid: bool) -> None:
        """Write a robot's name to its right, where no other robot of a platoon is."""
        aside = 2.0 * self._radii[row] * np.array([np.sin(pose[2]), -np.cos(pose[2])])
        rim = 0 if solid else max(2, round(self.width / 400))
        label(image, self._names[row], pixels((pose[:2] - aside)[None])[0], self._colours[row], rim)


def _finite(points: Array) -> Array:
    return np.asarray(points[np.isfinite(points).all(axis=1)])


def _body(image: Image, pixels: Callable[[Array], Array], pose: Array, radius: float, colour: Colour) -> None:
    """Draw a robot from above: its disc, its wheels, and an arrow ahead."""
    ahead = np.array([np.cos(pose[2]), np.sin(pose[2])])
    left = np.array([-ahead[1], ahead[0]])

    def outline(*corners: tuple[float, float]) -> NDArray[np.int32]:
        at = pixels(pose[:2] + radius * np.array([a * ahead + b * left for a, b in corners]))
        return np.round(at * (1 << SHIFT)).astype(np.int32)

    for side in (-1.0, 1.0):
        wheel = outline(*((a, side * b) for a, b in ((-0.45, 0.82), (0.45, 0.82), (0.45, 1.12), (-0.45, 1.12))))
        cv2.fillPoly(image, [wheel], rgb(INK), cv2.LINE_AA, SHIFT)
    angles = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
    disc = outline(*zip(np.cos(angles).tolist(), np.sin(angles).tolist(), strict=True))
    cv2.fillPoly(image, [disc], colour, cv2.LINE_AA, SHIFT)
    cv2.polylines(image, [disc], True, mixed(colour, (0, 0, 0), 0.35), 2, cv2.LINE_AA, SHIFT)
    arrow = outline((0.8, 0.0), (-0.55, 0.42), (-0.3, 0.0), (-0.55, -0.42))
    cv2.fillPoly(image, [arrow], WHITE, cv2.LINE_AA, SHIFT)


def _ring(image: Image, pixel: Array, colour: Colour, radius: float) -> None:
    x, y = np.round(pixel * (1 << SHIFT)).astype(int).tolist()
    around = round(radius * (1 << SHIFT))
    cv2.circle(image, (x, y), around, WHITE, -1, cv2.LINE_AA, SHIFT)
    cv2.circle(image, (x, y), around, colour, max(2, round(radius / 3)), cv2.LINE_AA, SHIFT)
