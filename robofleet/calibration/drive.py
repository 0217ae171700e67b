"""A calibrating drive: run through the fleet's own processes, kept, and read again.

Kept as ``drive.npz`` (numpy, without pickle). ``version`` (): 2. ``robots`` (N,): names. For each robot, under its
name and a slash: ``commands_s`` (K,) and ``commands_rad_s`` (K, 2; left, right): its commands and their ticks;
``poses_s`` (M,) and ``poses`` (M, 3; x, y [m], psi [rad]; world): its TAG as measured, and the mid-exposures;
``encoders_s`` (E,) and ``encoders_rad`` (E, 2): its wheels' angles, E = 0 if its driver knows none; ``held_s`` (): how
long it was held; ``acceleration_rad_s2`` (): with which its gate lets the wheels follow. All instants are of the
controller's clock, counted from the drive's first tick [s].
"""

import sys
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.store import CalibrationError
from robofleet.clock import S, WallClock
from robofleet.comms.endpoint import bind_endpoint
from robofleet.comms.keys import CAMERA, POSES, STATUS, TICK, key
from robofleet.comms.messages import FLEET_POSES, ROBOT_STATUS, TICK_RECORD
from robofleet.config.calibrated import TagOffset
from robofleet.config.tree import Config
from robofleet.processes.arena_file import ArenaBusyError, claimed
from robofleet.processes.check import load_checked
from robofleet.processes.fleet import excitation
from robofleet.processes.launcher import Launcher
from robofleet.processes.live_state import WAITING
from robofleet.processes.lockstep import Lockstep
from robofleet.processes.terminal import Terminal
from robofleet.recording.reading import RecordingError, read
from robofleet.recording.run import Recording, Watch
from robofleet.tracking.offset import tag_from_centre

Array = NDArray[np.float64]
Seen = tuple[float, float, float, float]  # at [s], x, y [m], psi [rad]

VERSION = 2
FILE = "drive.npz"

_AROUND_S = 0.5  # kept before the first and after the last motion
_SCALARS = ("held_s", "acceleration_rad_s2")
_WIDTHS = {"commands_rad_s": 2, "poses": 3, "encoders_rad": 2}


@dataclass(frozen=True)
class RobotDrive:
    """One robot's part of a drive; fields as in the file."""

    robot: str
    commands_s: Array
    commands_rad_s: Array
    poses_s: Array
    poses: Array
    encoders_s: Array
    encoders_rad: Array
    held_s: float
    acceleration_rad_s2: float


def configure(file: Path, robots: Sequence[str], *, lockstep: bool) -> tuple[Config, int]:
    """Return the configuration of a drive in which ``robots`` (none: all of the group) drive, and how many do.

    Those that drive come first in the group, and the run ends when they have driven.

    Raises:
        ConfigError: the configuration cannot work.
        CalibrationError: an unknown robot.
    """
    config = load_checked(file, ["groups.0.behaviour=excitation"], lockstep=lockstep)
    if config.run.attended and not lockstep and not sys.stdin.isatty():
        raise CalibrationError("run.attended: stdin is no terminal: start the drive in one, or set it to false")
    group = config.groups[0]
    driving = tuple(dict.fromkeys(robots)) or group.robots
    for unknown in (name for name in driving if name not in group.robots):
        raise CalibrationError(f"--robots: there is no robot {unknown!r} in {file} (it has {', '.join(group.robots)})")
    order = (*driving, *(name for name in group.robots if name not in driving))
    config = config.model_copy(update={"groups": (group.model_copy(update={"robots": order}),)})
    end_s = float(excitation(config).ends[len(driving) - 1])
    run = config.run.model_copy(update={"duration_s": end_s + _AROUND_S})
    return config.model_copy(update={"run": run}), len(driving)


def run(config: Config, folder: Path, say: Callable[[str], None], *, lockstep: bool) -> Recording:
    """Let a configured drive take place, in lockstep or with real processes, and return its messages.

    Raises:
        CalibrationError: the drive did not come to its end.
    """
    watch = _Watch(config, say)
    if lockstep:
        simulated = Lockstep(config)
        outcome, cause = simulated.run(watch)
        recording = simulated.recording
    else:
        try:
            bus = config.bus.model_copy(update={"endpoint": bind_endpoint(config.bus.endpoint)})
        except OSError as error:
            raise CalibrationError(
                f"bus.endpoint: {config.bus.endpoint}: {error.strerror}: end the other run"
            ) from error
        config = config.model_copy(update={"bus": bus})
        outcome, cause, recording = _with_processes(config, folder, watch)
    if outcome != "completed":
        raise CalibrationError(f"the drive did not come to its end: {cause}: mend it, and drive again")
    return recording


