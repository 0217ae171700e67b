"""Tags for the floor: where to lay them around the arena, and a sheet on which their survey is written down."""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

from matplotlib.path import Path as Outline

from robofleet.behaviours.interface import Dots, Line
from robofleet.calibration.extrinsics.survey import LEAST
from robofleet.calibration.sheets import MARGIN, PAPERS, Page, foot, piece_side, tag_pages
from robofleet.calibration.store import CalibrationError
from robofleet.config import groups
from robofleet.config.calibrated import FloorTag
from robofleet.config.tree import Config
from robofleet.core.figures import QUIET
from robofleet.core.settings import FAMILIES, FamilyName

MOST = 8
_CORNERS = (-1, -1), (1, -1), (1, 1), (-1, 1)
_MIDDLES = (0, -1), (0, 1), (1, 0), (-1, 0)  # of the long sides, then of the short ones
_LEFT, _ROW = 16.0, 6.4  # of the survey sheet: left edge [mm], row of the table [mm]
_FIRST, _MORE = 8, 30  # rows of the table on the first sheet, and on each further one
_PLAN_HEIGHT_MM = 92.0  # at most
_SMALL, _HEAD = 8, 13  # points
_HALF_CROSS = 1.2  # of a group's dots [mm]


class Floor(NamedTuple):
    """The tags of one floor."""

    arena: str
    size_m: tuple[float, float]
    tags: tuple[FloorTag, ...]  # where they shall lie, or lie already
    surveyed: bool  # the configuration has them already
    family: FamilyName

    def survey(self) -> list[str]:
        """Return the lines of a survey file; places that nobody has measured yet are empty."""
        return [
            *([] if self.family == "36h11" else [f"family: {self.family}"]),
            "floor_tags:",
            *(
                f"  - {{tag: {tag.tag}, side_m: {tag.side_m:g}, x_m: {tag.x_m:g}, y_m: {tag.y_m:g}}}"
                if self.surveyed
                else f"  - {{tag: {tag.tag}, side_m: {tag.side_m:g}, x_m: , y_m: }}"
                for tag in self.tags
            ),
        ]


def planned(config: Config, count: int, side_mm: float, first_id: int) -> Floor:
    """Return the configuration's floor tags, or places for ``count`` of them around the rim of its arena.

    Ids count from ``first_id`` on, without those of robots. CalibrationError where there is no room, or no id.
    """
    arena = config.arena
    if config.tracker.floor_tags:
        return Floor(arena.name, arena.size_m, config.tracker.floor_tags, surveyed=True, family=config.tracker.family)
    if not LEAST <= count <= MOST:
        raise CalibrationError(f"--count {count}: must be {LEAST} to {MOST}")
    family = config.tracker.family
    inset, last = piece_side(side_mm, family) / 2e3, FAMILIES[family].ids - 1
    half = [side / 2 - inset for side in arena.size_m]
    if min(half) < 2 * inset:
        raise CalibrationError(f"--side-mm {side_mm:g}: too large for an arena of {_size(arena.size_m)} m")
    robots = {robot.tag for robot in config.robots}
    ids = list(itertools.islice((tag for tag in range(first_id, last + 1) if tag not in robots), count))
    if len(ids) < count:
        raise CalibrationError(f"--first-id {first_id}: {count} free ids up to {last} are needed: begin lower")
    places = (*_CORNERS, *_MIDDLES)[:count]
    tags = [
        FloorTag(tag=tag, side_m=side_mm / 1e3, x_m=round(x * half[0], 2), y_m=round(y * half[1], 2))
        for tag, (x, y) in zip(ids, places, strict=True)
    ]
    return Floor(arena.name, arena.size_m, tuple(tags), surveyed=False, family=family)


def pages(config: Config, floor: Floor, paper: str, command: str) -> list[Page]:
    sides = sorted({tag.side_m for tag in floor.tags})
    prints = [
        page
        for side_m in sides
        for page in tag_pages(
            [tag.tag for tag in floor.tags if tag.side_m == side_m], 1e3 * side_m, paper, command, floor.family
        )
    ]
    return [*_survey_pages(config, floor, paper, command), *prints]


