"""A run in columns, tick by tick: what plots and ``metrics.csv`` are made of."""

from typing import NamedTuple

import numpy as np

from robofleet.recording.measures import pose_errors
from robofleet.recording.run import Array, Run

_GAP_S = 0.3  # without a tick for so long, a line is broken


class Series(NamedTuple):
    """Columns over the ticks (K,) of a run, robots (N,) of all groups; None: not measured, of single robots NaN."""

    run: Run
    t: Array  # since the first of these ticks, on the controller's grid [s]
    points: Array  # p: true, else as estimated (K, N, 2) [m]
    pose_mm: Array | None  # of the filter's pose from the true one
    heading_deg: Array | None

    @property
    def robots(self) -> list[str]:
        """The robots' ids."""
        return [robot.id for robot in self.run.config.members]


def series(run: Run) -> Series:
    """Return the columns of a run; the groups' own are its parts' curves."""
    stamps, truth = run.ticks["stamp_ns"], run.truth
    t = (stamps - (run.start_ns or 0)) / 1e9
    if truth is None:
        return Series(run, t, run.points(), None, None)
    off, turn = pose_errors(run, truth)
    return Series(run, t, run.points(), off * 1e3, np.degrees(turn))


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