def _with_processes(config: Config, folder: Path, watch: Watch) -> tuple[str, str | None, Recording]:
    try:
        with claimed(config, folder, WallClock()), Terminal() as terminal:
            outcome, cause = Launcher(config, folder, watch, terminal).run()
        return outcome, cause, read(folder) if outcome == "completed" else Recording(config)
    except (ArenaBusyError, RecordingError) as error:
        raise CalibrationError(str(error)) from error


def extract(recording: Recording, count: int) -> list[RobotDrive]:
    """Return what the first ``count`` robots of the group did and what was seen of them."""
    config = recording.config
    arena, robots = config.arena.name, config.platoon
    dtype = TICK_RECORD.dtype(len(robots))
    payloads = recording.messages.get(key(arena, TICK), ())
    ticks = np.frombuffer(b"".join(p for p in payloads if len(p) == dtype.itemsize), dtype=dtype)
    if not len(ticks):
        raise CalibrationError("the drive has no tick of the controller: is it running?")
    start_ns, tick_ns = int(ticks["stamp_ns"][0]), round(config.controller.tick_s * S)
    first = int(ticks["tick"][0])
    seen: dict[int, list[Seen]] = {robot.tag: [] for robot in robots}
    for payload in recording.messages.get(key(arena, POSES, CAMERA), ()):
        message = FLEET_POSES.decode(payload)
        if message is None or not message.echo_tick:
            continue
        exposure_ns = (message.echo_tick - first) * tick_ns + message.since_tick_ns
        for tag, after_ns, coasted_ns, x, y, psi in message.poses:
            if coasted_ns == 0 and tag in seen:
                seen[tag].append(((exposure_ns + after_ns) / S, x, y, psi))
    drives = []
    for row, robot in enumerate(robots[:count]):
        offset = TagOffset() if robot.calibration is None else robot.calibration.tag_offset
        poses = [(at_s, *tag_from_centre(x, y, psi, offset)) for at_s, x, y, psi in seen[robot.tag]]
        wheels = np.column_stack([ticks["items"]["left_rad_s"][:, row], ticks["items"]["right_rad_s"][:, row]])
        statuses = recording.rows(key(arena, STATUS, robot.id), ROBOT_STATUS)
        held_s = float(ticks["items"]["saturated"][:, row].sum()) * config.controller.tick_s
        commands_s = (ticks["stamp_ns"] - start_ns) / S
        scalars = held_s, robot.vehicle.max_wheel_acceleration_rad_s2
        drives.append(_cut(robot.id, commands_s, wheels, poses, _encoders(statuses, ticks), scalars))
    return drives


