"""``robofleet identify``: what recordings tell of each robot's model."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from robofleet.bus.keys import POSES, key
from robofleet.bus.messages import FLEET_POSES
from robofleet.calibration.commands.shared import ConfigsRobots, ReportFile, report_file, show
from robofleet.calibration.robots import believed, identified, inputs
from robofleet.calibration.robots import drive as drives
from robofleet.calibration.robots import results as robot_files
from robofleet.calibration.robots.identification import Identification
from robofleet.calibration.robots.identification import identify as fit
from robofleet.calibration.robots.shooting import Shots
from robofleet.calibration.store import CalibrationError, save
from robofleet.config.tree import Config
from robofleet.recording.reading import file_of, read
from robofleet.recording.run import Recording
from robofleet.reports.commands import readable

Runs = Annotated[list[Path], typer.Argument(metavar="RUN...", help="Folders of runs, or their run.mcap.")]
Robots = Annotated[str, typer.Option("--robots", metavar="r1,r2", help="Which robots. Default: all that were driven.")]


def identify(
    runs: Runs, robots: Robots = "", configs: ConfigsRobots = Path("configs"), report: ReportFile = None
) -> None:
    """Identify each robot's model from recordings.

    Wheels, motor lag, delay, dead band, slip, top speed and the tag's place are fitted to commands and poses. If the
    recordings do not determine a parameter, it is named and keeps its value. The result is written into
    robots/ID.yaml; the previous file is kept.

    $ robofleet identify runs/20260102T030405Z-platoon --configs configs

    $ robofleet identify runs/*-platoon --robots r1,r3
    """
    with readable():
        recordings = [read(run) for run in runs]
    chosen = _chosen(recordings, [name.strip() for name in robots.split(",") if name.strip()], runs)
    config_of = {name: next(r.config for r in recordings if name in _ids(r.config)) for name in chosen}
    shots: list[list[Shots]] = []
    found: list[Identification] = []
    faults: list[str] = []
    for name in chosen:
        try:
            own, left_out = _shots(recordings, runs, name)
            found.append(fit(own, believed.prior(config_of[name], config_of[name].robot(name))))
            shots.append(own)
            for line in left_out:
                print(line, file=sys.stderr)
        except CalibrationError as refused:
            faults += refused.faults
    if faults:
        raise CalibrationError(faults)
    sources = {file_of(run).as_posix(): file_of(run).read_bytes() for run in runs}
    files = {name: configs / "robots" / f"{name}.yaml" for name in chosen}
    after = [
        identified.with_identified(
            config_of[name], config_of[name].robot(name), robot_files.earlier(files[name], name), each, own, sources
        )
        for name, each, own in zip(chosen, found, shots, strict=True)
    ]
    page = report_file(report, "identify")
    identified.page(found, shots, _latencies(recordings)).write(page)
    show(identified.table(found))
    for line in filter(None, map(identified.untold_line, found)):
        print(line)
    print(page)
    for calibration in after:
        kept = save(files[calibration.robot], calibration)
        print(f"{files[calibration.robot]}{f', the one before is {kept}' if kept else ''}")


def _ids(config: Config) -> list[str]:
    return [robot.id for robot in config.members]


def _chosen(recordings: Sequence[Recording], names: Sequence[str], runs: Sequence[Path]) -> list[str]:
    known = list(dict.fromkeys(name for recording in recordings for name in _ids(recording.config)))
    for unknown in (name for name in names if name not in known):
        raise CalibrationError(
            f"--robots: {unknown!r} was not driven in {', '.join(map(str, runs))} ({', '.join(known)} were)"
        )
    return list(dict.fromkeys(names)) or known


def _shots(recordings: Sequence[Recording], runs: Sequence[Path], robot: str) -> tuple[list[Shots], list[str]]:
    """Return a robot's part of each recording in which it drove, and a line for each other one.

    Raises:
        CalibrationError: it drove in none of them.
    """
    shots, left_out = [], []
    for recording, run in zip(recordings, runs, strict=True):
        ids = _ids(recording.config)
        if robot not in ids:
            continue
        try:
            (drive,) = drives.extract(recording, [ids.index(robot)])
            inputs.refuse_still(drive)
        except CalibrationError as refused:
            left_out += [f"{run}: left out: {fault}" for fault in refused.faults]
            continue
        shots.append(believed.shots(recording.config.robot(robot), drive))
    if not shots:
        raise CalibrationError(line.replace(": left out", "") for line in left_out)
    return shots, left_out


def _latencies(recordings: Sequence[Recording]) -> list[list[str]]:
    """Return each camera's time from mid-exposure to its message."""
    rows = []
    for camera in dict.fromkeys(name for recording in recordings for name in recording.config.camera_names):
        heads = [
            message
            for recording in recordings
            for payload in recording.messages.get(key(recording.config.arena.name, POSES, camera), ())
            if (message := FLEET_POSES.decode_head(payload)) is not None
        ]
        late_ms = np.array([(head.sent_ns - head.exposure_ns) / 1e6 for head in heads])
        if len(late_ms):
            rows.append([camera, f"{np.median(late_ms):.1f} ms", f"{np.percentile(late_ms, 99):.1f} ms"])
    return rows
