"""A robot's calibration file, and the pages about its measurement."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from robofleet.calibration.report import Report
from robofleet.calibration.robots import latency, offsets
from robofleet.calibration.robots.drive_file import FILE, RobotDrive
from robofleet.calibration.robots.heights import TagHeight
from robofleet.calibration.robots.identification import Identification
from robofleet.calibration.robots.latency import Latency
from robofleet.calibration.robots.offsets import Offsets
from robofleet.calibration.robots.plots import motion_figure, residual_figure
from robofleet.calibration.robots.shooting import Shots
from robofleet.calibration.store import CalibrationError, load, provenance
from robofleet.config.calibrated import Provenance, RobotCalibration, TagOffset
from robofleet.config.robots import Vehicle
from robofleet.core.arrays import Array
from robofleet.core.figures import COLOURS, QUIET, STYLE
from robofleet.tracking.offset import centre_from_tag
from robofleet.vehicles.differential_drive import DifferentialDrive

Rows = tuple[tuple[str, ...], list[tuple[str, ...]]]  # a table: its head, and its rows


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


def source(
    command: str, inputs: Mapping[str, bytes], found: Identification, figures: Mapping[str, float | None],
    parameters: Sequence[str], covariance: Array,
) -> Provenance:  # fmt: skip
    """Return where a part of a robot's file comes from; ``figures``: beside those that every fit has."""
    fit = {"chi_square": found.chi_square, "left_out_poses": float(found.left_out)}
    return provenance(command, inputs, {**figures, **fit}, parameters, covariance.tolist())


def with_offsets(before: RobotCalibration, found: Offsets, height: TagHeight, recording: bytes) -> RobotCalibration:
    o, sigma = found.tag_offset, found.sigma.tolist()
    offset = TagOffset(forward_m=round(o.forward_m, 7), left_m=round(o.left_m, 7), heading_deg=round(o.heading_deg, 4))
    radius_m, base_m = found.values[3:].tolist()
    wheels = {"wheel_radius_m": round(radius_m, 7), "wheel_base_m": round(base_m, 7)}
    figures = {"sigma_forward_mm": 1e3 * sigma[0], "sigma_left_mm": 1e3 * sigma[1], "sigma_heading_deg": sigma[2]}
    if height.higher is not None:
        figures |= {"tag_higher_mm": 1e3 * height.higher[0], "sigma_tag_higher_mm": 1e3 * height.higher[1]}
    measured = {} if height.measured_m is None else {"tag_height_m": round(height.measured_m, 5)}
    origin = source("offsets", {FILE: recording}, found.found, figures, offsets.PARAMETERS, found.covariance)
    return before.model_copy(
        update={"robot": found.robot, "tag_offset": offset, **wheels, **measured, "offsets": origin}
    )


def with_latency(before: RobotCalibration, found: Latency, recording: bytes) -> RobotCalibration:
    sigma, late = found.sigma.tolist(), {"delay_s": round(found.delay_s, 6), "motor_lag_s": round(found.motor_lag_s, 6)}
    figures = {"sigma_delay_ms": 1e3 * sigma[0], "sigma_motor_lag_ms": 1e3 * sigma[1]}
    origin = source("latency", {FILE: recording}, found.found, figures, latency.PARAMETERS, found.covariance)
    return before.model_copy(update={"robot": found.robot, **late, "latency": origin})


def offsets_table(found: Sequence[Offsets]) -> Rows:
    head = ("robot", "tag forward mm", "tag left mm", "tag heading deg", "wheel radius mm", "wheel base mm")
    scales, digits = (1e3, 1e3, 1.0, 1e3, 1e3), (3, 3, 3, 4, 2)
    return head, [(each.robot, *_cells(each.values, each.sigma, scales, digits)) for each in found]


def latency_table(found: Sequence[Latency]) -> Rows:
    return ("robot", "delay ms", "motor lag ms"), [
        (each.robot, *_cells((each.delay_s, each.motor_lag_s), each.sigma, (1e3, 1e3), (2, 2))) for each in found
    ]


