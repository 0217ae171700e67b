"""What ``robofleet identify`` writes into a robot's file, and shows."""

import math
from collections.abc import Sequence

import numpy as np

from robofleet.calibration.report import Report
from robofleet.calibration.robots.believed import believed_errors
from robofleet.calibration.robots.design import NOISE, Design
from robofleet.calibration.robots.encoders import counts
from robofleet.calibration.robots.identification import Identification
from robofleet.calibration.robots.information import ENCODERS, PARAMETERS
from robofleet.calibration.robots.plots import motion_figure, residual_figure
from robofleet.calibration.robots.results import Rows, source
from robofleet.calibration.robots.shooting import Shots
from robofleet.config import slices
from robofleet.config.calibrated import RobotCalibration, TagOffset
from robofleet.config.plant_errors import PlantErrors
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.reports.pages import Marked

_ANGLES = "tag_heading_rad"
_SHOWN = {  # of a parameter: in words, its unit, by what it is multiplied, digits
    "left_radius_m": ("left wheel's radius", "mm", 1e3, 4),
    "right_radius_m": ("right wheel's radius", "mm", 1e3, 4),
    "wheel_base_m": ("wheel base", "mm", 1e3, 2),
    "motor_lag_s": ("motor lag", "ms", 1e3, 1),
    "stop_lag_s": ("motor lag of a stop", "ms", 1e3, 1),
    "delay_s": ("delay, tick to wheels", "ms", 1e3, 1),
    "deadband_rad_s": ("dead band", "rad/s", 1.0, 3),
    "breakaway_rad_s": ("breakaway", "rad/s", 1.0, 3),
    "top_speed_rad_s": ("top speed of a wheel", "rad/s", 1.0, 2),
    "top_speed_sag": ("top speed lost on an empty battery", "%", 1e2, 1),
    "slip_s_per_rad": ("slip at 1 rad/s", "%", 1e2, 2),
    "tag_forward_m": ("tag, forward", "mm", 1e3, 2),
    "tag_left_m": ("tag, to the left", "mm", 1e3, 2),
    _ANGLES: ("tag, heading", "deg", math.degrees(1.0), 3),
    "left_encoder": ("left encoder, of its wheel's angle", "%", 1e2, 3),
    "right_encoder": ("right encoder, of its wheel's angle", "%", 1e2, 3),
    "encoder_offset_s": ("encoders, later than their stamps", "ms", 1e3, 1),
}
_MISSING = {  # what a drive needs for a parameter
    "wheel_base_m": "turns", "motor_lag_s": "quick changes of speed", "delay_s": "quick changes of speed",
    "stop_lag_s": "stops", "deadband_rad_s": "wheels that slow down through it",
    "breakaway_rad_s": "slow starts from rest",
    "top_speed_rad_s": "wheels at their top speed", "top_speed_sag": "top speed at several charges of the battery",
    "slip_s_per_rad": "turns at several rates", **dict.fromkeys(ENCODERS, "encoders"),
}  # fmt: skip
_LEAST_SLIP = 1e-3  # less is none: its noise says nothing [s/rad]


