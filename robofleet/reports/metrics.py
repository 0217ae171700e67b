"""Computes ``summary.json`` from the messages of a run.

What is each group's own its behaviour measures (``gauge.py``). A figure that was not measured is None.
"""

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.behaviours.described import COMMON_FIGURES
from robofleet.bus.keys import BUSY, key
from robofleet.bus.messages import FleetPoses
from robofleet.config import obstacles
from robofleet.config.tree import OWN_PLANT, Config
from robofleet.core.arrays import Array
from robofleet.core.clock import MS, US
from robofleet.recording import notes
from robofleet.recording.causes import named
from robofleet.recording.measures import compute, computed, delays, lateness
from robofleet.recording.reduced import Counted, Distribution, Images, Mean, Reduced
from robofleet.recording.run import Recording, Run
from robofleet.recording.state_words import busy_figures
from robofleet.reports.bounds import judged
from robofleet.reports.stops import stops
from robofleet.reports.timeline import moments
from robofleet.tracking.events import NO_TAG, TrackerEvent
from robofleet.vehicles.solids import distances

Figures = dict[str, Any]

VERSION = 1  # of summary.json


def summary(
    recording: Recording, *, name: str, mode: str, outcome: str, cause: str | None, began: str | None = None,
    run: Run | None = None, gap: Figures | None = None,
) -> Figures:  # fmt: skip
    """Return the figures of a run as ``summary.json`` has them.

    ``began``: when, UTC, ISO 8601; ``run``: the recording in columns, where somebody has it; ``gap``: to its
    simulation, where somebody measured it.
    """
    run, config = run or Run(recording), recording.config
    whole = run.reduced or reduced(run)
    duration_s = float(run.t[-1]) if len(run.t) else 0.0
    groups = _groups(run, recording)
    figures = {
        "version": VERSION,
        "config": name,
        "seed": config.run.seed,
        "mode": mode,
        "began": began,
        "outcome": outcome,
        "cause": cause,
        "duration_s": duration_s,  # run time
        "clock_duration_s": _clock_duration_s(run, whole),
        "ticks": whole.ticks,
        "real_time_factor": _rounded(duration_s / recording.elapsed_s) if recording.elapsed_s else None,
        "trace_hash": recording.trace_hash,
        "robots": [robot.id for robot in config.members],
        "bystanders": [robot.id for robot in config.bystanders],
        "estimated": [r.id for r, known in zip(config.members, run.known, strict=True) if len(run.t) and not known],
        **_hoisted(groups),
        "groups": groups,
        **_distances(whole, config),
        "min_obstacle_gap_mm": _rounded(whole.obstacle_m * 1e3) if np.isfinite(whole.obstacle_m) else None,
        "pose_error": _pose_error(whole),
        "tracker": _tracker(run, whole, recording),
        "tick": _tick(run, whole),
        "latency_ms": _latency(whole),
        "saturated_fraction": _mean(whole.saturated),
        "filtered_fraction": _mean(whole.filtered),
        "recording": {"messages": recording.count, "dropped": recording.dropped},
        "stops": whole.stops,
        "remarks": remarks(config, groups),
        "busy_machine": busy_figures(recording.messages.get(key(config.arena.name, BUSY), ()), config.ids),
        "rejected": {
            robot.id: None if counted is None else counted.newest - counted.first
            for robot, counted in zip(config.members, whole.rejected, strict=True)
        },
    }
    figures |= {} if gap is None else {"gap": gap}
    return figures | {"bounds": judged(figures, config.run.bounds)}


