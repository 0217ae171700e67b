"""Computes ``summary.json`` from the messages of a run.

What is each group's own its behaviour measures (``gauge.py``). A figure that was not measured is None.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.comms.keys import BUSY, key
from robofleet.comms.messages import FleetPoses
from robofleet.config import obstacles
from robofleet.recording import busy_machine, notes
from robofleet.recording.bounds import judged
from robofleet.recording.causes import named
from robofleet.recording.measures import compute_us, delays_ms, pose_errors
from robofleet.recording.remarks import remarks
from robofleet.recording.run import Array, Recording, Run
from robofleet.recording.stops import stops
from robofleet.tracking.events import NO_TAG, TrackerEvent
from robofleet.vehicles.solids import distances

Figures = dict[str, Any]

# Figures of a group that stand beside those of the whole run, where one group alone has them, and what is in them.
_HOISTED = {
    "control_error_mm": {"mean", "max", "per_robot_mean"},
    "timed_error_mm": {"mean", "max", "per_robot_mean"},
    "path_error_mm": {"mean", "max", "per_robot_mean"},
    "centre_error_mm": {"mean", "max", "per_robot_mean"},
    "spacing_m": {"mean", "max_deviation_mm"},
}


def summary(
    recording: Recording,
    *,
    name: str,
    mode: str,
    outcome: str,
    cause: str | None,
    began: str | None = None,
    run: Run | None = None,
) -> Figures:
    """Return the figures of a run as ``summary.json`` has them.

    ``began``: when, UTC, ISO 8601; ``run``: the recording in columns, where somebody has it.
    """
    run, config = run or Run(recording), recording.config
    duration_s = float(run.t[-1]) if len(run.t) else 0.0
    groups = _groups(run, recording)
    figures = {
        "version": 1,
        "config": name,
        "seed": config.run.seed,
        "mode": mode,
        "began": began,
        "outcome": outcome,
        "cause": cause,
        "duration_s": duration_s,
        "ticks": len(run.t),
        "real_time_factor": _rounded(duration_s / recording.elapsed_s) if recording.elapsed_s else None,
        "trace_hash": recording.trace_hash,
        "robots": [robot.id for robot in config.members],
        "bystanders": [robot.id for robot in config.bystanders],
        "estimated": [r.id for r, known in zip(config.members, run.known, strict=True) if len(run.t) and not known],
        **_hoisted(groups),
        "groups": groups,
        **_distances(run),
        "min_obstacle_gap_mm": _obstacle_gap(run),
        "pose_error": _pose_error(run),
        "tracker": _tracker(run, recording),
        "tick": _tick(run, recording),
        "latency_ms": _latency(run),
        "saturated_fraction": _mean(run.items["saturated"]),
        "filtered_fraction": _rounded((run.items["filtered"] > 0).mean()) if len(run.t) else None,
        "recording": {"messages": recording.count, "dropped": recording.dropped},
        "stops": stops(run),
        "remarks": remarks(config, groups),
        "busy_machine": busy_machine.figures(recording.messages.get(key(config.arena.name, BUSY), ()), config.ids),
        "rejected": {
            robot.id: _rejected(run, status) for robot, status in zip(config.members, run.statuses, strict=True)
        },
    }
    return figures | {"bounds": judged(figures, config.run.bounds)}


def _groups(run: Run, recording: Recording) -> Figures:
    """Each group's own figures; ``asked``: what a measure should be, where the behaviour says so; ``kept``: what its
    scripts kept."""
    return {
        part.said.name: part.summary()
        | {"behaviour": part.said.behaviour, "robots": list(part.said.robots), "asked": part.gauge.asked}
        | ({"kept": own} if (own := notes.kept(recording, part.said.name)) else {})
        for part in run.parts
    }


def _hoisted(groups: Figures) -> Figures:
    found: Figures = {}
    for name, parts in _HOISTED.items():
        told = [own.get(name) for own in groups.values()]
        have = [own for own in told if isinstance(own, dict) and parts <= own.keys()]
        found[name] = have[0] if len(have) == 1 else None
    return found


def _distances(run: Run) -> Figures:
    """Smallest distance between a robot's centre and another robot's or a bystander's, and between their bodies, over
    the whole run."""
    unknown = {"min_gap_mm": None, "min_centre_distance_mm": None}
    if run.bodies is None:
        return unknown
    first, second = np.triu_indices(run.bodies.shape[1], 1)
    of_robots = first < len(run.known)  # two bystanders may stand as they like
    first, second = first[of_robots], second[of_robots]
    distances = np.linalg.norm(run.bodies[:, first, :2] - run.bodies[:, second, :2], axis=-1).min(
        axis=0, initial=np.inf
    )
    if not len(distances) or not np.isfinite(distances).all():
        return unknown
    radii = np.array([robot.vehicle.body_radius_m for robot in run.config.bodies])
    gaps = distances - radii[first] - radii[second]
    return {
        "min_gap_mm": _rounded(gaps.min() * 1e3),
        "min_centre_distance_mm": _rounded(distances.min() * 1e3),
    }


def _obstacle_gap(run: Run) -> float | None:
    """Smallest distance between a robot's body and an obstacle, or the edge of ``floor_m``, over the whole run."""
    solids, config = obstacles.every(run.config.arena), run.config
    if run.truth is None or not solids or not len(run.t):
        return None
    radii = np.array([robot.vehicle.body_radius_m for robot in config.members])[run.known]
    at = run.truth[:, run.known, :2]
    gaps = distances(solids, at.reshape(-1, 2)).min(axis=0).reshape(at.shape[:2]) - radii
    return _rounded(gaps.min() * 1e3) if np.isfinite(gaps).all() else None


