"""What is known of each robot at each tick, in columns: ``metrics.csv``, and what viewers plot.

``COLUMNS`` are those of every robot; behind them come those of its group. A name ends with its unit, and its meaning is
said in a sentence.
"""

from collections.abc import Callable, Iterable, Sequence
from io import BufferedWriter, TextIOWrapper
from pathlib import Path
from typing import NamedTuple, TextIO

import numpy as np

from robofleet.core.arrays import Array
from robofleet.core.files import replaced
from robofleet.recording.gauge import Gauge
from robofleet.recording.measures import (
    exposure_to_tick_ms,
    exposure_to_wheel_ms,
    heading_error_deg,
    pose_error_mm,
    status_at_ticks,
)
from robofleet.recording.run import GroupColumns, Run

CSV = "metrics.csv"


class Column(NamedTuple):
    """A figure of every robot at every tick."""

    name: str
    meaning: str
    of: Callable[[Run], Array | None]  # (K, N); None: not known
    running: bool = False  # whether it means something only while the fleet is running
    whole: bool = False  # whether it is a flag or a count
    csv: str = ""  # its name in metrics.csv where that is another one

    def values(self, run: Run) -> Array:
        """Return the figure (K, N); NaN where it is not known."""
        values = self.of(run)
        if values is None:
            return np.full(run.items.shape, np.nan)
        return (
            np.where(run.running[:, None], values, np.nan) if self.running else np.broadcast_to(values, run.items.shape)
        )


def _recorded(name: str, meaning: str, *, running: bool = False, whole: bool = False, csv: str = "") -> Column:
    return Column(name, meaning, lambda run: run.items[csv or name], running, whole, csv)


def _true(name: str, axis: int, meaning: str) -> Column:
    def of(run: Run) -> Array | None:
        if run.truth is None:
            return None
        values = run.truth[..., axis]
        return _wrapped(values) if axis == 2 else values

    return Column(name, meaning, of)


def _wrapped(psi: Array) -> Array:
    """Return headings in (-pi, pi]."""
    return np.asarray(np.pi - (np.pi - psi) % (2 * np.pi))


def _reference(name: str, axis: int) -> Column:
    meaning = "where the followed point is to be, at the behaviour's horizon [m]"
    return Column(name, meaning, lambda run: run.references[..., axis], running=True)


def _wheel(side: str) -> Callable[[Run], Array]:
    return lambda run: status_at_ticks(run, lambda status: status[side])


COLUMNS = (
    _recorded("x_m", "centre in the world, as the filter estimates it at the tick [m]"),
    _recorded("y_m", "centre in the world, as the filter estimates it at the tick [m]"),
    _recorded("psi_rad", "heading in the world, counter-clockwise positive, as the filter estimates it [rad]"),
    _true("true_x_m", 0, "true centre in the world; of simulated robots only [m]"),
    _true("true_y_m", 1, "true centre in the world; of simulated robots only [m]"),
    _true("true_psi_rad", 2, "true heading in the world; of simulated robots only [rad]"),
    _recorded("point_x_m", "point p when the command acts, as predicted [m]"),
    _recorded("point_y_m", "point p when the command acts, as predicted [m]"),
    _reference("reference_x_m", 0),
    _reference("reference_y_m", 1),
    _recorded("u_x_m_s", "velocity of the point p that is asked for, as wheels and barrier let it [m/s]", running=True),
    _recorded("u_y_m_s", "velocity of the point p that is asked for, as wheels and barrier let it [m/s]", running=True),
    _recorded("left_commanded_rad_s", "left wheel as commanded [rad/s]", csv="left_rad_s"),
    _recorded("right_commanded_rad_s", "right wheel as commanded [rad/s]", csv="right_rad_s"),
    Column("pose_error_mm", "distance of the filter's centre from the true one [mm]", pose_error_mm),
    Column("heading_error_deg", "the filter's heading minus the true one [deg]", heading_error_deg),
    _recorded("saturated", "1: the wheels could not do all of the input", whole=True),
    _recorded("measured", "1: an image was used for this robot in this tick", whole=True),
    _recorded("lost", "1: no image for too long, the robot stands still", whole=True),
    _recorded("filtered", "1: the barrier changed the command; 2: it found no answer, the robot stands", whole=True),
    _recorded("blocked", "1: the barrier has held the robot for so long that it will not get on by itself", whole=True),
    _recorded("failed", "not 0: its group's behaviour failed by this event, and it stands", whole=True),
    Column("left_measured_rad_s", "left wheel as the robot measured it last [rad/s]", _wheel("left_rad_s")),
    Column("right_measured_rad_s", "right wheel as the robot measured it last [rad/s]", _wheel("right_rad_s")),
    Column(
        "exposure_to_tick_ms",
        "age of the newest image used, at the tick [ms]",
        lambda run: exposure_to_tick_ms(run)[:, None],
    ),
    Column(
        "exposure_to_wheel_ms",
        "from mid-exposure to the wheels, of the newest command that reached them [ms]",
        lambda run: status_at_ticks(run, exposure_to_wheel_ms),
    ),
)


