"""A calibration drive: runs it with the fleet's own processes, and extracts the data of each robot."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.behaviours import described
from robofleet.behaviours.excitation import Excitation, Manoeuvre
from robofleet.bus.arena_file import ArenaBusyError, claimed
from robofleet.bus.endpoint import check_router, settled
from robofleet.bus.keys import POSES, STATE, STATUS, TICK, key
from robofleet.bus.messages import FLEET_POSES, TICK_RECORD
from robofleet.bus.private_folder import PlaceError
from robofleet.calibration.robots import heights
from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.store import CalibrationError
from robofleet.config import groups
from robofleet.config.tree import Config, Group
from robofleet.core.arrays import Array
from robofleet.core.clock import S
from robofleet.operator.latches import refuse_latched
from robofleet.operator.terminal.live_state import WAITING
from robofleet.operator.terminal.terminal import Terminal
from robofleet.recording.reading import RecordingError, read
from robofleet.recording.run import Recording, Watch
from robofleet.recording.state_words import state_words
from robofleet.runs.check import load_checked
from robofleet.runs.launcher import Launcher
from robofleet.runs.lockstep import Lockstep
from robofleet.tracking.offset import tag_covariance, tag_from_centre

Timed = tuple[Array, Array]  # at (n,) [s], values (n, ...)
Seen = tuple[float, ...]  # at [s], x, y [m], psi [rad], and the six numbers of their covariance

_GROUP = "excitation"
_REST_AROUND_S = 0.5  # kept before the first and after the last motion


def configure(
    file: Path, robots: Sequence[str], overrides: Sequence[str] = (), *, lockstep: bool
) -> tuple[Config, int]:
    """Return the configuration of a drive that takes place now, as ``excited``, and how many robots drive.

    Raises:
        ConfigError: the configuration cannot work.
        CalibrationError: an unknown robot.
    """
    count = 0

    def one_after_the_other(config: Config) -> Config:
        nonlocal count
        config, count = excited(config, robots, file)
        return config

    config = load_checked(file, overrides, lockstep=lockstep, change=one_after_the_other)
    if config.run.attended and not lockstep and not sys.stdin.isatty():
        raise CalibrationError("run.attended: stdin is not a terminal: start the drive in one, or set it to false")
    return lasting(config, count), count


def excited(config: Config, robots: Sequence[str], file: Path) -> tuple[Config, int]:
    """Return a configuration in which ``robots`` (none: those of all groups) drive, and how many do.

    It has one group: those that drive, then the other robots of the configuration's groups, which stand.

    Raises:
        CalibrationError: an unknown robot.
    """
    grouped, known = [robot.id for robot in config.members], [robot.id for robot in config.robots]
    driving = tuple(dict.fromkeys(robots or grouped))
    for unknown in (name for name in driving if name not in known):
        raise CalibrationError(f"--robots: there is no robot {unknown!r} in {file} (it has {', '.join(known)})")
    order = tuple(dict.fromkeys([*driving, *grouped]))
    group = Group(name=_GROUP, behaviour=_GROUP, robots=order)
    return config.model_copy(update={"groups": (group,)}), len(driving)


def with_manoeuvres(config: Config, manoeuvres: Mapping[str, tuple[Manoeuvre, ...]]) -> Config:
    """Return a drive's configuration in which robots drive these manoeuvres."""
    (group,) = config.groups
    settings = Excitation.Settings(manoeuvres=dict(manoeuvres)).model_dump(mode="json")
    return config.model_copy(update={"groups": (group.model_copy(update={"settings": settings}),)})


def lasting(config: Config, count: int) -> Config:
    """Return a drive's configuration that ends when the first ``count`` robots have driven."""
    end_s = float(excitation(config).ends[count - 1])
    run = config.run.model_copy(update={"duration_s": end_s + _REST_AROUND_S})
    return config.model_copy(update={"run": run})


def excitation(config: Config) -> Excitation:
    """Return a drive's behaviour."""
    (behaviour,) = groups.behaviours(config)
    assert isinstance(behaviour, Excitation)
    return behaviour


