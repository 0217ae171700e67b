"""What every robot has, tick by tick: the filter's errors and delays in columns. A group's own is in ``gauge.py``."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.recording.gauge import gauges
from robofleet.recording.reduced import Delays, Distribution
from robofleet.recording.run import Run


def load_kernels(config: Config) -> None:
    """Load what the groups' measures are computed with: who computes them beside a run must not wait for it later."""
    gauges(config, groups.descriptions(config))


def pose_error_mm(run: Run) -> Array | None:
    return None if run.pose_errors is None else run.pose_errors[0] * 1e3


def heading_error_deg(run: Run) -> Array | None:
    return None if run.pose_errors is None else np.degrees(run.pose_errors[1])


def status_at_ticks(run: Run, measure: Callable[[NDArray[Any]], Array]) -> Array:
    """Return a figure (K, N) of the newest status of each robot that came before a tick; NaN where there is none."""
    values = np.full((len(run.ticks), len(run.statuses)), np.nan)
    for robot, newest in enumerate(run.newest_statuses):
        values[newest >= 0, robot] = measure(run.statuses[robot][newest[newest >= 0]])
    return values


def exposure_to_tick_ms(run: Run) -> Array:
    """Return how long after mid-exposure each tick took its newest image (K,) [ms]; NaN: it had none."""
    return np.where(run.ticks["exposure_ns"] > 0, (run.ticks["stamp_ns"] - run.ticks["exposure_ns"]) / 1e6, np.nan)


def exposure_to_wheel_ms(status: NDArray[Any]) -> Array:
    """Return how long after mid-exposure the newest command reached a wheel (S,) [ms]; NaN: it had no image."""
    delays = (status["applied_ns"] - status["applied_exposure_ns"]) / 1e6
    return np.where(status["applied_exposure_ns"] > 0, delays, np.nan)


def delays(run: Run) -> Delays:
    """Return the delays of every image, every tick, and every command that was applied while running."""
    if run.reduced is not None:
        return run.reduced.delays
    ticks, wheel = run.ticks, []
    for row, status in enumerate(run.statuses) if run.start_ns is not None else ():
        running = status["applied_ns"] >= run.start_ns
        _, newest = np.unique(status["applied_ns"][running], return_index=True)
        chosen = status[running][newest][run.own_statuses(row)[running][newest]]
        wheel.append((chosen["applied_ns"] - chosen["applied_exposure_ns"])[chosen["applied_exposure_ns"] > 0])
    poses = np.array([frame.sent_ns - frame.exposure_ns for frame in run.frames], np.int64)
    tick = (ticks["stamp_ns"] - ticks["exposure_ns"])[ticks["exposure_ns"] > 0]
    wheels = np.concatenate(wheel) if wheel else np.empty(0, np.int64)
    return Delays(Distribution.of(poses), Distribution.of(tick), Distribution.of(wheels))


def compute(run: Run) -> Distribution:
    if run.recording.tick_durations_ns is not None:  # in lockstep no time passes on the controller's clock
        return Distribution.of(run.recording.tick_durations_ns)
    return computed(run) if run.reduced is None else run.reduced.compute


def computed(run: Run) -> Distribution:
    """Return how long the ticks of a run, or of a part of it, computed on the controller's clock: each but the last."""
    begins = run.own.start_ns is None
    return Distribution.of(run.ticks["compute_ns"][1 if begins else 0 :])  # of the tick before


def lateness(run: Run) -> Distribution:
    return Distribution.of(run.ticks["lateness_ns"]) if run.reduced is None else run.reduced.lateness


_GAP_S = 0.3  # without a tick for so long, a line is broken


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