def _pose_error(run: Run) -> Figures | None:
    """The filter at the tick against the truth at the tick."""
    if run.truth is None:
        return None
    off, turn = (errors[:, run.known] for errors in pose_errors(run, run.truth))
    off, turn = off[np.isfinite(off)], turn[np.isfinite(turn)]
    if not (off.size and turn.size):
        return None
    return {
        "rms_mm": _rounded(math.sqrt((off**2).mean()) * 1e3),
        "max_mm": _rounded(off.max() * 1e3),
        "heading_rms_deg": _rounded(math.degrees(math.sqrt((turn**2).mean()))),
    }


def _tracker(run: Run, recording: Recording) -> Figures:
    frames, images, fleet = run.frames, run.images, {robot.tag for robot in run.config.robots}
    if recording.tracker_durations_ns is not None:
        durations = sorted(recording.tracker_durations_ns)[-len(frames) :]  # the other steps had no image
    else:
        durations = [frame.work_ns for frame in frames]
    return {
        "frames": len(frames),
        "measured_fraction": _measured_fraction(run) if frames else None,
        "false_ids": sum(pose.tag not in fleet for frame in frames for pose in frame.poses) if frames else None,
        "refused": sum(of[-1].refused for of in images.values() if of) if frames else None,
        "events": _events(run) if frames else None,
        "frame_ms": _percentiles(np.array(durations) / 1e6, (50, 99)),
        **({"cameras": {name: _camera(of) for name, of in images.items()}} if len(images) > 1 else {}),
    }


def _camera(frames: list[FleetPoses]) -> Figures:
    """What one of several cameras saw."""
    took_s = (frames[-1].exposure_ns - frames[0].exposure_ns) / 1e9 if frames else 0.0
    return {
        "frames": len(frames),
        "rate_hz": _rounded((len(frames) - 1) / took_s) if took_s > 0.0 else None,
        "measured": sum(pose.coasted_ns == 0 for frame in frames for pose in frame.poses),
    }


def _measured_fraction(run: Run) -> float | None:
    """Of one camera: of each image. Of several no one sees all robots: of each tick."""
    if len(run.images) > 1:
        return _mean(run.items["measured"])
    tags = {robot.tag for robot in run.config.members}
    seen = sum(pose.tag in tags and pose.coasted_ns == 0 for frame in run.frames for pose in frame.poses)
    return _rounded(seen / (len(run.frames) * len(tags)))


def _events(run: Run) -> list[Figures]:
    """What happened to the camera and to its tags; before the start at a time below 0."""
    start_ns = int(run.ticks["stamp_ns"][0]) if len(run.ticks) else 0
    return [
        {
            "t_s": _rounded((int(row["stamp_ns"]) - start_ns) / 1e9),
            "event": named(TrackerEvent, row["event"]).replace(" ", "_"),
            "tag": None if row["tag"] == NO_TAG else int(row["tag"]),
            "value": _rounded(row["value"]),
            **({"camera": str(camera)} if len(run.images) > 1 else {}),
        }
        for row, camera in zip(run.news, run.news_of, strict=True)
    ]


def _tick(run: Run, recording: Recording) -> Figures:
    ticks = run.ticks
    return {
        "period_ms": run.config.controller.tick_s * 1e3,
        "compute_us": _percentiles(compute_us(run, recording), (50, 99, 100)),
        "lateness_us": _percentiles(ticks["lateness_ns"] / 1e3, (50, 99, 100)),
        "overruns": int(ticks["overruns"][-1]) - int(ticks["overruns"][0]) if len(ticks) else None,
    }


def _latency(run: Run) -> Figures | None:
    """Mid-exposure to wheel of every command that was applied while running, and where that time went."""
    delays = delays_ms(run)
    if not len(delays.wheel):
        return None
    return {
        "exposure_to_wheel": _percentiles(delays.wheel, (50, 99, 100)),
        "stages": {
            "exposure_to_poses": _percentiles(delays.poses, (50, 99)),
            "exposure_to_tick": _percentiles(delays.tick, (50, 99)),
        },
    }


def _rejected(run: Run, status: NDArray[Any]) -> int | None:
    """Messages that a driver refused since the run began: before, whoever held the lease last may still be heard."""
    if not len(status) or not len(run.ticks):
        return None
    before = max(0, int(np.searchsorted(status["stamp_ns"], run.ticks["stamp_ns"][0])) - 1)
    return int(status["rejected"][-1]) - int(status["rejected"][before])


def _percentiles(values: Array, percents: tuple[int, ...]) -> Figures | None:
    if not len(values):
        return None
    found = np.percentile(values, percents)
    return {"max" if p == 100 else f"p{p}": _rounded(v) for p, v in zip(percents, found, strict=True)}


def _mean(values: Array, digits: int = 4) -> float | None:
    """Return the mean of what is known; None where nothing is."""
    known = values[np.isfinite(values)]
    return _rounded(known.mean(), digits) if known.size else None


def _rounded(value: float, digits: int = 4) -> float:
    return round(float(value), digits)