def distances(tags: Sequence[FloorTag]) -> list[tuple[int, int, float]]:
    """Return the pairs whose distance checks a survey, longest first: as many as there are tags [m]."""
    pairs = [
        (first.tag, other.tag, math.hypot(first.x_m - other.x_m, first.y_m - other.y_m))
        for first, other in itertools.combinations(tags, 2)
    ]
    return sorted(pairs, key=lambda pair: -pair[2])[: min(len(tags), 6)]


def _survey_pages(config: Config, floor: Floor, paper: str, command: str) -> list[Page]:
    wanted = "in the configuration" if floor.surveyed else "lay it near"
    page, top = _headed(floor, paper, command)
    below = _plan(page, config, floor, top)
    below = _table(page, floor.tags[:_FIRST], wanted, below - 9.0)
    below = _checks(page, floor, below - 6.0)
    _steps(page, floor, below - 6.0)
    done = [page]
    for start in range(_FIRST, len(floor.tags), _MORE):
        page, top = _headed(floor, paper, command)
        _table(page, floor.tags[start : start + _MORE], wanted, top - 6.0)
        done.append(page)
    return done


def _headed(floor: Floor, paper: str, command: str) -> tuple[Page, float]:
    """Return a page with its title, and where there is room below it [mm]."""
    page = Page(PAPERS[paper])
    foot(page, command, f"Survey of the floor tags of the arena {floor.arena}")
    top = page.height - MARGIN - 8.0
    page.text(_LEFT, top, f"Floor tags of the arena {floor.arena}, {_size(floor.size_m)} m", fontsize=_HEAD)
    return page, top - 6.0


def _plan(page: Page, config: Config, floor: Floor, top: float) -> float:
    """Draw the arena from above, the groups' shapes in it, and the tags; returns how far down it reaches [mm]."""
    wide = page.width - 2 * _LEFT
    scale = min(wide / floor.size_m[0], _PLAN_HEIGHT_MM / floor.size_m[1])  # mm a metre
    x_mid, y_mid = page.width / 2, top - scale * floor.size_m[1] / 2

    def at(x: float, y: float) -> tuple[float, float]:
        return x_mid + scale * x, y_mid + scale * y

    half_x, half_y = (side / 2 for side in floor.size_m)
    corners = [at(x * half_x, y * half_y) for x, y in _CORNERS]
    page.lines(
        [[*start, *other] for start, other in zip(corners, corners[1:] + corners[:1], strict=True)], name="arena"
    )
    shapes = [shape for group in groups.descriptions(config) for shape in group.shapes]
    for shape in shapes:
        points = [at(x, y) for x, y in shape.points.tolist()]
        if isinstance(shape, Line):
            curve = [*points, *(points[:1] if shape.closed else [])]
            page.lines([[*a, *b] for a, b in itertools.pairwise(curve)][::2], name=shape.name)  # dashed
        else:
            page.lines([[x - _HALF_CROSS, y, x + _HALF_CROSS, y] for x, y in points], name=shape.name)
            page.lines([[x, y - _HALF_CROSS, x, y + _HALF_CROSS] for x, y in points])
    length = 12.0
    page.lines([[x_mid, y_mid, x_mid + length, y_mid], [x_mid, y_mid, x_mid, y_mid + length]], name="axes")
    page.text(x_mid + length + 1, y_mid, "x", va="center", fontsize=_SMALL)
    page.text(x_mid, y_mid + length + 1, "y", ha="center", fontsize=_SMALL)
    page.text(x_mid - 1, y_mid - 1, "0, 0", ha="right", va="top", fontsize=_SMALL)
    drawn = {(("dashes", "crosses")[isinstance(shape, Dots)], shape.name): None for shape in shapes}
    words = "; ".join(["From above", *(f"{how}: {name}" for how, name in drawn)])
    square = Outline([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)], closed=True)
    for tag in floor.tags:
        x, y = at(tag.x_m, tag.y_m)
        half = max(1.5, scale * tag.side_m / 2)
        page.fill(square, x, y, half, f"place-{tag.tag}")
        ahead = math.radians(tag.heading_deg)
        page.lines([[x, y, x + (half + 2) * math.cos(ahead), y + (half + 2) * math.sin(ahead)]])
        inwards = -1 if tag.y_m > 0 else 1
        side = "left" if x < x_mid - wide / 4 else "right" if x > x_mid + wide / 4 else "center"
        edge = {"left": x - half, "right": x + half, "center": x}[side]
        page.text(edge, y + inwards * (half + 2.5), f"{tag.tag}", ha=side, va="center", fontsize=_SMALL)
    page.text(x_mid, top - scale * floor.size_m[1] - 4, words, ha="center", color=QUIET)
    return top - scale * floor.size_m[1] - 4