def _cells(values: Iterable[float], sigma: Array, scales: Sequence[float], digits: Sequence[int]) -> list[str]:
    """Return values with their standard deviations, in units of people."""
    return [
        f"{scale * value:.{n}f} ± {scale * own:.{n}f}"
        for value, own, scale, n in zip(values, sigma, scales, digits, strict=True)
    ]


def offsets_page(
    found: Sequence[Offsets], heights: Sequence[TagHeight], recordings: Sequence[Shots], vehicles: Sequence[Vehicle]
) -> Report:
    page = Report("Where the tags sit on their robots")
    page.verdict("Measured, and good enough to use.", good=True)
    page.table(*offsets_table(found))
    for robot_offsets, height, shots, vehicle in zip(found, heights, recordings, vehicles, strict=True):
        about = (
            f"Its vehicle's wheel radius is {1e3 * vehicle.wheel_radius_m:g} mm, its base "
            f"{1e3 * vehicle.wheel_base_m:g} mm. {robot_offsets.found.left_out} of {robot_offsets.found.poses} poses "
            f"were outliers; it was held for {shots.drive.held_s:.1f} s, as another robot or the edge was near. "
            f"{height.sentence}."
        )
        page.section(robot_offsets.robot, about)
        page.figure(_path_figure(robot_offsets, shots.drive), "The drive.")
        page.figure(residual_figure(robot_offsets.found, shots), "What is left of each pose, and its autocorrelation.")
    return page


def latency_page(
    found: Sequence[Latency], recordings: Sequence[Shots], believed: Sequence[tuple[float, DifferentialDrive]]
) -> Report:
    """Return the page of ``robofleet calibrate latency``; ``believed``: delay [s] and drive before."""
    page = Report("How late the wheels follow")
    page.verdict("Measured, and good enough to use.", good=True)
    page.table(*latency_table(found))
    for robot_latency, shots, (delay_s, drive) in zip(found, recordings, believed, strict=True):
        page.section(
            robot_latency.robot,
            f"Believed before: {1e3 * delay_s:.1f} ms and {1e3 * drive.motor_lag:.1f} ms. "
            f"{robot_latency.found.left_out} of {robot_latency.found.poses} poses were outliers.",
        )
        page.figure(
            _step_figure(robot_latency, delay_s, drive.motor_lag), "A wheel's answer to a step of its command at 0."
        )
        page.figure(motion_figure(robot_latency.found, shots), "Some seconds of the drive, observed and predicted.")
    return page


def _path_figure(robot_offsets: Offsets, drive: RobotDrive) -> Figure:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.0, 3.0), layout="constrained")
        path = figure.subplots()
        centres = np.array([centre_from_tag(x, y, psi, robot_offsets.tag_offset) for x, y, psi in drive.poses.tolist()])
        path.plot(drive.poses[:, 0], drive.poses[:, 1], color=QUIET, lw=0.6, label="tag")
        path.plot(centres[:, 0], centres[:, 1], color=COLOURS[0], lw=1.0, label="centre")
        path.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
        path.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2)
    return figure


def _step_figure(found: Latency, delay_s: float, lag_s: float) -> Figure:
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(4.0, 2.6), layout="constrained")
        step = figure.subplots()
        t = np.linspace(0.0, found.delay_s + 5.0 * found.motor_lag_s + 0.05, 300)
        for delay, lag, colour, name in (
            (delay_s, lag_s, QUIET, "believed before"),
            (found.delay_s, found.motor_lag_s, COLOURS[0], "found"),
        ):
            answer = np.where(t >= delay, -np.expm1(-np.maximum(t - delay, 0.0) / max(lag, 1e-6)), 0.0)
            step.plot(1e3 * t, answer, color=colour, label=name)
        step.set(xlabel="after the tick [ms]", ylabel="of the commanded speed")
        step.legend()
    return figure
