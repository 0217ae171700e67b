"""What figures and plots are made of, tick by tick: errors, distances and delays in columns."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.clock import S
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.control.path import Path
from robofleet.recording.run import Array, Recording, Run


def path_errors(path: Path, points: Array) -> Array:
    """Distances (K, N) of points (K, N, 2) from the path [m]."""
    flat = points.reshape(-1, 2)
    distances = np.linalg.norm(path.position(path.nearest(flat)) - flat, axis=-1)
    return np.asarray(distances).reshape(points.shape[:2])


def timed_errors(config: Config, path: Path, reference: Array, points: Array, centres: Array) -> Array:
    """Distances (K, N) of p from where it should be now: r(gamma t), or d back from the predecessor [m].

    ``reference`` (K,): the leader's parameter as each tick recorded it, which is where it should be a horizon after the
    tick's commands act. It tells also from where on the lap the run counts. points and centres: (K, N, 2) [m].
    """
    group = config.groups[0]
    centre_tracked = group.track == "centre"
    followed = centres if centre_tracked else points
    should = np.empty(points.shape[:2])
    ahead_s = config.controller.horizon_s + slices.delay_ns(config, config.platoon[0]) / S
    should[:, 0] = (reference - group.path_rate * ahead_s) % path.sides
    for i in range(1, points.shape[1]):
        should[:, i] = path.back(path.nearest(followed[:, i - 1]), group.spacing_m)
    target = path.position(should)
    if centre_tracked:
        target = target + config.controller.point_ahead_m * path.tangent(should)
    return np.asarray(np.linalg.norm(points - target, axis=-1))


class TrueErrors(NamedTuple):
    """Distances (K, N) [m]; NaN where a robot's truth is not known, or a follower's predecessor's."""

    timed: Array  # of p from where it should be now
    path: Array  # of p from the path
    centre: Array  # of the centre from the path


def true_errors(run: Run, counted: NDArray[np.bool_]) -> TrueErrors | None:
    """Return the errors of the true poses at the ticks that count (K,); None where there are none."""
    points = run.points()
    if run.truth is None or points is None or not counted.any():
        return None
    points, centres, known = points[counted], run.poses()[counted][..., :2], run.known
    followed = known & np.concatenate([[True], known[:-1]])
    reference = run.items["reference_parameter"][counted, 0]
    return TrueErrors(
        np.where(followed, timed_errors(run.config, run.path, reference, points, centres), np.nan),
        np.where(known, path_errors(run.path, points), np.nan),
        np.where(known, path_errors(run.path, centres), np.nan),
    )


def spacings(points: Array) -> Array:
    """Distances (K, N - 1) between successive points (K, N, 2) [m]."""
    return np.asarray(np.linalg.norm(np.diff(points, axis=1), axis=-1))


def pose_errors(run: Run, truth: Array) -> tuple[Array, Array]:
    """Distances (K, N) [m] and turns (K, N) [rad] of the filter's poses at the ticks from the true ones (K, N, 3)."""
    off = np.hypot(run.items["x_m"] - truth[..., 0], run.items["y_m"] - truth[..., 1])
    return off, np.angle(np.exp(1j * (run.items["psi_rad"] - truth[..., 2])))


class Delays(NamedTuple):
    """How long after mid-exposure [ms]: the poses were sent, a tick took them, a command of theirs reached a wheel."""

    poses: Array
    tick: Array
    wheel: Array


def delays_ms(run: Run) -> Delays:
    """Return the delays of every image, every tick, and every command that was applied while running."""
    ticks, wheel = run.ticks, []
    for status in run.statuses if len(ticks) else ():
        running = status["applied_ns"] >= ticks["stamp_ns"][0]
        _, newest = np.unique(status["applied_ns"][running], return_index=True)
        applied = status[running][newest]
        applied = applied[applied["applied_exposure_ns"] > 0]
        wheel.append((applied["applied_ns"] - applied["applied_exposure_ns"]) / 1e6)
    poses = np.array([frame.sent_ns - frame.exposure_ns for frame in run.frames]) / 1e6
    tick = (ticks["stamp_ns"] - ticks["exposure_ns"])[ticks["exposure_ns"] > 0] / 1e6
    return Delays(poses, tick, np.concatenate(wheel) if wheel else np.empty(0))


def compute_us(run: Run, recording: Recording) -> Array:
    """Return how long each tick computed [us]."""
    lockstep = recording.tick_durations_ns  # there no time passes on the controller's clock
    return (run.ticks["compute_ns"][1:] if lockstep is None else np.array(lockstep)) / 1e3
