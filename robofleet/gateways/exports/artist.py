"""Draws a run at any instant: robots, trails and references on the arena, or on a camera's images."""

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
from robofleet.reports.canvas import ALARM, WIDTH, RunView
from robofleet.reports.overview import floor
from robofleet.safety.supervisor import MOVING

_TRAIL_S, _TRAIL_SHOWN_S = 8.0, 2.0  # of the run, and of the film: the longer of the two
_TRAIL_STEP = 1 / 160  # between the points of a trail [widths]
_HEADER = 0.05  # [widths]: title and time
_PALE: Colour = (235, 235, 235)
_ROUND = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
_WHEEL = np.array([[-0.45, 0.82], [0.45, 0.82], [0.45, 1.12], [-0.45, 1.12]])
_BODY = (  # a robot from above: its wheels, its disc, an arrow; points ahead and to the left of its centre [radii]
    _WHEEL,
    _WHEEL * (1.0, -1.0),
    np.column_stack([np.cos(_ROUND), np.sin(_ROUND)]),
    np.array([[0.8, 0.0], [-0.55, 0.42], [-0.3, 0.0], [-0.55, -0.42]]),
)
_OUTLINES, _ENDS = np.concatenate(_BODY), np.cumsum([len(outline) for outline in _BODY])[:-1]

Pixels = Callable[[Array], Array]  # of points of the floor (n, 2) [m] -> pixels (n, 2)


