"""What a drive's commands made of the wheels: through the gate, as it told, with delay and lag."""

import numpy as np

from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.store import CalibrationError
from robofleet.core.arrays import Array
from robofleet.safety.gate import RAMP_NS

_FEWEST_SAMPLES = 3  # of an angle
_SHORTEST_LAG_S = 1e-6
_SAME_RAD = 1e-6
_SAME_SPEED = 0.01  # [rad/s]
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

    Between two statuses it told its wheels to turn by so much: commands came late, it was stepped more often than its
    ramp needs, or it was closed. There the wheels jump from the speeds before to those that were commanded, at the
    instant that makes them turn so far; where no instant does, they have their mean speeds. A difference that is added
    instead would be lost where it is within a dead band.
    """
    told_s, duration_s = drive.told_s, np.diff(drive.told_s)
    travel = np.diff(drive.told_rad, axis=0)
    short = travel - np.diff(wheel_travel(at_s, outputs, 0.0, 0.0, told_s), axis=0)
    wrong = (np.abs(short) > _SAME_RAD).any(axis=1)
    every_s = np.union1d(at_s, told_s)
    k = np.searchsorted(at_s, every_s, side="right") - 1
    speeds = np.where(k[:, None] >= 0, outputs[k], 0.0)
    between = np.searchsorted(told_s, every_s, side="right") - 1
    kept = ~np.concatenate([wrong, [False]])[between]  # index -1, before the first status: kept
    instants, rows = [every_s[kept]], [speeds[kept]]
    ends: dict[int, Array] = {}
    for row in np.flatnonzero(wrong).tolist():
        start, end = np.searchsorted(every_s, told_s[row : row + 2]).tolist()
        before, last, mean = (
            ends.get(row - 1, speeds[max(0, start - 1)]),
            speeds[end - 1],
            travel[row] / duration_s[row],
        )
        change = last - before
        share = float(change @ (mean - before) / max(change @ change, _SAME_RAD))  # of the time, after the jump
        if 0.0 <= share <= 1.0 and np.abs(before + share * change - mean).max() < _SAME_SPEED:
            instants.append(np.array([told_s[row], told_s[row + 1] - share * duration_s[row]]))
            rows.append(np.array([before, last]))
            ends[row] = last if share > 0.0 else before
        else:
            instants.append(told_s[row : row + 1])
            rows.append(mean[None])
            ends[row] = mean
    order = np.argsort(np.concatenate(instants), kind="stable")
    return np.concatenate(instants)[order], np.concatenate(rows)[order]


def wheel_travel(commands_s: Array, commands: Array, delay_s: float, lag_s: float, at_s: Array) -> Array:
    """Return the angles (M, 2) that wheels at rest at first have turned at instants (M,) [rad].

    Commands (K, 2) act ``delay_s`` after their ticks (K,); the wheels follow with a first-order lag.
    """
    acts_s = commands_s + delay_s
    lag_s = max(lag_s, _SHORTEST_LAG_S)
    steps = np.diff(acts_s)
    kept = np.exp(-steps / lag_s)
    speed, angle = np.zeros_like(commands), np.zeros_like(commands)  # when each command begins to act
    for side in range(2):
        w, turned = 0.0, 0.0
        commanded = commands[:, side].tolist()
        history = [(w, turned)]
        for command, step, part in zip(commanded, steps.tolist(), kept.tolist(), strict=False):
            ahead = w - command
            turned += command * step + ahead * lag_s * (1.0 - part)
            w = command + ahead * part
            history.append((w, turned))
        speed[:, side], angle[:, side] = np.array(history).T
    k = np.searchsorted(acts_s, at_s, side="right") - 1
    since = np.where(k >= 0, at_s - acts_s[k], 0.0)[:, None]
    travel = angle[k] + commands[k] * since + (speed[k] - commands[k]) * (lag_s * -np.expm1(-since / lag_s))
    return np.where(k[:, None] >= 0, travel, 0.0)