def with_identified(
    config: Config, robot: Robot, before: RobotCalibration, found: Identification, recordings: Sequence[Shots],
    inputs: dict[str, bytes],
) -> RobotCalibration:  # fmt: skip
    """Return a robot's file with what was told; what was not told stays as it was."""
    w, nominal, errors = found.wheels, slices.vehicle_drive(robot.vehicle), believed_errors(robot)
    determined, sigma = set(found.determined), found.sigma
    radius = (w.left_radius_m + w.right_radius_m) / 2.0
    update: dict[str, object] = {"robot": robot.id}
    if {"left_radius_m", "right_radius_m"} <= determined:
        update["wheel_radius_m"] = round(radius, 7)
    if "wheel_base_m" in determined:
        update["wheel_base_m"] = round(w.wheel_base_m, 7)
    if "delay_s" in determined:
        update["delay_s"] = round(max(0.0, w.delay_s), 6)
    if "motor_lag_s" in determined:
        update["motor_lag_s"] = round(w.motor_lag_s, 6)
    if {"tag_forward_m", "tag_left_m", _ANGLES} <= determined:
        update["tag_offset"] = TagOffset(
            forward_m=round(w.tag_forward_m, 7), left_m=round(w.tag_left_m, 7),
            heading_deg=round(math.degrees(math.remainder(w.tag_heading_rad, math.tau)), 4),
        )  # fmt: skip
    count = counts(np.concatenate([shots.drive.encoders_rad for shots in recordings]))
    slip = max(0.0, w.slip_s_per_rad)
    slip_noise = found.noise.slip / (slip * math.sqrt(errors.loop_period_s)) if slip > _LEAST_SLIP else 0.0
    update["simulated"] = PlantErrors(
        motor_lag_s=round(w.motor_lag_s, 6),
        stop_lag_s=round(w.stop_lag_s, 6),
        speed_quantum_rad_s=round(count / errors.loop_period_s, 6) if count else errors.speed_quantum_rad_s,
        loop_period_s=errors.loop_period_s,
        deadband_rad_s=round(w.deadband_rad_s, 4),
        breakaway_rad_s=round(max(w.deadband_rad_s, w.breakaway_rad_s), 4),
        actuation_delay_s=round(max(0.0, w.delay_s - config.lockstep.bus_delay_s), 6),
        wheel_gain_error=round(radius / nominal.wheel_radius - 1.0, 6),
        wheel_gain_difference=round((w.right_radius_m - w.left_radius_m) / nominal.wheel_radius, 6),
        wheel_base_error=round(w.wheel_base_m / nominal.wheel_base - 1.0, 6),
        top_speed_error=round(w.top_speed_rad_s / nominal.max_wheel_speed - 1.0, 6),
        wheel_gain_spread=0.0,
        wheel_base_spread=0.0,
        slip_s_per_rad=round(slip, 6),
        slip_noise=round(min(10.0, slip_noise), 4),
        top_speed_sag=round(min(1.0, max(0.0, w.top_speed_sag)), 4),
        battery_life_s=errors.battery_life_s,
    )
    n = found.noise
    figures: dict[str, float | None] = {f"sigma_{name}": sigma[name] for name in found.determined}
    figures |= {
        "residual_correlation": found.correlation,
        "held_out_chi_square": found.held_out_chi_square,
        **{f"held_out_{e.horizon_s:g}s_mm": e.position_rms_mm for e in found.held_out if e.count},
        **dict(zip(NOISE, (*recordings[-1].pose_noise(n), n.slip, n.way, 1e3 * n.stamp_s, n.wander), strict=True)),
    }
    update["identified"] = source("identify", inputs, found, figures, PARAMETERS, found.covariance)
    return before.model_copy(update=update)


def _value(name: str, value: float) -> str:
    _, _, scale, digits = _SHOWN[name]
    return f"{scale * value:.{digits}f}"


def table(found: Sequence[Identification]) -> Rows:
    """Return the robots' parameters with two standard deviations; ``-``: not told."""
    head = ("", *(each.robot for each in found))
    rows = []
    for name in PARAMETERS:
        label, unit, _, _ = _SHOWN[name]
        cells = [
            f"{_value(name, getattr(each.wheels, name))} ± {_value(name, 2.0 * each.sigma[name])}"
            if name in each.determined
            else "-"
            for each in found
        ]
        rows.append((f"{label} [{unit}]", *cells))
    return head, rows


def expectation_table(designs: Sequence[Design]) -> Rows:
    """Return the standard deviations of the robots' parameters: now, and as a drive will leave them."""
    rows = []
    for k, name in enumerate(PARAMETERS):
        label, unit, scale, _ = _SHOWN[name]
        cells = [f"{scale * each.before[k]:.2g} > {scale * each.expected[k]:.2g}" for each in designs]
        rows.append((f"{label} [{unit}]", *cells))
    return ("standard deviation, now > then", *(each.robot for each in designs)), rows


