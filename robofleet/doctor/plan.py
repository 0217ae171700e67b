"""What a laboratory needs: from its floor, robots and tags to cameras, computer and radio. Pure arithmetic.

Measured figures stand in tools/measure/TRACKER.md, tools/measure/SCALE.md and configs/HOSTS.md.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from robofleet.doctor.findings import Finding, Mark, ok

NEEDED_PX, GOOD_PX = 24.0, 36.0  # a tag's side in the image
RIM_M, TILT_DEG = 0.05, 2.0  # kept in view around the arena; how far off straight down a lens hangs, about each axis
ANGLES_DEG = (50, 60, 70, 80, 90)  # of view along the image's longer side
_USUAL_DEG = 70
_MOST_CAMERAS = 16
_ERROR_MM, _ERROR_POWER = 0.008, 1.5  # measured at 36 px a side of 70 mm; the power through 0.015 mm at 24 px
_SURVEY_MM = 0.40  # pose error over the arena by eight floor tags that are surveyed to 0.5 mm
_EXPOSURE_S = 0.004  # the default
_USB3_MB_S, _GIGE_MB_S = 380.0, 115.0  # what they carry in practice
_PACKETS_PER_S = 100  # of a robot with a computer of its own, both directions
_FRAME_S = 100e-6, 200e-6  # airtime of a Wi-Fi frame, whatever its size
_BUSY = 0.5  # share of a channel's airtime
_ARMING = ((4, 20, 100, 1000), (3.3, 5.5, 11.6, 35.0))  # robots, seconds
_APART = 1.3  # from one robot's centre to the next at least, in body diameters
_MEASURED_ROBOTS = 100  # in real time


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """A laboratory that somebody wants.

    ``tag_height_m``: above the floor. ``image_px``: width and height. ``body_radius_m``, ``speed_m_s``: the largest and
    the fastest robot's. ``ceiling_m``: the highest place of a lens above the floor; None: any.
    """

    arena_m: tuple[float, float]
    robots: int
    tag_side_m: float
    tag_height_m: float
    body_radius_m: float
    speed_m_s: float
    image_px: tuple[int, int] = (1920, 1080)
    rate_hz: float = 30.0
    ceiling_m: float | None = None


class Cameras(NamedTuple):
    """Cameras in a grid over the arena, and what each sees."""

    columns: int
    rows: int
    angle_deg: float  # of view, along the image's longer side
    height_m: float  # of the lens above the floor
    overlap_m: float
    tag_px: float  # a tag's side in the image's middle


def cameras(wanted: Wanted) -> Cameras | None:
    """Return the fewest cameras that see each tag with enough pixels; None where too many would be needed."""
    overlap = wanted.speed_m_s + wanted.tag_side_m  # what a robot drives in a second, and a tag
    grids = sorted(product(range(1, _MOST_CAMERAS + 1), repeat=2), key=lambda grid: (grid[0] * grid[1], grid[1]))
    for columns, rows in grids:
        if columns * rows > _MOST_CAMERAS:
            return None
        part = [(size + (n - 1) * overlap) / n for size, n in zip(wanted.arena_m, (columns, rows), strict=True)]
        for angle in (_USUAL_DEG,) if wanted.ceiling_m is None else ANGLES_DEG:
            height = lowest_m(angle, (max(part), min(part)), wanted)
            pixels = side_px(angle, height, wanted)
            if pixels >= NEEDED_PX and (wanted.ceiling_m is None or height <= wanted.ceiling_m):
                return Cameras(columns, rows, angle, height, overlap * (columns * rows > 1), pixels)
    return None


def lowest_m(angle_deg: float, floor_m: tuple[float, float], wanted: Wanted) -> float:
    """Return the lowest place of a lens above the middle of a floor that sees all tags on it [m above the floor].

    Its image's longer side lies along the floor's; it looks straight down, but for ``TILT_DEG`` about both axes.
    """
    width, height = max(wanted.image_px), min(wanted.image_px)
    across = math.tan(math.radians(angle_deg) / 2)
    x, y = (size / 2 + RIM_M for size in floor_m)
    s, c = math.sin(math.radians(TILT_DEG)), math.cos(math.radians(TILT_DEG))

    def seen(depth: float) -> bool:
        for a, b in product((-s, s), repeat=2):
            v, w = c * y + a * depth, c * depth - a * y
            u, w = c * x - b * w, c * w + b * x
            if w <= 0 or abs(u / w) > across or abs(v / w) > across * height / width:
                return False
        return True

    low, high = 0.0, 1e3
    while high - low > 1e-4:
        middle = (low + high) / 2
        low, high = (low, middle) if seen(middle) else (middle, high)
    return high + wanted.tag_height_m


def side_px(angle_deg: float, height_m: float, wanted: Wanted) -> float:
    """Return how long a tag's side is in the image's middle [px]."""
    focal_px = max(wanted.image_px) / 2 / math.tan(math.radians(angle_deg) / 2)
    return focal_px * wanted.tag_side_m / (height_m - wanted.tag_height_m)


def findings(wanted: Wanted, view: Cameras) -> Iterator[Finding]:
    """Yield what to buy and what to expect, a line each."""
    count = view.columns * view.rows
    width, height = wanted.image_px
    pixel_mm = 1e3 * wanted.tag_side_m / view.tag_px
    error_mm = _ERROR_MM * (GOOD_PX / view.tag_px) ** _ERROR_POWER * wanted.tag_side_m / 0.07
    yield ok(
        "cameras",
        f"{count} of {width} x {height} pixels, monochrome, global shutter, {wanted.rate_hz:g} images a second"
        + (f"; {view.columns} x {view.rows} side by side, {view.overlap_m:.2f} m of overlap" if count > 1 else ""),
    )
    focal = 0.5 / math.tan(math.radians(view.angle_deg) / 2)
    yield ok(
        "lens",
        f"{view.angle_deg:g}° along the image's longer side: focal length {focal:.2f} times the sensor's width, "
        f"as {5 * focal:.1f} mm for a sensor 5 mm wide",
    )
    yield ok(
        "height", f"the lens {view.height_m:.2f} m above the floor, or higher up to {_highest_m(wanted, view):.2f} m"
    )
    says = f"{view.tag_px:.0f} pixels a side of {1e3 * wanted.tag_side_m:g} mm (needed {NEEDED_PX:g}, good {GOOD_PX:g})"
    if wanted.tag_side_m * 10 / 8 > 2 * wanted.body_radius_m:
        yield Finding("tags", Mark.WARN, says, "with their white rims they are wider than the robot: take smaller ones")
    else:
        yield ok(
            "tags",
            f"{says}; print them: robofleet sheet tags --ids 1-{wanted.robots} "
            f"--side-mm {1e3 * wanted.tag_side_m:g} --out tags.pdf",
        )
    yield ok(
        "pose error", f"noise {error_mm:.3f} mm rms; {_SURVEY_MM} mm over the arena by 8 floor tags surveyed to 0.5 mm"
    )
    exposure_s = pixel_mm / 1e3 / wanted.speed_m_s
    yield ok(
        "exposure",
        f"{1e3 * exposure_s:.1f} ms at most: at {wanted.speed_m_s:g} m/s a robot then moves by one pixel, "
        f"{pixel_mm:.1f} mm; light the floor so that {1e3 * min(_EXPOSURE_S, exposure_s):.1g} ms are enough",
    )
    data = width * height * wanted.rate_hz / 1e6
    if data > _USB3_MB_S:
        yield Finding("link", Mark.WARN, f"{data:.0f} MB/s a camera", "more than USB 3 carries: fewer pixels or images")
    else:
        gige = int(_GIGE_MB_S // data)
        yield ok(
            "link",
            f"{data:.0f} MB/s a camera: USB 3 carries {_USB3_MB_S // data:.0f}, Gigabit Ethernet {gige or 'none'}",
        )
    cores = max(2, count)
    says = f"{cores} cores, no GPU; two cores drove 50 robots under one camera, and {_MEASURED_ROBOTS} without images"
    if wanted.robots > _MEASURED_ROBOTS:
        yield Finding("computer", Mark.WARN, says, "more was not measured: try it in simulation first")
    else:
        yield ok("computer", says)
    packets = _PACKETS_PER_S * wanted.robots
    low, high = (packets * frame for frame in _FRAME_S)
    says = f"{packets} packets a second if each robot has its own computer: {low:.0%} to {high:.0%} of a Wi-Fi channel"
    if high > _BUSY:
        yield Finding("radio", Mark.WARN, says, "take several channels, or one computer for several robots")
    else:
        yield ok("radio", says)
    area = wanted.arena_m[0] * wanted.arena_m[1] / wanted.robots
    says = f"{area:.2f} m² a robot; each is {2e3 * wanted.body_radius_m:.0f} mm across"
    if area < (2 * _APART * wanted.body_radius_m) ** 2:
        yield Finding("floor", Mark.WARN, says, "so many do not fit on it")
    else:
        yield ok("floor", says)
    yield ok(
        "start",
        f"the checks before a start take {np.interp(wanted.robots, *_ARMING):.1f} s; longer where robots stand close",
    )


def _highest_m(wanted: Wanted, view: Cameras) -> float:
    """Return where tags have just enough pixels, or the ceiling."""
    highest = wanted.tag_height_m + (view.height_m - wanted.tag_height_m) * view.tag_px / NEEDED_PX
    return highest if wanted.ceiling_m is None else min(highest, wanted.ceiling_m)