def reduced(run: Run, *, peaks: bool = False) -> Reduced:
    """Return what the figures of a run, or of a part of it, need of every tick, message and image.

    ``peaks``: with the groups' own figures of the part.
    """
    ticks, begun = run.ticks, run.start_ns is not None
    off2, turn2, off_max_m = _pose_errors(run)
    overruns = ticks["overruns"][[0, -1]].tolist() if len(ticks) else None
    return Reduced(
        begun=begun,
        ended_ns=run.ended_ns,
        ticks=len(ticks),
        delays=delays(run),
        compute=computed(run),
        lateness=lateness(run),
        work=Distribution.of([frame.work_ns for frame in run.frames]),
        overruns=None if overruns is None else Counted(*overruns),
        nearest_m=_nearest(run),
        obstacle_m=_obstacle_gap(run),
        off2=off2,
        turn2=turn2,
        off_max_m=off_max_m,
        saturated=_known(run.items["saturated"]),
        measured=_known(run.items["measured"]),
        filtered=_known(run.items["filtered"] > 0),
        images={name: _images(run, seen) for name, seen in run.images.items()},
        stops=stops(run),
        moments=list(moments(run)),
        rejected=[_rejected(run, status) for status in run.statuses],
        standing=run.standing(),
        peaks={part.group.name: [part.summary()] for part in run.parts} if peaks else {},
    )


def _clock_duration_s(run: Run, whole: Reduced) -> float:
    """Clock time from the first tick of the run to its last one, be that one of a hold [s]."""
    return _rounded(max(0.0, float(run.clock.clock_time_s(whole.ended_ns)))) if whole.ended_ns else 0.0


def _groups(run: Run, recording: Recording) -> Figures:
    """Each group's own figures; ``asked``: what a measure should be, where the behaviour says so; ``kept``: what its
    scripts kept."""
    return {
        part.group.name: part.summary()
        | {"behaviour": part.group.behaviour, "robots": list(part.group.robots), "asked": part.gauge.asked}
        | ({"kept": own} if (own := notes.kept(recording, part.group.name)) else {})
        for part in run.parts
    }


def _hoisted(groups: Figures) -> Figures:
    """Return the common figures that one group alone has."""
    found: Figures = {}
    for figure in COMMON_FIGURES:
        values = [own.get(figure.key) for own in groups.values()]
        have = [own for own in values if isinstance(own, dict) and figure.statistics <= own.keys()]
        found[figure.key] = have[0] if len(have) == 1 else None
    return found


def _pairs(config: Config) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the pairs of bodies of which one at least is driven: two bystanders may stand as they like."""
    first, second = np.triu_indices(len(config.bodies), 1)
    of_robots = first < len(config.members)
    return first[of_robots], second[of_robots]


def _nearest(run: Run) -> Array | None:
    """Return the smallest distance of each pair (P,) [m]; NaN: not known; None: no truth was told."""
    if run.bodies is None:
        return None
    first, second = _pairs(run.config)
    found: Array = np.linalg.norm(run.bodies[:, first, :2] - run.bodies[:, second, :2], axis=-1).min(
        axis=0, initial=np.inf
    )
    return found


def _distances(whole: Reduced, config: Config) -> Figures:
    """Smallest distance between a robot's centre and another robot's or a bystander's, and between their bodies, over
    the whole run."""
    distances = whole.nearest_m
    if distances is None or not len(distances) or not np.isfinite(distances).all():
        return {"min_gap_mm": None, "min_centre_distance_mm": None}
    first, second = _pairs(config)
    radii = np.array([robot.vehicle.body_radius_m for robot in config.bodies])
    gaps = distances - radii[first] - radii[second]
    return {"min_gap_mm": _rounded(gaps.min() * 1e3), "min_centre_distance_mm": _rounded(distances.min() * 1e3)}


def _obstacle_gap(run: Run) -> float:
    """Smallest distance between a robot's body and an obstacle, or the edge of ``floor_m`` [m]; infinite: of none."""
    solids, config = obstacles.every(run.config.arena), run.config
    if run.truth is None or not solids or not len(run.t):
        return math.inf
    radii = np.array([robot.vehicle.body_radius_m for robot in config.members])[run.known]
    at = run.truth[:, run.known, :2]
    gaps = distances(solids, at.reshape(-1, 2)).min(axis=0).reshape(at.shape[:2]) - radii
    return float(gaps.min())