def save(file: Path, drives: Sequence[RobotDrive]) -> None:
    """Write a drive."""
    arrays: dict[str, Any] = {"version": np.array(VERSION), "robots": np.array([drive.robot for drive in drives])}
    for drive in drives:
        fields = {name: value for name, value in vars(drive).items() if name != "robot"}
        arrays |= {f"{drive.robot}/{name}": np.asarray(value) for name, value in fields.items()}
    with file.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def load(file: Path) -> list[RobotDrive]:
    """Read a drive; CalibrationError says what is wrong with a file that is none."""
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except OSError as error:
        raise CalibrationError(f"{file}: {error.strerror or 'is cut short'}: name the drive.npz of a drive") from error
    except (ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise CalibrationError(f"{file}: is no recording of a drive: name the drive.npz of one") from error
    version = arrays.get("version")
    if version is None or version.shape or "robots" not in arrays:
        raise CalibrationError(f"{file}: is no recording of a drive: name the drive.npz of one")
    if version != VERSION:
        raise CalibrationError(f"{file}: is a recording of version {version}, this reads {VERSION}: drive again")
    return [_robot_drive(file, str(name), arrays) for name in np.atleast_1d(arrays["robots"])]


def chosen(file: Path, robots: Sequence[str]) -> list[RobotDrive]:
    """Return the recorded drives of some robots, of all where none is named."""
    recorded = {drive.robot: drive for drive in load(file)}
    for unknown in (name for name in robots if name not in recorded):
        raise CalibrationError(f"--robots: {unknown!r} did not drive in {file} ({', '.join(recorded)} did)")
    return [recorded[name] for name in dict.fromkeys(robots) or recorded]


def _robot_drive(file: Path, robot: str, arrays: dict[str, NDArray[Any]]) -> RobotDrive:
    fields = [name for name in RobotDrive.__dataclass_fields__ if name != "robot"]
    found = {name: arrays.get(f"{robot}/{name}") for name in fields}
    for name, array in found.items():
        if array is None or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
            raise CalibrationError(f"{file}: {robot}/{name} is missing or not a finite number: drive again")
        shape = _shape(name, found)
        if array.shape != shape or (name in ("commands_s", "poses_s", "encoders_s") and (np.diff(array) <= 0).any()):
            raise CalibrationError(
                f"{file}: {robot}/{name} has shape {array.shape}, not {shape}, or goes back in time: drive again"
            )
    values: dict[str, Any] = {name: np.asarray(array, dtype=float) for name, array in found.items()}
    return RobotDrive(robot, **{**values, **{name: float(values[name]) for name in _SCALARS}})


def _shape(name: str, found: dict[str, Any]) -> tuple[int, ...]:
    """Return the shape that a field must have beside its instants."""
    if name in _SCALARS:
        return ()
    instants = name if name.endswith("s_s") else f"{name.partition('_')[0]}_s"
    return (np.size(found[instants]), *((_WIDTHS[name],) if name in _WIDTHS else ()))


def _encoders(statuses: NDArray[Any], ticks: NDArray[Any]) -> tuple[Array, Array]:
    """Return instants and angles of the wheels, put on the controller's clock; empty where that cannot be.

    A status says when the newest command was applied, and by which image that command was made: the tick that used
    this image, if there is one alone, was before by as much as a command takes and the two clocks differ.
    """
    empty = np.empty(0), np.empty((0, 2))
    angles = np.column_stack([statuses["left_angle_rad"], statuses["right_angle_rad"]])
    if not len(statuses) or not np.ptp(angles, axis=0).any():
        return empty
    exposures, index, counts = np.unique(ticks["exposure_ns"], return_index=True, return_counts=True)
    stamp_of = dict(zip(exposures[counts == 1].tolist(), ticks["stamp_ns"][index[counts == 1]].tolist(), strict=True))
    applied = zip(statuses["applied_exposure_ns"].tolist(), statuses["applied_ns"].tolist(), strict=True)
    shifts = [
        at_ns - stamp_of[exposure_ns] for exposure_ns, at_ns in applied if exposure_ns and exposure_ns in stamp_of
    ]
    if not shifts:
        return empty
    at_s = (statuses["stamp_ns"] - min(shifts) - int(ticks["stamp_ns"][0])) / S
    order = np.unique(at_s, return_index=True)[1]
    return at_s[order], angles[order]


def _cut(
    robot: str,
    commands_s: Array,
    wheels: Array,
    poses: list[Seen],
    encoders: tuple[Array, Array],
    scalars: tuple[float, float],
) -> RobotDrive:
    """Return a robot's own part of the drive: the others stand then, and it stands before and after."""
    moving = commands_s[wheels.any(axis=1)]
    if not len(moving):
        raise CalibrationError(f"{robot}: it was never told to move: was it seen, and had it room?")
    start_s, end_s = float(moving[0]) - _AROUND_S, float(moving[-1]) + _AROUND_S
    seen = np.array(sorted(poses)).reshape(-1, 4)
    seen = seen[np.unique(seen[:, 0], return_index=True)[1]]

    def inside(at_s: Array, values: Array) -> tuple[Array, Array]:
        own = (at_s >= start_s) & (at_s <= end_s)
        return at_s[own], values[own]

    told, measured, counted = inside(commands_s, wheels), inside(seen[:, 0], seen[:, 1:]), inside(*encoders)
    return RobotDrive(robot, *told, *measured, *counted, *scalars)


class _Watch:
    """Says which robot drives, or what is waited for."""

    def __init__(self, config: Config, say: Callable[[str], None]) -> None:
        self._config, self._say, self._said = config, say, ""
        self._ends = excitation(config).ends
        self._count = int(np.searchsorted(self._ends, config.run.duration_s))

    def __call__(self, recording: Recording, phase: str) -> None:
        text = WAITING.get(phase, phase)
        ticks = recording.messages.get(key(self._config.arena.name, TICK))
        head = TICK_RECORD.decode_head(ticks[-1]) if ticks and phase == "running" else None
        if head is not None and head[3] >= 0:
            row = int(np.searchsorted(self._ends, head[3] * self._config.controller.tick_s, side="right"))
            if row < self._count:
                text = f"{self._config.groups[0].robots[row]} drives"
        if text != self._said:
            self._said = text
            self._say(text)
