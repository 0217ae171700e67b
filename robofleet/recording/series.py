"""A run in columns, tick by tick: what plots and ``metrics.csv`` are made of."""

from io import BufferedWriter, TextIOWrapper
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.files import replaced
from robofleet.recording.measures import pose_errors, spacings, true_errors
from robofleet.recording.run import Array, Run

CSV = "metrics.csv"
_GAP_S = 0.3  # without a tick for so long, a line is broken


class Series(NamedTuple):
    """Columns over the ticks (K,) while the fleet was running, robots (N,) in platoon order; None: not measured, of
    single robots NaN."""

    run: Run
    t: Array  # since the first of these ticks, on the controller's grid [s]
    points: Array  # p: true, else as estimated (K, N, 2) [m]
    control_mm: Array  # (K, N)
    path_mm: Array | None
    timed_mm: Array | None
    spacing_mm: Array  # of each robot's point from its predecessor's (K, N - 1)
    pose_mm: Array | None  # of the filter's pose from the true one
    heading_deg: Array | None

    @property
    def robots(self) -> list[str]:
        """The robots' ids."""
        return [robot.id for robot in self.run.config.platoon]


def series(run: Run) -> Series:
    """Return the columns of a run."""
    stamps, items, truth, points = run.ticks["stamp_ns"], run.items, run.truth, run.points()
    t = (stamps - stamps[:1]) / 1e9
    control = items["control_error_m"] * 1e3
    if points is None:
        points = np.empty((0, len(run.config.platoon), 2))
    gaps = spacings(points) * 1e3
    errors = true_errors(run, np.ones(len(t), np.bool_))
    if truth is None or errors is None:
        return Series(run, t, points, control, None, None, gaps, None, None)
    off, turn = pose_errors(run, truth)
    timed = None if np.isnan(errors.timed).all() else errors.timed * 1e3
    return Series(run, t, points, control, errors.path * 1e3, timed, gaps, off * 1e3, np.degrees(turn))


def line(t: Array, y: Array, span: tuple[float, float], columns: int) -> tuple[Array, Array]:
    """Return what of a line (K,) can be seen on so many columns of pixels over a span of time.

    Of what falls into a column the smallest and the largest value remain: no peak is lost. Where ticks are missing
    the line is broken by a NaN.
    """
    if not len(t):
        return t, y
    if len(t) > 2 * columns:
        column = ((t - span[0]) * (columns / max(span[1] - span[0], 1e-9))).astype(np.int64)
        first = np.flatnonzero(np.diff(column, prepend=column[0] - 1))
        t = np.repeat(t[first], 2)
        y = np.stack([np.fmin.reduceat(y, first), np.fmax.reduceat(y, first)], axis=1).ravel()
    broken = 1 + np.flatnonzero(np.diff(t) > max(_GAP_S, 2.5 * (span[1] - span[0]) / columns))
    return np.insert(t, broken, np.nan), np.insert(y, broken, np.nan)


_HEAD = ("t_s", "tick", "run_tick", "robot")
_POSES = "x_m", "y_m", "psi_rad", "true_x_m", "true_y_m", "true_psi_rad"
_AS_TOLD = "point_x_m", "point_y_m", "reference_x_m", "reference_y_m", "reference_parameter", "u_x_m_s", "u_y_m_s"
_WHEELS = "left_rad_s", "right_rad_s"
_ERRORS = "control_error_mm", "path_error_mm", "timed_error_mm", "spacing_mm", "pose_error_mm", "heading_error_deg"
_FLAGS = "saturated", "measured", "lost", "filtered", "blocked"


def write_csv(columns: Series, file: Path) -> None:
    """Write one row a tick and robot; a value that is not known is empty."""
    run, n = columns.run, len(columns.robots)
    unknown = np.full((len(columns.t), n), np.nan)
    truth = [unknown] * 3 if run.truth is None else list(np.moveaxis(run.truth, -1, 0))
    spacing = np.hstack([unknown[:, :1], columns.spacing_mm])
    errors = columns.control_mm, columns.path_mm, columns.timed_mm, spacing, columns.pose_mm, columns.heading_deg
    told: list[NDArray[np.float64]] = [
        *(run.items[name] for name in _POSES[:3]),
        *truth,
        *(run.items[name] for name in _AS_TOLD + _WHEELS),
        *(unknown if error is None else error for error in errors),
        *(run.items[name] for name in _FLAGS),
    ]
    values = np.stack(told, axis=-1)
    row = ",%.6g" * (values.shape[-1] - len(_FLAGS)) + ",%.0f" * len(_FLAGS)
    with replaced(file) as stream, TextIOWrapper(BufferedWriter(stream), encoding="ascii") as out:
        out.write(",".join(_HEAD + _POSES + _AS_TOLD + _WHEELS + _ERRORS + _FLAGS) + "\n")
        for t, tick, of_tick in zip(columns.t, run.ticks, values, strict=True):
            when = f"{t:.3f},{tick['tick']},{tick['run_tick']},"
            for robot, of in zip(columns.robots, of_tick, strict=True):
                out.write(when + robot + (row % tuple(of)).replace("nan", "") + "\n")