def _pose_errors(run: Run) -> tuple[Mean, Mean, float]:
    """The filter at the tick against the truth at the tick: squares [m^2], [rad^2], the largest [m]."""
    if run.pose_errors is None:
        return Mean(), Mean(), 0.0
    off, turn = (errors[:, run.known] for errors in run.pose_errors)
    off, turn = off[np.isfinite(off)], turn[np.isfinite(turn)]
    return _known(off**2), _known(turn**2), float(off.max(initial=0.0))


def _pose_error(whole: Reduced) -> Figures | None:
    off2, turn2 = whole.off2.value, whole.turn2.value
    if off2 is None or turn2 is None:
        return None
    return {
        "rms_mm": _rounded(math.sqrt(off2) * 1e3),
        "max_mm": _rounded(whole.off_max_m * 1e3),
        "heading_rms_deg": _rounded(math.degrees(math.sqrt(turn2))),
    }


def _tracker(run: Run, whole: Reduced, recording: Recording) -> Figures:
    images = whole.images
    frames = sum(seen.frames for seen in images.values())
    work = whole.work
    if recording.tracker_durations_ns is not None:
        work = Distribution.of(np.sort(recording.tracker_durations_ns)[-frames:])  # the other steps had no image
    return {
        "frames": frames,
        "measured_fraction": _measured_fraction(run, whole, frames) if frames else None,
        "false_ids": sum(seen.strange for seen in images.values()) if frames else None,
        "refused": sum(seen.refused for seen in images.values()) if frames else None,
        "events": _events(run) if frames else None,
        "frame_ms": _percentiles(work, (50, 99), MS),
        **({"cameras": {name: _camera(seen) for name, seen in images.items()}} if len(images) > 1 else {}),
    }


def _images(run: Run, frames: list[FleetPoses]) -> Images:
    if not frames:
        return Images()
    fleet, members = ({robot.tag for robot in robots} for robots in (run.config.robots, run.config.members))
    tags = [(pose.tag, pose.coasted_ns == 0) for frame in frames for pose in frame.poses]
    return Images(
        frames=len(frames),
        first_ns=frames[0].exposure_ns,
        newest_ns=frames[-1].exposure_ns,
        measured=sum(seen for _, seen in tags),
        members=sum(seen and tag in members for tag, seen in tags),
        strange=sum(tag not in fleet for tag, _ in tags),
        refused=frames[-1].refused,
    )


def _camera(images: Images) -> Figures:
    took_s = (images.newest_ns - images.first_ns) / 1e9
    return {
        "frames": images.frames,
        "rate_hz": _rounded((images.frames - 1) / took_s) if took_s > 0.0 else None,
        "measured": images.measured,
    }


def _measured_fraction(run: Run, whole: Reduced, frames: int) -> float | None:
    """Of one camera: of each image. Of several no one sees all robots: of each tick."""
    if len(whole.images) > 1:
        return _mean(whole.measured)
    tags = {robot.tag for robot in run.config.members}
    return _rounded(sum(seen.members for seen in whole.images.values()) / (frames * len(tags)))


def _events(run: Run) -> list[Figures]:
    """What happened to the camera and to its tags; before the start at a clock time below 0, and without a run time."""
    clock_s, run_s = run.clock.clock_time_s(run.news["stamp_ns"]), run.clock.run_time_s(run.news["stamp_ns"])
    return [
        {
            "t_s": _rounded(clock),
            "run_time_s": None if np.isnan(reached) else _rounded(reached),
            "clock_time_s": _rounded(clock),
            "event": named(TrackerEvent, row["event"]).replace(" ", "_"),
            "tag": None if row["tag"] == NO_TAG else int(row["tag"]),
            "value": _rounded(row["value"]),
            **({"camera": str(camera)} if len(run.images) > 1 else {}),
        }
        for row, camera, clock, reached in zip(run.news, run.news_of, clock_s, run_s, strict=True)
    ]