def run(config: Config, folder: Path, say: Callable[[str], None], *, lockstep: bool) -> Recording:
    """Let a configured drive take place, in lockstep or with real processes, and return its messages.

    Raises:
        CalibrationError: the drive did not come to its end.
    """
    watch = _watch(config, say)
    tracker = config.tracker.model_copy(update={"tag_side_tolerance_m": 0.0})  # each size is told, not only wrong ones
    config = config.model_copy(update={"tracker": tracker})
    if lockstep:
        simulated = Lockstep(config)
        outcome, cause = simulated.run(watch)
        recording = simulated.recording
    else:
        try:
            config = settled(config, listen=True)
        except PlaceError as error:
            raise CalibrationError(str(error)) from error
        outcome, cause, recording = _with_processes(config, folder, watch)
    if outcome != "completed":
        raise CalibrationError(f"the drive did not come to its end: {cause}: mend it, and drive again")
    return recording


def _with_processes(config: Config, folder: Path, watch: Watch) -> tuple[str, str | None, Recording]:
    try:
        with claimed(config, folder), Terminal() as terminal:
            refuse_latched(config)
            check_router(config)
            outcome, cause = Launcher(config, folder, watch, terminal).run()
        if outcome != "completed":
            return outcome, cause, Recording(config)
        return outcome, cause, read(folder, groups.own(config).__contains__)
    except (ArenaBusyError, PlaceError, RecordingError) as error:
        raise CalibrationError(str(error)) from error


def extract(recording: Recording, rows: Sequence[int]) -> list[RobotDrive]:
    """Return what robots of the groups did, and what was seen of them."""
    config = recording.config
    arena, robots = config.arena.name, config.members
    dtype = TICK_RECORD.dtype(len(robots), described.size(recording.groups, len(config.camera_names)))
    payloads = recording.messages.get(key(arena, TICK), ())
    ticks = np.frombuffer(b"".join(p for p in payloads if len(p) == dtype.itemsize), dtype=dtype)
    if not len(ticks):
        raise CalibrationError("the drive has no tick of the controller: is it running?")
    held = np.nan_to_num(_held(recording, ticks))
    start_ns, tick_ns = int(ticks["stamp_ns"][0]), round(config.controller.tick_s * S)
    first = int(ticks["tick"][0])
    seen: dict[int, list[Seen]] = {robot.tag: [] for robot in robots}
    images = (recording.messages.get(key(arena, POSES, camera), ()) for camera in config.camera_names)
    for payload in chain.from_iterable(images):
        message = FLEET_POSES.decode(payload)
        if message is None or not message.echo_tick:
            continue
        exposure_ns = (message.echo_tick - first) * tick_ns + message.since_tick_ns
        for pose in message.poses:
            if pose.coasted_ns == 0 and pose.tag in seen:
                seen[pose.tag].append(((exposure_ns + pose.after_ns) / S, *pose[3:]))
    by_size, by_parallax = heights.by_size(recording), heights.by_parallax(recording)
    drives = []
    for row in rows:
        robot = robots[row]
        offset = robot.tag_offset
        poses = [
            (at_s, *tag_from_centre(x, y, psi, offset), *tag_covariance(tuple(covariance), psi, offset))
            for at_s, x, y, psi, *covariance in seen[robot.tag]
        ]
        measured = np.array(sorted(poses)).reshape(-1, 10)
        measured = measured[np.unique(measured[:, 0], return_index=True)[1]]
        wheels = np.column_stack([ticks["items"]["left_rad_s"][:, row], ticks["items"]["right_rad_s"][:, row]])
        series = ((ticks["stamp_ns"] - start_ns) / S, wheels), (measured[:, 0], measured[:, 1:])
        angles = _angles(recording.of_robot(STATUS, robot.id), ticks)
        requested, located, commanded, counted = _cut(robot.id, *series, *angles)
        known = located[1][:, 3:].any(axis=1).all()
        charged = commanded[1][:, 2]
        drive = RobotDrive(
            robot=robot.id,
            commands_s=requested[0],
            commands_rad_s=requested[1],
            poses_s=located[0],
            poses=located[1][:, :3],
            told_s=commanded[0],
            told_rad=commanded[1][:, :2],
            encoders_s=counted[0],
            encoders_rad=counted[1],
            held_s=float(held[:, row].sum()) * config.controller.tick_s,
            acceleration_rad_s2=robot.vehicle.max_wheel_acceleration_rad_s2,
            higher_by_size=by_size[robot.tag],
            higher_by_parallax=by_parallax[robot.tag],
            pose_covariances=located[1][:, 3:] if known else np.empty((0, 6)),
            battery=charged if (charged >= 0.0).all() else np.empty(0),
        )
        drives.append(drive)
    return drives