def _table(page: Page, tags: Sequence[FloorTag], wanted: str, top: float) -> float:
    """Draw what is written down; returns how far down it reaches [mm]."""
    edges = [_LEFT, _LEFT + 16, _LEFT + 60, _LEFT + 96, _LEFT + 132, page.width - _LEFT]
    heads = ["tag", f"{wanted}: x, y [m]", "measured x [m]", "measured y [m]", "heading [deg], if measured"]
    for x, head in zip(edges, heads, strict=False):
        page.text(x + 1.5, top + 1.8, head, fontsize=_SMALL)
    for k, tag in enumerate(tags):
        y = top - (k + 1) * _ROW + 2.0
        page.text(edges[0] + 1.5, y, f"{tag.tag}", fontsize=_SMALL)
        page.text(edges[1] + 1.5, y, f"{tag.x_m:.3f},  {tag.y_m:.3f}", fontsize=_SMALL)
    bottom = top - len(tags) * _ROW
    rows = [[edges[0], top - k * _ROW, edges[-1], top - k * _ROW] for k in range(len(tags) + 1)]
    page.lines([*rows, *([x, top, x, bottom] for x in edges)], name="table")
    return bottom


def _checks(page: Page, floor: Floor, top: float) -> float:
    """Write down which distances show a mistake; returns how far down that reaches [mm]."""
    word = "surveyed" if floor.surveyed else "planned"
    page.text(_LEFT, top, f"Measure these, too, from middle to middle [m] ({word} so):", fontsize=_SMALL)
    for k, (first, other, between) in enumerate(distances(floor.tags)):
        x, y = _LEFT + k % 3 * 60.0, top - 6.0 - k // 3 * 6.0
        page.text(x, y, f"{first} to {other} ({between:.3f}):  ____________", fontsize=_SMALL)
    return top - 6.0 - (len(distances(floor.tags)) - 1) // 3 * 6.0


def _steps(page: Page, floor: Floor, top: float) -> None:
    lines = [
        f"1. Check the rulers of each sheet. Measure a {FAMILIES[floor.family].named}: that is side_m.",
        "2. Mark the middle of the arena, 0, 0. The x axis runs along the long side, the y axis to its left.",
        "3. Tape the tags flat where the plan shows them, arrow along x. Near is enough: what you measure counts.",
        "4. Measure the middle of each tag, x and y, to half a millimetre: no pose becomes better than that.",
        "5. Compare the distances above with those of your numbers. 2 mm between them: measure again.",
        "6. Write survey.yaml: " + " ".join(line.strip() for line in floor.survey()[:2]) + " and so on, then",
        "    robofleet calibrate arena CAMERA survey.yaml --live CONFIG",
    ]
    for k, line in enumerate(lines):
        page.text(_LEFT, top - 4.6 * k, line, fontsize=_SMALL)


def _size(size_m: tuple[float, float]) -> str:
    return f"{size_m[0]:g} x {size_m[1]:g}"