def _tick(run: Run, whole: Reduced) -> Figures:
    return {
        "period_ms": run.config.controller.tick_s * 1e3,
        "compute_us": _percentiles(compute(run), (50, 99, 100), US),
        "lateness_us": _percentiles(whole.lateness, (50, 99, 100), US),
        "overruns": None if whole.overruns is None else whole.overruns.newest - whole.overruns.first,
    }


def _latency(whole: Reduced) -> Figures | None:
    """Mid-exposure to wheel of every command that was applied while running, and where that time went."""
    poses, tick, wheel = whole.delays
    if not len(wheel):
        return None
    return {
        "exposure_to_wheel": _percentiles(wheel, (50, 99, 100), MS),
        "stages": {
            "exposure_to_poses": _percentiles(poses, (50, 99), MS),
            "exposure_to_tick": _percentiles(tick, (50, 99), MS),
        },
    }


def _rejected(run: Run, status: NDArray[Any]) -> Counted | None:
    """Messages that a driver refused since the run began: before, whoever held the lease last may still be heard."""
    if not len(status) or run.start_ns is None:
        return None
    before = max(0, int(np.searchsorted(status["stamp_ns"], run.start_ns)) - 1)
    return Counted(int(status["rejected"][before]), int(status["rejected"][-1]))


def _percentiles(durations: Distribution, percents: tuple[int, ...], unit_ns: int) -> Figures | None:
    if not len(durations):
        return None
    found = durations.percentiles(percents) / unit_ns
    return {"max" if p == 100 else f"p{p}": _rounded(v) for p, v in zip(percents, found, strict=True)}


def _known(values: NDArray[Any]) -> Mean:
    """Return what a mean needs of what is known."""
    known = values[np.isfinite(values)]
    return Mean(float(known.sum()), known.size)


def _mean(mean: Mean) -> float | None:
    return None if mean.value is None else _rounded(mean.value)


def _rounded(value: float, digits: int = 4) -> float:
    return round(float(value), digits)


_HEALTHY_TIMED_ERROR_MM = 3.0
_LAW_SHARE = 0.2  # of the timed error: a smaller control error is not its reason


def remarks(config: Config, groups: Mapping[str, Any]) -> list[str]:
    of_groups = (
        line
        for name, figures in groups.items()
        for line in (*_goal_remarks(name, figures), *_estimate_remark(config, figures))
    )
    return [*_second_physics(config), *of_groups]


def _second_physics(config: Config) -> Iterator[str]:
    """Yield what the figures were measured on, where that is not this project's own plant and renderer."""
    if config.simulated and config.plant.model != OWN_PLANT:
        yield f"simulated robots: the physics of plant.model {config.plant.model!r}"
    if config.tracker.source == "camera" and any(camera.source == "mujoco" for _, camera in config.camera_keys):
        yield "images: drawn by MuJoCo's renderer"


def _goal_remarks(name: str, figures: Mapping[str, Any]) -> Iterator[str]:
    """Yield which robots of ``go_to`` are not at their goals."""
    ends = (figures.get("not_at_goal") or {}).items()
    if ends:
        off = ", ".join(
            f"{robot} {end['distance_to_goal_mm']:.1f} mm and {end['heading_error_deg']:.1f} degrees"
            for robot, end in ends
        )
        yield f"{name}: not within the accuracy of their goals: {off}"


def _estimate_remark(config: Config, figures: Mapping[str, Any]) -> Iterator[str]:
    """Yield that the estimate of a disturbance would help: the law does what it must, and the robot is elsewhere."""
    timed, control = figures.get("timed_error_mm"), figures.get("control_error_mm")
    if config.controller.disturbance == "estimated" or not timed or not control:
        return
    if timed["mean"] > _HEALTHY_TIMED_ERROR_MM and control["mean"] < _LAW_SHARE * timed["mean"]:
        yield (
            f"the timed error is {timed['mean']:.1f} mm, the control error {control['mean']:.1f} mm: the wheels move"
            " the robot otherwise than commanded (slip, wear); `controller.disturbance: estimated` corrects that"
        )