def _held(recording: Recording, ticks: NDArray[Any]) -> Array:
    """Return which robots (K, N) were held by a calibrating drive; of other drives nothing is."""
    groups_told = described.told(recording.groups, ticks["figures"])
    held = [group.figures.get("held", np.zeros(group.references.shape[:2])) for group in groups_told]
    return np.concatenate(held, axis=1)


def _angles(statuses: NDArray[Any], ticks: NDArray[Any]) -> tuple[Timed, Timed]:
    """Return how far the wheels were told to turn with the charge, and how far they did (nothing, where the robot does
    not know that).

    Both are on the controller's clock: a status says when the newest command was applied, and by which image that
    command was made. The tick that used this image, if there is one alone, was before by as much as a command takes
    and the two clocks differ.
    """
    exposures, index, counts = np.unique(ticks["exposure_ns"], return_index=True, return_counts=True)
    stamp_of = dict(zip(exposures[counts == 1].tolist(), ticks["stamp_ns"][index[counts == 1]].tolist(), strict=True))
    stamp_of.pop(0, None)  # of ticks without an image
    applied = zip(statuses["applied_exposure_ns"].tolist(), statuses["applied_ns"].tolist(), strict=True)
    shifts = [at_ns - stamp_of[exposure_ns] for exposure_ns, at_ns in applied if exposure_ns in stamp_of]
    nothing = np.empty(0), np.empty((0, 2))
    if not shifts:
        return (np.empty(0), np.empty((0, 3))), nothing
    at_s = (statuses["stamp_ns"] - min(shifts) - int(ticks["stamp_ns"][0])) / S
    at_s, order = np.unique(at_s, return_index=True)
    commanded, counted = (
        np.column_stack([statuses[f"left_{name}_rad"], statuses[f"right_{name}_rad"]])[order]
        for name in ("told", "angle")
    )
    charged = np.column_stack([commanded, np.nan_to_num(statuses["battery"][order], nan=-1.0)])
    return (at_s, charged), (at_s, counted) if np.ptp(counted, axis=0).any() else nothing


def _cut(robot: str, requested: Timed, *others: Timed) -> Iterator[Timed]:
    """Yield a robot's own part of each series: the others stand then, and it stands before and after."""
    moving = requested[0][requested[1].any(axis=1)]
    if not len(moving):
        raise CalibrationError(f"{robot}: it was never commanded to move: did the tracker see it, and had it room?")
    start_s, end_s = float(moving[0]) - _REST_AROUND_S, float(moving[-1]) + _REST_AROUND_S
    for at_s, values in (requested, *others):
        own = (at_s >= start_s) & (at_s <= end_s)
        yield at_s[own], values[own]


def _watch(config: Config, say: Callable[[str], None]) -> Watch:
    """Return what says which robot drives, or what is waited for."""
    ends, last_text = excitation(config).ends, ""
    count = int(np.searchsorted(ends, config.run.duration_s))

    def watch(recording: Recording, phase: str) -> None:
        nonlocal last_text
        text = WAITING.get(phase, phase)
        if phase == "held" and (state := recording.newest(STATE)) is not None:
            text = f"held: {state_words(state, None, config.ids).advice}; then press r, or `robofleet resume`"
        head = recording.newest(TICK) if phase == "running" else None
        if head is not None and head.run_tick >= 0:
            row = int(np.searchsorted(ends, head.run_tick * config.controller.tick_s, side="right"))
            if row < count:
                text = f"{config.members[row].id} drives"
        if text != last_text:
            last_text = text
            say(text)

    return watch
