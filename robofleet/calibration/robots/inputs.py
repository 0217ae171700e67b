"""What a drive's commands made of the wheels: through the gate, as it told, with delay and lag."""

from itertools import pairwise

import numpy as np

from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.store import CalibrationError
from robofleet.core.arrays import Array
from robofleet.safety.gate import RAMP_NS

_FEWEST_SAMPLES = 3  # of an angle
_SAME_RAD = 1e-6
_SHIFTS_S = 1e-4 * np.array(sorted(range(-200, 401), key=abs))
_UNEXPLAINED = 0.05  # difference of mean speeds [rad/s]
_RAMP_S = RAMP_NS * 1e-9
_SEEN_SHARE = 0.6  # of the images, at least
_LONGEST_GAP_S = 1.0


def refuse_unusable(drive: RobotDrive) -> None:
    """Raise a CalibrationError if a robot was not seen well enough, or stood still."""
    if len(drive.told_s) < _FEWEST_SAMPLES:
        raise CalibrationError(f"{drive.robot}: its driver did not report the wheels' commands: drive again")
    start_s, end_s = drive.commands_s[[0, -1]] if len(drive.commands_s) else (0.0, 0.0)
    seen = drive.poses_s[(drive.poses_s >= start_s) & (drive.poses_s <= end_s)]
    gap_s = float(np.diff(np.concatenate([[start_s], seen, [end_s]])).max())
    fraction = len(seen) / max(1, len(drive.commands_s))
    if gap_s > _LONGEST_GAP_S or fraction < _SEEN_SHARE:
        raise CalibrationError(
            f"{drive.robot}: it was seen in {100 * fraction:.0f} % of the images, and once not for {gap_s:.1f} s: "
            "light its tag, clear the view, and drive again"
        )
    refuse_still(drive)


def refuse_still(drive: RobotDrive) -> None:
    """Raise a CalibrationError if a robot was not seen to move."""
    if not len(drive.poses):
        raise CalibrationError(f"{drive.robot}: it was not seen while it drove: light its tag, and drive again")
    extent = np.ptp(drive.poses[:, :2], axis=0).max(), np.ptp(np.unwrap(drive.poses[:, 2]))
    if extent[0] < 0.01 and extent[1] < 0.3:
        raise CalibrationError(f"{drive.robot}: it was told to move and did not: is it switched on?")


def through_gate(drive: RobotDrive) -> tuple[Array, Array]:
    """Return instants (K,) [s] and wheel speeds (K, 2) [rad/s] that the gate makes of a drive's commands.

    It lets the wheels follow with limited acceleration: without that a jump would look like a delay.
    """
    ends_s = [*drive.commands_s[1:].tolist(), np.inf]
    instants, rows, last_s, output = [], [], -np.inf, np.zeros(2)
    for tick_s, end_s, command in zip(drive.commands_s.tolist(), ends_s, drive.commands_rad_s, strict=True):
        at_s, arrives = tick_s, False
        while at_s < end_s and not arrives:
            reach = drive.acceleration_rad_s2 * min(at_s - last_s, _RAMP_S)
            furthest = float(np.abs(command - output).max())
            arrives = furthest <= reach
            output = command if arrives else output + reach / furthest * (command - output)
            instants.append(at_s)
            rows.append(output)
            last_s, at_s = at_s, at_s + _RAMP_S
    return np.array(instants), np.array(rows)


def as_told(drive: RobotDrive, at_s: Array, outputs: Array) -> tuple[Array, Array]:
    """Return outputs (K, 2) that begin at instants (K,), as ``through_gate``, corrected by what the gate told.

    Between two statuses it told its wheels to turn by so much. Where the outputs differ from that, commands came late,
    or its ramp was stepped at other instants: they are shifted in time. Where no shift explains it, the gate was
    closed: the wheels have their mean speeds. A difference of speeds that is added would be lost within a dead band.
    """
    told_s, travel = drive.told_s, np.diff(drive.told_rad, axis=0)
    begins_s, speeds = np.concatenate([at_s[:1], at_s]), np.vstack([np.zeros((1, 2)), outputs])
    angles = np.vstack([np.zeros((1, 2)), np.cumsum(speeds[:-1] * np.diff(begins_s)[:, None], axis=0)])

    def turned(when_s: Array) -> Array:
        k = np.searchsorted(at_s, when_s, side="right")
        return np.asarray(angles[k] + speeds[k] * (when_s - begins_s[k])[:, None])

    differ = np.abs(np.diff(turned(told_s), axis=0) - travel).max(axis=1) > _SAME_RAD
    known = int(np.searchsorted(at_s, told_s[0] if len(told_s) else np.inf))
    instants, rows = [at_s[:known]], [outputs[:known]]
    for row, (start_s, end_s) in enumerate(pairwise([*told_s.tolist(), np.inf])):
        shift_s = 0.0
        if row < len(travel) and differ[row]:
            errors = np.abs(turned(end_s - _SHIFTS_S) - turned(start_s - _SHIFTS_S) - travel[row]).max(axis=1)
            best = int(errors.round(6).argmin())
            if errors[best] > _UNEXPLAINED * (end_s - start_s):
                instants.append(told_s[row : row + 1])
                rows.append(travel[row : row + 1] / (end_s - start_s))
                continue
            shift_s = _SHIFTS_S[best]
        first, last = np.searchsorted(at_s, (start_s - shift_s, end_s - shift_s), side="right")
        instants.append(np.array([start_s, *(at_s[first:last] + shift_s)]))
        rows.append(speeds[first : last + 1])
    return np.concatenate(instants), np.concatenate(rows)
