"""What is said to the page: JSON objects, each with its ``type``. Lengths in m, angles in rad, unless a name says else.

A value that is not known is null, never 0.
"""

import base64
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from robofleet.behaviours.described import Group
from robofleet.behaviours.interface import Dots, Figure, Pose, Shape, with_unit
from robofleet.bus.keys import STATE, TICK
from robofleet.bus.messages import FleetPoses, RobotStatus, RobotTick, RunState, TickRecord
from robofleet.config import barrier, obstacles
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.core.clock import MS, S
from robofleet.core.figures import robot_colours
from robofleet.core.starting import Starting
from robofleet.operator.hand import driven, drivers
from robofleet.operator.page.hearing import Hearing, Shown
from robofleet.operator.page.projectors import described, lit
from robofleet.operator.page.words import ENDING, end_words, phase_name, what_next
from robofleet.operator.terminal import live_figures
from robofleet.operator.terminal.on_the_way import WAYS, OnTheWay
from robofleet.projection.drawing import SIZES
from robofleet.recording.causes import named, own_state
from robofleet.recording.state_words import ROBOT_WORDS, state_words
from robofleet.safety.latches import GateStatus, Latch
from robofleet.safety.supervisor import Phase
from robofleet.tracking.outlines import TagOutlines

Frame = dict[str, Any]

COLUMNS = (
    "x_m", "y_m", "psi_rad", "point_x_m", "point_y_m", "reference_x_m", "reference_y_m", "left_rad_s", "right_rad_s",
    "gate", "latch", "halted", "battery", "age_ms", "measured", "lost", "filtered", "to_go_m",
    "figures",
)  # fmt: skip
_PLACE, _WHEELS, _FLAGS = (
    [RobotTick._fields.index(name) for name in names]
    for names in (COLUMNS[:5], ("left_rad_s", "right_rad_s"), ("measured", "lost", "filtered"))
)
_LONGEST_LATENCY_MS = 1000.0  # two hosts' stamps give any number: more is no latency
_FIGURE_DIGITS = 6


def hello(config: Config, groups: Sequence[Group], folder: Path) -> Frame:
    """Return what does not change in a run."""
    bounds = config.run.bounds.model_dump(exclude_none=True)
    return {
        "type": "hello",
        "arena": {
            "name": config.arena.name,
            "size_m": config.arena.size_m,
            "floor_m": config.arena.floor_m,
            "obstacles": [
                {"name": solid.name, "points": solid.outline.round(_FIGURE_DIGITS).tolist()}
                for solid in obstacles.standing(config.arena)
            ],
        },
        "robots": [
            {**_robot(config, row), "colour": colour} for row, colour in enumerate(robot_colours(len(config.bodies)))
        ],
        "projectors": list(described(config)),
        "lit": list(lit(config)) if config.projectors else [],
        "background": config.projection.background is not None,
        "drawn": SIZES,
        "groups": [
            {
                "name": group.name,
                "behaviour": group.behaviour,
                "robots": group.robots,
                "by_hand": group.name in driven(config),
                "shapes": [_shape(shape) for shape in group.shapes],
            }
            for group in groups
        ],
        "figures": [_figure(figure, groups, bounds) for figure in live_figures.columns(groups)],
        "places": {named(Phase, phase): _places(places) for phase, places in OnTheWay(config).places.items()},
        "ways": {named(Phase, phase): {"goal": way.goal, "arrived": way.arrived} for phase, way in WAYS.items()},
        "tick_ms": config.controller.tick_s * 1e3,
        "duration_s": config.run.duration_s,
        "cameras": [
            {"name": view.camera.name, "width": view.camera.width, "height": view.camera.height}
            for view in (config.views if config.tracker.source == "camera" else ())
        ],
        "config": str(folder / "config.yaml"),
        "folder": str(folder),
        "columns": COLUMNS,
        "words": ROBOT_WORDS,
    }


def shapes(groups: Sequence[Group], marks: Sequence[Sequence[Shape]]) -> Frame:
    """Return what is drawn for each group, with its scripts' marks: it takes the place of what ``hello`` said."""
    both = zip(groups, marks, strict=True)
    return {"type": "shapes", "groups": [[_shape(line) for line in (*group.shapes, *body)] for group, body in both]}


def showing(show: Sequence[str], pages: Sequence[tuple[str, tuple[int, int]]]) -> Frame:
    """Return what projectors show, and which of them has a page that is open, of how many pixels."""
    return {"type": "showing", "show": show, "pages": [{"name": name, "size_px": size} for name, size in pages]}


def _places(places: Sequence[Pose | None]) -> list[list[float | None] | None]:
    return [None if pose is None else [_rounded(value, 4) for value in pose] for pose in places]


def _shape(shape: Shape) -> Frame:
    """Return what is drawn on the floor; points that are not finite are left out."""
    points = [[_rounded(x, 4), _rounded(y, 4)] for x, y in shape.points.tolist() if math.isfinite(x + y)]
    if isinstance(shape, Dots):
        return {"kind": "dots", "name": shape.name, "points": points}
    return {"kind": "line", "name": shape.name, "points": points, "closed": shape.closed, "directed": shape.directed}


