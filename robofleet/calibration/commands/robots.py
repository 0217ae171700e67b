"""``robofleet calibrate offsets`` and ``latency``: what a drive tells of each robot."""

import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from robofleet.calibration.commands.shared import Overrides, report_file, show
from robofleet.calibration.robots import believed, drive_file, heights, inputs
from robofleet.calibration.robots import drive as drives
from robofleet.calibration.robots import latency as latencies
from robofleet.calibration.robots import offsets as tag_offsets
from robofleet.calibration.robots import results as robot_files
from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.robots.identification import identify
from robofleet.calibration.robots.information import Prior
from robofleet.calibration.robots.latency import Latency
from robofleet.calibration.robots.offsets import Offsets
from robofleet.calibration.robots.results import Rows
from robofleet.calibration.robots.shooting import Shots
from robofleet.calibration.store import CalibrationError, save
from robofleet.config import slices
from robofleet.config.calibrated import RobotCalibration
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.core.refusal import new_folder
from robofleet.runs.folder import DEFAULT_FOLDER

DriveConfig = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="The configuration (YAML), for example configs/platoon.yaml.")
]
DriveLockstep = Annotated[bool, typer.Option("--lockstep", help="Simulate on a simulated clock.")]
DriveRobots = Annotated[
    str, typer.Option("--robots", metavar="r1,r2", help="Which robots. Default: the robots of all groups.")
]
DriveFolder = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help=f"Folder for drive.npz and report.html. {DEFAULT_FOLDER}"),
]
DriveRecording = Annotated[
    Path | None,
    typer.Option("--recording", metavar="FILE", help="Use the drive.npz of an earlier drive; nothing moves."),
]

Own = TypeVar("Own")
Found = TypeVar("Found")


def offsets(
    config: DriveConfig,
    overrides: Overrides = [],  # noqa: B006 - typer copies it
    lockstep: DriveLockstep = False,
    robots: DriveRobots = "",
    out: DriveFolder = None,
    recording: DriveRecording = None,
) -> None:
    """Drive each robot; measure its tag's place and its wheels.

    The robots drive one after the other. It measures where the tag is, the radius of the wheels and the distance
    between them. It also measures the height of the tag; tracker.tag_side_tolerance_m limits how accurately one camera
    can do this.

    $ robofleet calibrate offsets configs/lab.yaml

    $ robofleet calibrate offsets configs/platoon.yaml --lockstep --robots r1 --set tracker.source=truth
    """
    tree, driven, folder, data = _drive("offsets", config, overrides, lockstep, robots, out, recording)
    shots = [believed.shots(tree.robot(drive.robot), drive) for drive in driven]
    priors = [believed.prior(tree, tree.robot(drive.robot)) for drive in driven]
    found = _each(zip(shots, priors, strict=True), _offsets)
    before = _each(driven, lambda drive: robot_files.earlier(robot_files.file_of(config, drive.robot), drive.robot))
    high = [heights.find(tree, drive) for drive in driven]
    after = [robot_files.with_offsets(*each, data) for each in zip(before, found, high, strict=True)]
    page = robot_files.offsets_page(found, high, shots, [tree.robot(drive.robot).vehicle for drive in driven])
    page.write(folder / "report.html")
    for height in high:
        print(height.sentence)
    _keep(config, tree, after, robot_files.offsets_table(found), folder)


def latency(
    config: DriveConfig,
    overrides: Overrides = [],  # noqa: B006 - typer copies it
    lockstep: DriveLockstep = False,
    robots: DriveRobots = "",
    out: DriveFolder = None,
    recording: DriveRecording = None,
) -> None:
    """Drive each robot; measure its delay and motor lag.

    The robots drive one after the other.

    $ robofleet calibrate latency configs/lab.yaml
    """
    tree, driven, folder, data = _drive("latency", config, overrides, lockstep, robots, out, recording)
    shots = [believed.shots(tree.robot(drive.robot), drive) for drive in driven]
    priors = [believed.prior(tree, tree.robot(drive.robot)) for drive in driven]
    found = _each(zip(shots, priors, strict=True), _latency)
    before = _each(driven, lambda drive: robot_files.earlier(robot_files.file_of(config, drive.robot), drive.robot))
    after = [robot_files.with_latency(b, f, data) for b, f in zip(before, found, strict=True)]
    known = [tree.robot(drive.robot) for drive in driven]
    before_it = [(slices.delay_ns(tree, robot) / S, slices.drive(robot)) for robot in known]
    page = robot_files.latency_page(found, shots, before_it)
    page.write(folder / "report.html")
    _keep(config, tree, after, robot_files.latency_table(found), folder)


def _offsets(part: tuple[Shots, Prior]) -> Offsets:
    shots, prior = part
    inputs.refuse_unusable(shots.drive)
    tag_offsets.refuse_unusable(shots, prior.values)
    return tag_offsets.of(identify([shots], prior))


def _latency(part: tuple[Shots, Prior]) -> Latency:
    shots, prior = part
    inputs.refuse_unusable(shots.drive)
    latencies.refuse_unusable(shots.drive)
    return latencies.of(identify([shots], prior))


def _drive(
    command: str,
    config: Path,
    overrides: Sequence[str],
    lockstep: bool,
    robots: str,
    out: Path | None,
    recording: Path | None,
) -> tuple[Config, list[RobotDrive], Path, bytes]:
    """Return the configuration, what the robots did, the folder for the page, and the recording's bytes."""
    names = [name.strip() for name in robots.split(",") if name.strip()]
    folder = out or report_file(None, command).parent
    if recording is not None:
        tree, driven = load_config(config, overrides), drive_file.chosen(recording, names)
        for unknown in (drive.robot for drive in driven if drive.robot not in {robot.id for robot in tree.robots}):
            raise CalibrationError(f"{recording}: {unknown} drove; {config} has no such robot: name its configuration")
        return tree, driven, folder, recording.read_bytes()
    tree, count = drives.configure(config, names, overrides, lockstep=lockstep)
    new_folder(folder)
    print(f"{count} robots drive one after the other: {tree.run.duration_s:.0f} s", file=sys.stderr)
    run = drives.run(tree, folder, lambda text: print(text, file=sys.stderr), lockstep=lockstep)
    driven = drives.extract(run, range(count))
    drive_file.save(folder / drive_file.FILE, driven)
    print(folder / drive_file.FILE)
    for drive in (drive for drive in driven if drive.held_s):
        print(f"{drive.robot} was held for {drive.held_s:.1f} s: another robot or the edge was near", file=sys.stderr)
    return tree, driven, folder, (folder / drive_file.FILE).read_bytes()


def _each(driven: Iterable[Own], find: Callable[[Own], Found]) -> list[Found]:
    """Return what is found for every robot; CalibrationError with all that is refused."""
    found: list[Found] = []
    faults: list[str] = []
    for drive in driven:
        try:
            found.append(find(drive))
        except CalibrationError as refused:
            faults += refused.faults
    if faults:
        raise CalibrationError(faults)
    return found


def _keep(config: Path, tree: Config, calibrations: Sequence[RobotCalibration], table: Rows, folder: Path) -> None:
    show(table)
    print(folder / "report.html")
    for calibration in calibrations:
        file = robot_files.file_of(config, calibration.robot)
        kept = save(file, calibration)
        unused = tree.robot(calibration.robot).calibration is None
        hint = f": use it with `calibration: {calibration.robot}` in {config}" if unused else ""
        print(f"{file}{f', the one before is {kept}' if kept else ''}{hint}")