_FIRST = "t_s", "tick", "run_tick", "robot", "group"  # of a row of metrics.csv
_LAST = "run_time_s", "clock_time_s", "counts"
_TAKEN = {*_FIRST, *_LAST, *(column.name for column in COLUMNS), *(column.csv for column in COLUMNS)}


def own_name(name: str) -> str:
    """Return what a group's own column is called: where a column of every robot has its name, ``own_`` and the name."""
    return f"own_{name}" if name in _TAKEN else name


def own_names(gauges: Iterable[Gauge]) -> list[str]:
    return list(dict.fromkeys(own_name(name) for gauge in gauges for name in gauge.columns))


def table(run: Run) -> Array:
    """Return every robot's columns (K, N, C); NaN where a value is not known."""
    return np.stack([column.values(run) for column in COLUMNS], axis=-1)


def own_table(part: GroupColumns, names: Sequence[str], *, counted: bool = False) -> Array:
    """Return columns of a group's own (K, n, C) by their names; NaN where the group has none of this name.

    ``counted``: of a measure that counts later than others, only what counts.
    """
    values = np.full((len(part.group.robots), len(names), len(part.running)), np.nan)
    places = {name: index for index, name in enumerate(names)}
    for curve in part.curves:
        for name, (rows, columns) in curve.columns.items():
            if (index := places.get(own_name(name))) is not None:
                values[rows, index] = (curve.counted if counted else curve.values).T[list(columns)]
    return values.transpose(2, 0, 1)


def ticks_table(run: Run, own: Sequence[str]) -> tuple[Run, Array]:
    """Return a run with every tick since its start (K), and each robot's columns (K, N, C): ``COLUMNS``, then ``own``.

    The mean of a group's own column over the ticks at which ``Run.counts``, without NaN, is the summary's.
    """
    whole = run.whole()
    values = np.full((*whole.items.shape, len(COLUMNS) + len(own)), np.nan)
    values[..., : len(COLUMNS)] = table(whole)
    own_values = np.concatenate([own_table(part, own, counted=True) for part in run.parts], axis=1)
    values[whole.running, :, len(COLUMNS) :] = own_values[run.running]
    return whole, values


def write_csv(parts: Iterable[Run], file: Path) -> None:
    """Write a row for each robot at every tick since the start, of a run part by part; what is not known is empty.

    Where no part can be read, nothing is written.
    """
    remaining = iter(parts)
    part = next(remaining)
    with replaced(file) as stream, TextIOWrapper(BufferedWriter(stream), encoding="ascii") as out:
        own = own_names(group.gauge for group in part.parts)
        names = [*(column.csv or column.name for column in COLUMNS), *own]
        out.write(",".join([*_FIRST, *names, *_LAST]) + "\n")
        _write_rows(part, own, out)
        del part  # before the next one is read
        for part in remaining:
            _write_rows(part, own, out)
            del part


def _write_rows(run: Run, own: Sequence[str], out: TextIO) -> None:
    robots = [f"{robot},{group.name}" for group in run.groups for robot in group.robots]
    run, values = ticks_table(run, own)
    row = "".join(",%.0f" if column.whole else ",%.6g" for column in COLUMNS) + ",%.6g" * len(own)
    heads = (run.clock_time_s, run.ticks["tick"], run.ticks["run_tick"], run.run_time_s, run.counts)
    whens = zip(*(head.tolist() for head in heads), strict=True)
    for (clock_s, tick, run_tick, run_s, counts), of_tick in zip(whens, values, strict=True):  # Python's own floats are
        when = f"{clock_s:.3f},{tick},{run_tick},"  # quickly written
        last = f",{run_s:.3f},{clock_s:.3f},{counts:d}\n"
        for robot, robot_row in zip(robots, of_tick.tolist(), strict=True):
            out.write(when + robot + (row % tuple(robot_row)).replace("nan", "") + last)