def _figure(figure: Figure, groups: Sequence[Group], bounds: dict[str, float]) -> Frame:
    """Return what a column of the table and a plot are named, whose they are, and the bounds of their figure."""
    unit, key = live_figures.unit(figure), figure.shown_key
    robots = [
        group.robots for group in groups if key in (measure.shown_key for measure in group.figures if measure.live)
    ]
    return {
        "key": key,
        "title": live_figures.title(figure),
        "unit": unit,
        "meaning": figure.meaning,
        "digits": live_figures.digits(figure),
        "robots": [robot for own in robots for robot in own],
        "bounds": {
            statistic: bounds.get(with_unit(f"{figure.name}_{statistic}", unit)) for statistic in ("mean", "max")
        },
    }


def tick(hearing: Hearing, config: Config, groups: Sequence[Group], seq: int, now_ns: int, launcher: str) -> Frame:
    """Return the run as it stands; ``launcher``: its newest line, how far the start is or how the run ends."""
    state, way, starting = hearing.state, hearing.way, Starting.decode(launcher)
    if starting and state and state.phase == Phase.IDLE:
        state = None  # the supervisor is ready before the others are
    words = None if state is None else state_words(state, hearing.busy, config.ids)
    check = words.check if state and words and state.phase == Phase.ARMED else None
    ends = end_words(launcher)
    ending = bool(ends) and (state is None or state.phase not in (Phase.FAULT, Phase.ESTOP))
    to_go_m = way.to_go_m(None if hearing.controller_silent() else hearing.record)
    return {
        "type": "tick",
        "seq": seq,
        "tick": 0 if hearing.record is None else hearing.record.tick,
        "age_ms": None if hearing.record is None else _rounded((now_ns - hearing.record.stamp_ns) / MS, 1),
        "t_s": _rounded(hearing.reached_s if ending else hearing.t_s, 3),
        "clock_s": _rounded(hearing.clock.clock_s, 3),
        "phase": "ending" if ending else phase_name(state),
        "cause": words and words.cause,
        "stage": ends or (starting.words() if starting else check),
        "start_share": starting and starting.share,
        "what_next": ENDING
        if ending
        else what_next(state, words, hearing.robots, config, way.phase, way.words(to_go_m)),
        "way": None if way.phase is None else named(Phase, way.phase),
        "drivers": drivers(groups, None if hearing.controller_silent() else hearing.record),
        "health": _health(hearing),
        "robots": _rows(hearing, groups, state, to_go_m, now_ns),
    }


def beat(hearing: Hearing, now_ns: int) -> Frame:
    """Return how long ago the supervisor and the controller were heard [ms]: the link to the robots, not the page's."""
    return {
        "type": "beat",
        "supervisor": _age_ms(hearing.run.arrival_ns(STATE), now_ns),
        "controller": _age_ms(hearing.run.arrival_ns(TICK), now_ns),
    }


def event(run_s: float | None, clock_s: float | None, level: str, text: str) -> Frame:
    """Return something that happened, at a run time and a clock time."""
    return {"type": "event", "at": _rounded(run_s, 2), "clock_s": _rounded(clock_s, 2), "level": level, "text": text}


def answer(to: str, ok: bool, text: str) -> Frame:
    return {"type": "answer", "to": to, "ok": ok, "text": text}


def own_hands(epochs: Mapping[str, int]) -> Frame:
    """Return by which numbers ``drivers`` of a tick names this page's own hand on each group."""
    return {"type": "hands", "epochs": epochs}


def picture(camera: str, shown: Shown, tags: Mapping[int, str], outlines: TagOutlines) -> Frame:
    """Return a camera's picture, and where its tags were seen [px of the camera's image]; ``tags``: the robots'."""
    seen, poses = shown
    return {
        "type": "picture",
        "camera": camera,
        "exposure_ns": seen.exposure_ns,
        "width": seen.width,
        "height": seen.height,
        "jpeg": base64.b64encode(seen.jpeg).decode(),
        "tags": [
            {
                "id": tag,
                "robot": tags.get(tag),
                "corners": [[_rounded(u, 1), _rounded(v, 1)] for u, v in corners],
            }
            for tag, corners in outlines.of(poses).items()
        ],
    }


def _robot(config: Config, row: int) -> Frame:
    robot = config.bodies[row]
    return {
        "id": robot.id,
        "tag": robot.tag,
        "reality": robot.reality,
        "driven": row < len(config.members),
        "group": config.ids.group_of(row) or None,
        "body_radius_m": robot.vehicle.body_radius_m,
        "safety_radius_m": _rounded(barrier.disc_radius_m(config, robot), 4),  # two such circles may touch
    }