def untold_line(found: Identification) -> str | None:
    """Return what the drive does not tell of a robot, and what would; None: it tells everything."""
    if not found.undetermined:
        return None
    parts = [
        f"{_SHOWN[name][0]}{f' (needs {_MISSING[name]})' if name in _MISSING else ''}" for name in found.undetermined
    ]
    return f"{found.robot}: this drive does not tell: {', '.join(parts)}; left as configured"


def page(
    found: Sequence[Identification], recordings: Sequence[Sequence[Shots]], latency: Sequence[Sequence[str]]
) -> Report:
    """Return the page of ``robofleet identify``."""
    report = Report("What the recordings say about the robots")
    white = all(abs(each.correlation) < 0.2 and 0.5 < each.held_out_chi_square < 2.0 for each in found)
    report.verdict(
        "The models predict what they were not fitted to." if white else
        "The models predict the held-out part worse than the fitted one: read the residuals.", good=white,
    )  # fmt: skip
    report.table(*table(found))
    report.table(
        ("robot", "mean square of residuals", "the same, held out", "correlation with the next", *(
            f"error after {e.horizon_s:g} s, mm (before)" for e in found[0].held_out), "outliers", "not explained"),
        [
            (each.robot, each.chi_square, each.held_out_chi_square, f"{each.correlation:.3f}",
             *(f"{e.position_rms_mm:.3g} ({e.believed_rms_mm:.3g})" if e.count else None for e in each.held_out),
             f"{each.left_out} of {each.poses}", each.misfits)
            for each in found
        ],
    )  # fmt: skip
    report.note(
        "A residual is what the model and all poses before leave of a measured pose, divided by its standard "
        "deviation: its mean square is 1, and it does not depend on the one before. The errors are those of open-loop "
        "predictions by the commands alone (before: by what was believed before), on every fifth piece of two seconds, "
        "which took no part in the fit; they contain the noise of one measured pose."
    )
    report.section("Camera", "")
    report.table(("camera", "exposure to message, median", "99 % below"), [tuple(row) for row in latency])
    for each, shots in zip(found, recordings, strict=True):
        report.section(each.robot, untold_line(each) or "The recordings tell every parameter.")
        rows = []
        for name in PARAMETERS:
            label, unit, _, _ = _SHOWN[name]
            value, sigma, before = getattr(each.wheels, name), each.sigma[name], getattr(each.prior.values, name)
            determined = name in each.determined
            interval = (
                f"{_value(name, value - 2.0 * sigma)} to {_value(name, value + 2.0 * sigma)}" if determined else "-"
            )
            rows.append(
                (
                    f"{label} [{unit}]",
                    _value(name, value) if determined else "-",
                    interval,
                    _value(name, before),
                    Marked("told" if determined else "not told", determined),
                )
            )
        report.table(("parameter", "found", "95 %", "believed before", ""), rows)
        count = counts(np.concatenate([each_shots.drive.encoders_rad for each_shots in shots]))
        encoders = (
            f" The encoders' residuals have a mean square of {each.encoder_chi_square:.2f} and a correlation of "
            f"{each.encoder_correlation:.3f}{f'; they count in steps of {1e3 * count:.2f} mrad' if count else ''}."
            if math.isfinite(each.encoder_chi_square)
            else ""
        )
        report.note(
            f"Poses scatter {each.noise.position:.2f} times as far as their covariances say, headings "
            f"{each.noise.heading:.2f} times. Each wheel's way wanders by {1e3 * each.noise.way:.2f} mm in 1 m, and by "
            f"{1e3 * each.noise.slip:.2f} mm in a second at 1 m/s and 1 rad/s.{encoders} Told least: "
            f"{' with '.join(_SHOWN[name][0] for name in each.weakest)}."
        )
        report.figure(motion_figure(each, shots[0]), "Observed and predicted: six seconds of the recording.")
        report.figure(residual_figure(each, shots[0]), "Residuals in standard deviations, and their autocorrelation.")
    return report
