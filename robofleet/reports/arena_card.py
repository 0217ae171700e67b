"""What a notebook shows of a run: the arena as SVG, the state, and figures. Plain HTML, without a script, of any theme.

Every text may come from a stranger's recording: it is escaped. A card stays small, whatever the run was.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from robofleet.behaviours.interface import Dots, Shape
from robofleet.config import obstacles
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.core.figures import robot_colours

_MARGIN_M = 0.1
_MOST_NAMED = 60  # robots that have a name and a trail: of more only the places are drawn
_MOST_TRAIL_POINTS = 1200  # of all robots
_MOST_SHAPE_POINTS = 1200  # of all shapes
_MOST_SOLIDS = 60
_MOST_ROWS = 40
_TEXT = 80  # characters of a text
TRAIL_S, TRAIL_POINTS = 100.0, 600  # how far back a trail goes, and of how many points it is
GOOD, BAD, WAITING = "#2e9e5b", "#d64541", "#d08a12"  # each is seen on white and on black


@dataclass(frozen=True, kw_only=True)
class ArenaView:
    """Robots on the floor at an instant, N of them."""

    config: Config
    shapes: Sequence[Shape]  # what the groups have on the floor
    poses: Array  # (N, 3) of the members' centres: x, y [m], heading [rad; world]
    trails: Array  # (K, N, 2) where they were [m]
    references: Array  # (N, 2) where their points are to be [m]; NaN: nowhere


@dataclass(frozen=True, kw_only=True)
class Card:
    """A card of a run."""

    title: str
    state: str
    colour: str  # of the state
    arena: ArenaView
    heads: Sequence[str]
    rows: Sequence[Sequence[str]]  # the first ones of a table

    def html(self) -> str:
        heads = _row("th", self.heads)
        rows = "".join(_row("td", row) for row in self.rows[:_MOST_ROWS])
        return (
            '<div style="max-width:640px;font:14px system-ui,sans-serif;color:inherit">'
            f'<div style="padding-bottom:6px"><b>{_text(self.title)}</b> &nbsp; '
            f'<span style="color:{self.colour}">&#9679;</span> {_text(self.state)}</div>{svg(self.arena)}'
            f'<table style="border-collapse:collapse;margin-top:6px;color:inherit;font-variant-numeric:tabular-nums">'
            f"{heads}{rows}</table></div>"
        )


def _row(kind: str, cells: Sequence[str]) -> str:
    style = 'style="padding:2px 14px 2px 0;text-align:left;font-weight:normal"'
    return f"<tr>{''.join(f'<{kind} {style}>{_text(cell)}</{kind}>' for cell in cells)}</tr>"


def svg(view: ArenaView) -> str:
    """Return the arena with its obstacles, its shapes, the robots, their trails and references."""
    width, height = view.config.arena.size_m
    x, y = width / 2 + _MARGIN_M, height / 2 + _MARGIN_M
    parts = [*_floor(view), *(_robots(view) if len(view.poses) <= _MOST_NAMED else _crowd(view))]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{-x:.3f} {-y:.3f} {2 * x:.3f} {2 * y:.3f}" role="img" '
        f'aria-label="The robots in the arena" style="width:100%;height:auto;display:block" fill="none" '
        f'stroke="currentColor" stroke-width="{_thin(view.config):.4f}" stroke-linejoin="round" stroke-linecap="round" '
        f'font-size="{x / 24:.4f}" font-family="system-ui,sans-serif">{"".join(parts)}</svg>'
    )


def _thin(config: Config) -> float:
    """Return the width of a line [m]."""
    return config.arena.size_m[0] / 500


def _floor(view: ArenaView) -> Iterator[str]:
    width, height = view.config.arena.size_m
    yield (f'<rect x="{-width / 2:.3f}" y="{-height / 2:.3f}" width="{width:.3f}" height="{height:.3f}" opacity=".5"/>')
    for solid in obstacles.every(view.config.arena)[:_MOST_SOLIDS]:
        fill = "none" if solid.floor else "currentColor"
        yield f'<path d="{_path(solid.outline)}Z" fill="{fill}" fill-opacity=".15" stroke-opacity=".5"/>'
        if not solid.floor:
            yield _name(solid.name, solid.outline.mean(axis=0), "middle")
    most = _MOST_SHAPE_POINTS // max(len(view.shapes), 1)
    for shape in view.shapes[:_MOST_SHAPE_POINTS]:
        points = _thinned(shape.points[np.isfinite(shape.points).all(axis=1)], most)
        if isinstance(shape, Dots):
            yield f'<path d="{"".join(f"M{_point(point)}h0" for point in points)}" stroke-width=".02" opacity=".6"/>'
        elif len(points):
            yield f'<path d="{_path(points)}{"Z" * shape.closed}" stroke-dasharray=".03 .03" opacity=".6"/>'


def _robots(view: ArenaView) -> Iterator[str]:
    colours, most = robot_colours(len(view.poses)), _MOST_TRAIL_POINTS // max(len(view.poses), 1)
    thin = _thin(view.config)
    for row, colour in enumerate(colours):
        walked = view.trails[:, row]
        if len(walked := walked[np.isfinite(walked).all(axis=1)]):
            wide = 1 + 3 * (1 - row / max(len(colours) - 1, 1))  # each shows beside the next one's
            yield f'<path d="{_path(_thinned(walked, most))}" stroke="{colour}" stroke-width="{wide * thin:.4f}"/>'
    for robot, pose, reference, colour in zip(view.config.members, view.poses, view.references, colours, strict=True):
        if not np.isfinite(pose).all():
            continue
        at, radius = pose[:2], robot.vehicle.body_radius_m
        nose = at + radius * np.array([np.cos(pose[2]), np.sin(pose[2])])
        yield f'<path d="M{_point(at)}h0" stroke="{colour}" stroke-width="{2 * radius:.3f}"/>'
        yield f'<path d="{_path(np.array([at, nose]))}" stroke="#fff" stroke-width="{0.25 * radius:.3f}"/>'
        if np.isfinite(reference).all():
            cross = f"M{_point(reference - [0.03, 0.0])}h.06M{_point(reference - [0.0, 0.03])}v-.06"
            yield f'<path d="{cross}" stroke="{colour}"/>'
        yield _name(robot.id, at + radius * np.array([0.8, 0.9]), "start")


def _crowd(view: ArenaView) -> Iterator[str]:
    radius = max(robot.vehicle.body_radius_m for robot in view.config.members)
    places = "".join(f"M{_point(pose[:2])}h0" for pose in view.poses if np.isfinite(pose).all())
    yield f'<path d="{places}" stroke="{robot_colours(1)[0]}" stroke-width="{2 * radius:.3f}"/>'


def _name(name: str, at: Array, anchor: str) -> str:
    x, y = (f"{value:.3f}" for value in (at[0], -at[1]))
    return f'<text x="{x}" y="{y}" text-anchor="{anchor}" fill="currentColor" stroke="none">{_text(name)}</text>'


def _path(points: Array) -> str:
    return "M" + "L".join(map(_point, points))


def _point(point: Array) -> str:
    """Return a point in millimetres; an SVG's y points down."""
    x, y = (f"{value:.3f}" for value in (point[0], -point[1]))
    return f"{x} {y}"


def _thinned(points: Array, most: int) -> Array:
    """Return at most about so many of the points (M, 2), and the last one."""
    step = -(-len(points) // max(most, 2))
    return points if step <= 1 else np.concatenate([points[::step], points[-1:]])


def _text(text: str) -> str:
    return escape(text if len(text) <= _TEXT else f"{text[: _TEXT - 1]}…")