def _health(hearing: Hearing) -> Frame:
    record = None if hearing.controller_silent() else hearing.record
    several = len(hearing.cameras) > 1
    each = [(camera, *_tracker(list(camera.images), len(hearing.tags))) for camera in hearing.cameras]
    cameras = [
        {"name": camera.name, "hz": hz, "age_ms": _age_ms(camera.heard_ns, hearing.now_ns())} for camera, hz, _ in each
    ]
    rate, seen = each[0][1:]
    if several:  # no camera sees all robots
        rates = [age for _, age, _ in each if age is not None]
        rate, seen = min(rates, default=None), _measured_pct(record)
    return {
        "compute_us": None if record is None else record.compute_ns // 1000,
        "late_us": None if record is None else record.lateness_ns // 1000,
        "overruns": None if record is None else hearing.overruns,
        "latency_ms": _latency_ms(hearing),
        "tracker_hz": rate,
        "seen_pct": seen,
        **({"cameras": cameras} if several else {}),
    }


def _measured_pct(record: TickRecord | None) -> float | None:
    """Return how many of the robots the newest tick measured, whoever saw them [%]."""
    if record is None or not record.robots:
        return None
    return _rounded(100.0 * sum(robot.measured for robot in record.robots) / len(record.robots), 1)


def _latency_ms(hearing: Hearing) -> float | None:
    """Return the longest time from an image to the wheels that it moves, of the robots' newest commands."""
    applied = [
        (status.applied_ns - status.applied_exposure_ns) / MS
        for status, _ in hearing.robots
        if status is not None and status.applied_exposure_ns and status.gate == GateStatus.OPEN
    ]
    return _rounded(max(applied), 1) if applied and 0.0 <= max(applied) <= _LONGEST_LATENCY_MS else None


def _tracker(images: list[FleetPoses], robots: int) -> tuple[float | None, float | None]:
    """Return the images' rate [Hz] and how many of the tags are measured in them [%]."""
    if len(images) < 2 or images[-1].exposure_ns <= images[0].exposure_ns:
        return None, None
    rate = (images[-1].seq - images[0].seq) * S / (images[-1].exposure_ns - images[0].exposure_ns)
    newest = images[-1]
    measured = sum(pose.coasted_ns == 0 for pose in newest.poses)
    return _rounded(rate, 1), _rounded(100.0 * min(1.0, measured / robots), 1)


def _rows(
    hearing: Hearing, groups: Sequence[Group], state: RunState | None, to_go_m: Sequence[float | None], now_ns: int
) -> list[list[Any]]:
    ticks = None if hearing.controller_silent() or hearing.record is None else hearing.record
    texts = live_figures.told(groups, ticks)
    numbers = np.array(() if ticks is None else ticks.robots).reshape(-1, len(RobotTick._fields))
    places, wheels, flags = (
        _table(numbers[:, _PLACE], 4),
        _table(numbers[:, _WHEELS], 2),
        numbers[:, _FLAGS].astype(int).tolist(),
    )
    references, figures = _table(texts.references, 4), _table(texts.figures, _FIGURE_DIGITS)
    rows: list[list[Any]] = []
    for row, (status, arrival_ns) in enumerate(hearing.robots):
        record = None if ticks is None or row >= len(numbers) else ticks.robots[row]
        driven = row < len(references)
        rows.append([
            *(places[row] if record is not None and hearing.placed[row] else _standing(hearing, row)),
            *(references[row] if driven else (None, None)),
            *(wheels[row] if record is not None else (None, None)),
            *_gate(status), own_state(state, row, record) or None, _battery(status),
            _age_ms(arrival_ns, now_ns),
            *(flags[row] if record is not None else (None, None, None)),
            _rounded(to_go_m[row], 3) if driven else None,
            figures[row] if driven else [None] * texts.figures.shape[1],
        ])  # fmt: skip
    return rows


def _table(values: Array, digits: int) -> list[list[float | None]]:
    """Return numbers (N, C), rounded, row by row; what is not finite is not known."""
    rows: list[list[Any]] = np.round(values, digits).tolist()
    if np.isfinite(values).all():
        return rows
    return [[value if math.isfinite(value) else None for value in row] for row in rows]


def _standing(hearing: Hearing, row: int) -> list[float | None]:
    """Return where a bystander was seen last; a robot whose place is not known has none."""
    pose = hearing.standing.get(row)
    if pose is None:
        return [None] * 5
    return [_rounded(pose.x_m, 4), _rounded(pose.y_m, 4), _rounded(pose.psi_rad, 4), None, None]


def _gate(status: RobotStatus | None) -> tuple[str | None, str | None]:
    if status is None:
        return None, None
    return named(GateStatus, status.gate), named(Latch, status.latch) if status.latch else None


def _battery(status: RobotStatus | None) -> float | None:
    return None if status is None or status.battery < 0.0 else _rounded(status.battery, 3)


def _age_ms(heard_ns: int, now_ns: int) -> int | None:
    return (now_ns - heard_ns) // MS if heard_ns else None


def _rounded(value: float | None, digits: int) -> float | None:
    return round(float(value), digits) if value is not None and math.isfinite(value) else None
