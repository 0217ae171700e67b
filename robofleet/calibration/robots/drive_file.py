"""The file of a calibration drive: ``drive.npz`` (numpy, without pickle).

``version`` (): 3. ``robots`` (N,): names. For each robot, under its name and a slash: ``commands_s`` (K,) and
``commands_rad_s`` (K, 2; left, right): its commands and their ticks; ``poses_s`` (M,) and ``poses`` (M, 3; x, y [m],
psi [rad]; world): its TAG as measured, and the mid-exposures; ``pose_covariances`` (M, 6; xx, xy, yy [m^2], x psi,
y psi [m rad], psi psi [rad^2]), M = 0: unknown; ``told_s`` (T,) and ``told_rad`` (T, 2): how far its gate has told its
wheels to turn; ``battery`` (T,): its charge then, T = 0 if unknown; ``encoders_s`` (E,) and ``encoders_rad`` (E, 2):
its wheels' angles, E = 0 if its driver knows none; ``held_s`` (): how long it was held; ``acceleration_rad_s2`` ():
with which its gate lets the wheels follow.
``higher_by_size`` and ``higher_by_parallax`` (H, 2): how much higher than configured its tag lies by its size, if the
side is right, and by two cameras, each with its standard deviation [m]; H = 0 where that is not known.
All instants are of the controller's clock, counted from the drive's first tick [s].
"""

import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.calibration.store import CalibrationError
from robofleet.core.arrays import Array

VERSION = 3
FILE = "drive.npz"

_SCALARS = ("held_s", "acceleration_rad_s2")
_INSTANTS = ("commands_s", "poses_s", "told_s", "encoders_s")
_WIDTHS = {"commands_rad_s": 2, "poses": 3, "told_rad": 2, "encoders_rad": 2}
_HEIGHTS = ("higher_by_size", "higher_by_parallax")
_OPTIONAL = {**dict.fromkeys(_HEIGHTS, (0, 2)), "pose_covariances": (0, 6), "battery": (0,)}  # as they are unknown


@dataclass(frozen=True)
class RobotDrive:
    """One robot's part of a drive; fields as in the file."""

    robot: str
    commands_s: Array
    commands_rad_s: Array
    poses_s: Array
    poses: Array
    told_s: Array
    told_rad: Array
    encoders_s: Array
    encoders_rad: Array
    held_s: float
    acceleration_rad_s2: float
    higher_by_size: Array = field(default_factory=lambda: np.empty((0, 2)))
    higher_by_parallax: Array = field(default_factory=lambda: np.empty((0, 2)))
    pose_covariances: Array = field(default_factory=lambda: np.empty((0, 6)))
    battery: Array = field(default_factory=lambda: np.empty(0))


def save(file: Path, drives: Sequence[RobotDrive]) -> None:
    arrays: dict[str, Any] = {"version": np.array(VERSION), "robots": np.array([drive.robot for drive in drives])}
    for drive in drives:
        fields = {name: value for name, value in vars(drive).items() if name != "robot"}
        arrays |= {f"{drive.robot}/{name}": np.asarray(value) for name, value in fields.items()}
    with file.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def load(file: Path) -> list[RobotDrive]:
    try:
        with file.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except OSError as error:
        raise CalibrationError(f"{file}: {error.strerror or 'is cut short'}: name the drive.npz of a drive") from error
    except (ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise CalibrationError(f"{file}: is not a recording of a drive: name the drive.npz of one") from error
    version = arrays.get("version")
    if version is None or version.shape or "robots" not in arrays:
        raise CalibrationError(f"{file}: is not a recording of a drive: name the drive.npz of one")
    if version != VERSION:
        raise CalibrationError(f"{file}: is a recording of version {version}, this reads {VERSION}: drive again")
    return [_robot_drive(file, str(name), arrays) for name in np.atleast_1d(arrays["robots"])]


def chosen(file: Path, robots: Sequence[str]) -> list[RobotDrive]:
    recorded = {drive.robot: drive for drive in load(file)}
    for unknown in (name for name in robots if name not in recorded):
        raise CalibrationError(f"--robots: {unknown!r} did not drive in {file} ({', '.join(recorded)} did)")
    return [recorded[name] for name in dict.fromkeys(robots) or recorded]


def _robot_drive(file: Path, robot: str, arrays: dict[str, NDArray[Any]]) -> RobotDrive:
    fields = [name for name in RobotDrive.__dataclass_fields__ if name != "robot"]
    found = {name: arrays.get(f"{robot}/{name}") for name in fields}
    found |= {name: np.empty(shape) for name, shape in _OPTIONAL.items() if found[name] is None}  # an earlier version
    for name, array in found.items():
        if array is None or array.dtype.kind not in "fiu" or not np.isfinite(array).all():
            raise CalibrationError(f"{file}: {robot}/{name} is missing or not a finite number: drive again")
        shape = _shape(name, found)
        if array.shape != shape or (name in _INSTANTS and (np.diff(array) <= 0).any()):
            raise CalibrationError(
                f"{file}: {robot}/{name} has shape {array.shape}, not {shape}, or goes back in time: drive again"
            )
    values: dict[str, Any] = {name: np.asarray(array, dtype=float) for name, array in found.items()}
    return RobotDrive(robot, **{**values, **{name: float(values[name]) for name in _SCALARS}})


def _shape(name: str, found: dict[str, Any]) -> tuple[int, ...]:
    if name in _SCALARS:
        return ()
    if name in _HEIGHTS:
        return len(found[name]), 2
    if name in _OPTIONAL:
        length = np.size(found["poses_s" if name == "pose_covariances" else "told_s"])
        return (length if np.size(found[name]) else 0, *_OPTIONAL[name][1:])
    instants = name if name.endswith("s_s") else f"{name.partition('_')[0]}_s"
    return (np.size(found[instants]), *((_WIDTHS[name],) if name in _WIDTHS else ()))
