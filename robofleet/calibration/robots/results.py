"""A robot's calibration file, and the pages about its measurement."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from robofleet.calibration.report import Report
from robofleet.calibration.robots import latency, offsets
from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.robots.heights import TagHeight
from robofleet.calibration.robots.latency import Latency
from robofleet.calibration.robots.offsets import Offsets
from robofleet.calibration.store import CalibrationError, load, provenance
from robofleet.config.calibrated import RobotCalibration, TagOffset
from robofleet.config.robots import Vehicle
from robofleet.core.figures import COLOURS, QUIET, STYLE
from robofleet.tracking.offset import centre_from_tag
from robofleet.vehicles.differential_drive import DifferentialDrive

Rows = tuple[tuple[str, ...], list[tuple[str, ...]]]  # a table: its head, and its rows

_SHOWN_TURNS_S = 4.0


def file_of(config: Path, robot: str) -> Path:
    """Return where a robot's calibration stands: beside the configuration, where its bare name finds it."""
    return config.parent / "robots" / f"{robot}.yaml"


def earlier(file: Path, robot: str) -> RobotCalibration:
    """Return what the file says so far, of which a new calibration keeps a part.

    Raises:
        CalibrationError: the file holds something else, or another robot's calibration.
    """
    if not file.exists():
        return RobotCalibration(robot=robot)
    found = load(file, RobotCalibration)
    if found.robot != robot:
        raise CalibrationError(f"{file}: was measured on '{found.robot}', not on '{robot}': move it away")
    return found


def with_offsets(before: RobotCalibration, found: Offsets, height: TagHeight, recording: bytes) -> RobotCalibration:
    o, sigma = found.tag_offset, found.sigma.tolist()
    offset = TagOffset(forward_m=round(o.forward_m, 7), left_m=round(o.left_m, 7), heading_deg=round(o.heading_deg, 4))
    wheels = {"wheel_radius_m": round(found.wheel_radius_m, 7), "wheel_base_m": round(found.wheel_base_m, 7)}
    figures = {
        "sigma_forward_mm": 1e3 * sigma[0],
        "sigma_left_mm": 1e3 * sigma[1],
        "sigma_heading_deg": sigma[2],
        "residual_rms_mm": float(np.sqrt((found.residuals_mm**2).mean())),
        "left_out_poses": float(found.left_out),
    }
    if height.higher is not None:
        figures |= {"tag_higher_mm": 1e3 * height.higher[0], "sigma_tag_higher_mm": 1e3 * height.higher[1]}
    measured = {} if height.measured_m is None else {"tag_height_m": round(height.measured_m, 5)}
    covariance = found.covariance.tolist()
    source = provenance("offsets", {"drive.npz": recording}, figures, offsets.PARAMETERS, covariance)
    return before.model_copy(
        update={"robot": found.robot, "tag_offset": offset, **wheels, **measured, "offsets": source}
    )


def with_latency(before: RobotCalibration, found: Latency, recording: bytes) -> RobotCalibration:
    sigma, late = found.sigma.tolist(), {"delay_s": round(found.delay_s, 6), "motor_lag_s": round(found.motor_lag_s, 6)}
    figures = {
        "sigma_delay_ms": 1e3 * sigma[0],
        "sigma_motor_lag_ms": 1e3 * sigma[1],
        "residual_rms_rad_s": float(np.sqrt(((found.turn_rad_s - found.modelled_rad_s) ** 2).mean())),
        "left_out_poses": float(found.left_out),
    }
    covariance = found.covariance.tolist()
    source = provenance("latency", {"drive.npz": recording}, figures, latency.PARAMETERS, covariance)
    return before.model_copy(update={"robot": found.robot, **late, "latency": source})


def offsets_table(found: Sequence[Offsets]) -> Rows:
    head = ("robot", "tag forward mm", "tag left mm", "tag heading deg", "wheel radius mm", "wheel base mm", "by")
    scales, digits = (1e3, 1e3, 1.0, 1e3, 1e3), (3, 3, 3, 4, 2)
    rows = []
    for robot_offsets in found:
        numbers = zip(robot_offsets.values, robot_offsets.sigma, scales, digits, strict=True)
        cells = [f"{scale * value:.{n}f} ± {scale * sigma:.{n}f}" for value, sigma, scale, n in numbers]
        rows.append((robot_offsets.robot, *cells, "encoders" if robot_offsets.by_encoders else "commands"))
    return head, rows