class Artist:
    """Draws robots, trails and references at any instant of a run."""

    def __init__(self, view: RunView, title: str, speed: float, width: int, camera: Pixels | None = None) -> None:
        """Draw images of a width [px], even; ``camera``: where the floor is in a camera's images of that width."""
        self._view, self.width, self._camera = view, width, camera
        self._pixels = self._on_arena if camera is None else camera
        self._trail_s = max(_TRAIL_S, _TRAIL_SHOWN_S * speed)
        self._pace = "" if speed == 1 else f"  ×{speed:g}"
        self._colours = [rgb(colour) for colour in view.colours]
        self._names = [text(robot, round(width / 52), bold=True) for robot in view.run.robots]
        self._heading = text(title, round(width * 0.021), bold=True)
        self._t, self._poses, self._references = view.run.clock_time_s, view.run.poses(), view.run.references
        self._ways = [self._way(points) for points in view.run.points().transpose(1, 0, 2)]
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
        figure, axes = floor(self._view)
        for points in self._lines:
            axes.plot(*points.T, color=FAINT, lw=5.0, zorder=1.0)
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

    def frame(self, t: float, photograph: Image | None = None) -> Image:
        """Return the image of an instant; ``photograph``: a camera's image, grey, that is as wide."""
        if photograph is None:
            image = self._drawn.copy()
            on = image[self.header :]
        else:
            image = np.empty((self.header + photograph.shape[0], self.width, 3), np.uint8)
            image[: self.header], on = self._title, image[self.header :]
            cv2.cvtColor(photograph, cv2.COLOR_GRAY2RGB, dst=on)
            for points in self._lines:
                line(on, self._pixels(points), _PALE, max(1, round(self.width / 900)))
        self._clock(image, t)
        k = min(max(int(np.searchsorted(self._t, t, "right")) - 1, 0), len(self._t) - 1)
        for way, colour in zip(self._ways, self._colours, strict=True):
            pale = 0.85 if self._camera is None else 0.0
            trail(on, self._trail(*way, k), colour, round(self.width / 280), pale=pale)
        for row, colour in enumerate(self._colours):
            pose, reference = self._poses[k, row], self._references[k, row]
            if not np.isfinite(pose).all():
                continue
            if self._camera is None:
                self._body(on, pose, self._radii[row], colour)
            if np.isfinite(reference).all():
                _ring(on, self._pixels(reference[None])[0], colour, self.width / 180)
            self._name(on, row, pose)
        return image

    @cached_property
    def _drawn(self) -> Image:
        """What stays in every image of the arena."""
        return np.concatenate([self._title, self.arena])

    @cached_property
    def _title(self) -> Image:
        """What stays above every image."""
        image, margin = np.full((self.header, self.width, 3), 255, np.uint8), self._margin
        blend(image, self._heading, margin, self.header // 2 - self._heading.shape[0] // 2, rgb(INK))
        image[self._bar, margin : self.width - margin] = rgb(FAINT)
        return image

    @property
    def _margin(self) -> int:
        return round(0.02 * self.width)

    @property
    def _bar(self) -> slice:
        """The rows that show how much of the run is over."""
        return slice(self.header - max(2, round(0.004 * self.width)), self.header)

    def _clock(self, image: Image, t: float) -> None:
        """Write the time, what the run did if it did not run, and how much of it is over."""
        (first_s, last_s), margin = self._view.span, self._margin
        clock = text(f"{t:.1f} s{self._pace}", round(self.width * 0.021), fixed=True)
        left = self.width - margin - clock.shape[1]
        blend(image, clock, left, self.header // 2 - clock.shape[0] // 2, rgb(INK))
        if phase := self._phase(t):
            words = text(phase, round(self.width * 0.018), bold=True)
            blend(image, words, left - margin - words.shape[1], self.header // 2 - words.shape[0] // 2, rgb(ALARM))
        share = min(max((t - first_s) / (last_s - first_s), 0.0), 1.0)
        image[self._bar, margin : margin + round(share * (self.width - 2 * margin))] = rgb(QUIET)

    def _phase(self, t: float) -> str:
        """Return what the run did instead of running, and why; empty: it ran."""
        spans = (span for span in self._view.timeline.phases if span.t_s <= t < span.until_s)
        return next((f"{s.name}: {s.cause}" if s.cause else s.name for s in spans if s.phase not in MOVING), "")

    def _on_arena(self, points: Array) -> Array:
        size_m = np.array(self._view.config.arena.size_m)
        scale = self.width / (size_m[0] + 2 * 0.1)
        height = scale * (size_m[1] + 2 * 0.1)
        return np.asarray(np.array([self.width, height]) / 2 + points * (scale, -scale) - 0.5)

    def _way(self, points: Array) -> tuple[Array, NDArray[np.int64]]:
        """Return a robot's pixels (K, 2), NaN where it was not known, and ticks (n,) that are some pixels apart."""
        known = np.flatnonzero(np.isfinite(points).all(axis=1))
        pixels = np.full(points.shape, np.nan)
        pixels[known] = self._pixels(points[known])
        walked = np.cumsum(np.hypot(*np.diff(pixels[known], axis=0, prepend=pixels[known[:1]]).T))
        _, apart = np.unique(walked // max(1.0, _TRAIL_STEP * self.width), return_index=True)
        return pixels, known[apart]

    def _trail(self, pixels: Array, apart: NDArray[np.int64], k: int) -> Array:
        """Return the pixels (n, 2) of a way's newest part, up to a tick."""
        first = np.searchsorted(self._t, self._t[k] - self._trail_s)
        newest = pixels[np.append(apart[(first <= apart) & (apart < k)], k)]
        return np.asarray(newest[np.isfinite(newest[:, 0])])

    def _body(self, image: Image, pose: Array, radius: float, colour: Colour) -> None:
        ahead = radius * np.array([np.cos(pose[2]), np.sin(pose[2])])
        at = self._pixels(pose[:2] + _OUTLINES @ np.array([ahead, [-ahead[1], ahead[0]]]))
        *wheels, disc, arrow = np.split(np.round(at * (1 << SHIFT)).astype(np.int32), _ENDS)
        cv2.fillPoly(image, wheels, rgb(INK), cv2.LINE_AA, SHIFT)
        cv2.fillPoly(image, [disc], colour, cv2.LINE_AA, SHIFT)
        cv2.polylines(image, [disc], True, mixed(colour, (0, 0, 0), 0.35), 2, cv2.LINE_AA, SHIFT)
        cv2.fillPoly(image, [arrow], WHITE, cv2.LINE_AA, SHIFT)

    def _name(self, image: Image, row: int, pose: Array) -> None:
        """Write a robot's name to its right, where no other robot of a platoon is."""
        aside = 2.0 * self._radii[row] * np.array([np.sin(pose[2]), -np.cos(pose[2])])
        rim = 0 if self._camera is None else max(2, round(self.width / 400))
        label(image, self._names[row], self._pixels((pose[:2] - aside)[None])[0], self._colours[row], rim)


def _ring(image: Image, pixel: Array, colour: Colour, radius: float) -> None:
    x, y = np.round(pixel * (1 << SHIFT)).astype(int).tolist()
    around = round(radius * (1 << SHIFT))
    cv2.circle(image, (x, y), around, WHITE, -1, cv2.LINE_AA, SHIFT)
    cv2.circle(image, (x, y), around, colour, max(2, round(radius / 3)), cv2.LINE_AA, SHIFT)
