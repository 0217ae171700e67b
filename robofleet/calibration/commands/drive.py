"""``robofleet calibrate drive``: the drive that tells most of what is uncertain of each robot."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from robofleet.calibration.commands.robots import DriveConfig, DriveRobots
from robofleet.calibration.commands.shared import Overrides, show
from robofleet.calibration.robots import drive as drives
from robofleet.calibration.robots import identified
from robofleet.calibration.robots import results as robot_files
from robofleet.calibration.robots.design import Design, design
from robofleet.config.calibrated import RobotCalibration
from robofleet.config.load import load_config, resolved_yaml
from robofleet.config.robots import Vehicle
from robofleet.config.tree import Bounds
from robofleet.core.files import write_text
from robofleet.core.refusal import new_file
from robofleet.runs import folder as folders

_SHORTEST_S, _LONGEST_S = 5.0, 600.0


def drive(
    config: DriveConfig,
    overrides: Overrides = [],  # noqa: B006 - typer copies it
    seconds: Annotated[
        float, typer.Option(min=_SHORTEST_S, max=_LONGEST_S, metavar="S", help="Driving time of each robot.")
    ] = 40.0,
    robots: DriveRobots = "",
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="File of the drive. Default: runs/<time>-drive/drive.yaml."),
    ] = None,
) -> None:
    """Propose a drive that measures each robot well.

    It chooses short manoeuvres that measure the uncertain parameters best (Fisher information), and writes them as a
    configuration to run. Nothing moves yet. In the run, the robots drive one after the other. The uncertainty now
    comes from robots/ID.yaml beside CONFIG if `robofleet identify` has written it, else from CONFIG. A table shows
    the standard deviation of each parameter now, and the predicted one after `robofleet identify`.

    $ robofleet calibrate drive configs/lab.yaml --seconds 40

    $ robofleet calibrate drive configs/lab.yaml --robots r1,r3
    """
    if out is not None:
        new_file("--out", out)
    names = [name.strip() for name in robots.split(",") if name.strip()]
    tree, count = drives.excited(load_config(config, overrides), names, config)
    behaviour = drives.excitation(tree)
    designs: list[Design] = []
    inputs: list[tuple[Vehicle, RobotCalibration | None, float]] = []
    for row, robot in enumerate(tree.members[:count]):
        known = robot_files.file_of(config, robot.id)
        calibration = robot_files.earlier(known, robot.id) if known.exists() else robot.calibration
        own = robot.vehicle, calibration, behaviour.free_line_m(row)
        if own in inputs:  # robots of one kind that nobody measured are alike
            designs.append(replace(designs[inputs.index(own)], robot=robot.id))
        else:
            known_robot = robot.model_copy(update={"calibration": calibration})
            designs.append(design(tree, known_robot, seconds, own[-1], count))
        inputs.append(own)
    tree = drives.lasting(drives.with_manoeuvres(tree, {each.robot: each.manoeuvres for each in designs}), count)
    tree = tree.model_copy(update={"run": tree.run.model_copy(update={"bounds": Bounds()})})
    file = out or folders.new("drive") / "drive.yaml"
    write_text(file, f"# Proposed by robofleet calibrate drive for {config}.\n{resolved_yaml(tree)}")
    show(identified.expectation_table(designs))
    print(f"{count} robots drive one after the other: {tree.run.duration_s:.0f} s")
    before = [calibration.identified for _, calibration, _ in inputs if calibration is not None]
    runs = dict.fromkeys(run for source in before if source is not None for run in source.inputs)
    print(f"Next: robofleet run {file}, then robofleet identify {' '.join([*runs, 'RUN'])} --configs {config.parent}")