def latency_table(found: Sequence[Latency]) -> Rows:
    rows = []
    for robot_latency in found:
        numbers = zip((robot_latency.delay_s, robot_latency.motor_lag_s), robot_latency.sigma, strict=True)
        rows.append((robot_latency.robot, *(f"{1e3 * value:.2f} ± {1e3 * sigma:.2f}" for value, sigma in numbers)))
    return ("robot", "delay ms", "motor lag ms"), rows


def offsets_page(
    found: Sequence[Offsets], heights: Sequence[TagHeight], drives: Sequence[RobotDrive], vehicles: Sequence[Vehicle]
) -> Report:
    page = Report("Where the tags sit on their robots")
    page.verdict("Measured, and good enough to use.", good=True)
    page.table(*offsets_table(found))
    for robot_offsets, height, drive, vehicle in zip(found, heights, drives, vehicles, strict=True):
        about = (
            f"Its vehicle's wheel radius is {1e3 * vehicle.wheel_radius_m:g} mm, its base "
            f"{1e3 * vehicle.wheel_base_m:g} mm. {robot_offsets.left_out} of {len(drive.poses)} poses were outliers; "
            f"it was held for {drive.held_s:.1f} s, as another robot or the edge was near. "
            f"{height.sentence}."
        )
        page.section(robot_offsets.robot, about)
        page.figure(_drive_figure(robot_offsets, drive), "The drive, and what is left of each step from pose to pose.")
    return page


def latency_page(found: Sequence[Latency], believed: Sequence[tuple[float, DifferentialDrive]]) -> Report:
    """Return the page of ``robofleet calibrate latency``; ``believed``: delay [s] and drive before."""
    page = Report("How late the wheels follow")
    page.verdict("Measured, and good enough to use.", good=True)
    page.table(*latency_table(found))
    for robot_latency, (delay_s, drive) in zip(found, believed, strict=True):
        page.section(
            robot_latency.robot,
            f"Believed before: {1e3 * delay_s:.1f} ms and {1e3 * drive.motor_lag:.1f} ms. "
            f"{robot_latency.left_out} of {len(robot_latency.at_s) + 1 + robot_latency.left_out} poses were outliers.",
        )
        figure = _latency_figure(robot_latency, delay_s, drive.motor_lag)
        page.figure(figure, "A wheel's answer to a step of its command at 0; the turns of the drive, beside the fit's.")
    return page


def _drive_figure(robot_offsets: Offsets, drive: RobotDrive) -> Figure:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 3.0), layout="constrained")
        path, left = figure.subplots(1, 2, width_ratios=(1, 2))
        centres = np.array([centre_from_tag(x, y, psi, robot_offsets.tag_offset) for x, y, psi in drive.poses.tolist()])
        path.plot(drive.poses[:, 0], drive.poses[:, 1], color=QUIET, lw=0.6, label="tag")
        path.plot(centres[:, 0], centres[:, 1], color=COLOURS[0], lw=1.0, label="centre")
        path.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
        path.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
        for k, name in enumerate(("along x", "along y")):
            left.plot(robot_offsets.at_s, robot_offsets.residuals_mm[:, k], ".", ms=2, color=COLOURS[k], label=name)
        left.set(xlabel="time [s]", ylabel="residual [mm]")
        left.legend()
    return figure


def _latency_figure(found: Latency, delay_s: float, lag_s: float) -> Figure:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 3.0), layout="constrained")
        step, turns = figure.subplots(1, 2, width_ratios=(1, 2))
        t = np.linspace(0.0, found.delay_s + 5.0 * found.motor_lag_s + 0.05, 300)
        for delay, lag, colour, name in (
            (delay_s, lag_s, QUIET, "believed before"),
            (found.delay_s, found.motor_lag_s, COLOURS[0], "found"),
        ):
            answer = np.where(t >= delay, -np.expm1(-np.maximum(t - delay, 0.0) / max(lag, 1e-6)), 0.0)
            step.plot(1e3 * t, answer, color=colour, label=name)
        step.set(xlabel="after the tick [ms]", ylabel="of the commanded speed")
        step.legend()
        middle = found.at_s[int(0.8 * len(found.at_s))]
        shown = np.abs(found.at_s - middle) < _SHOWN_TURNS_S / 2
        turns.plot(found.at_s[shown], found.turn_rad_s[shown], ".", ms=3, color=COLOURS[1], label="measured")
        turns.plot(found.at_s[shown], found.modelled_rad_s[shown], color=COLOURS[0], lw=1.0, label="fit")
        turns.set(xlabel="time [s]", ylabel="rate of turning [rad/s]")
        turns.legend()
    return figure
