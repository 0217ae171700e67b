"""Runs of which one process is killed or frozen: when the wheels stood, what is left, whether the report is whole.

Nobody starts anything again: the run has to end by itself, or by Ctrl-C where it is held. Of a router that was struck
nobody hears when the wheels stood: ``kills`` without ``--config`` starts it again, and then the drivers say so.
"""

import json
import signal
from pathlib import Path
from typing import NamedTuple

import numpy as np

from robofleet.bus.bus import Inbox
from robofleet.bus.keys import STATUS
from robofleet.bus.messages import UNIT_STATUS, RobotStatus, UnitStatus
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S, WallClock
from robofleet.recording.reading import RecordingError, read
from robofleet.runs import table
from robofleet.runs.table import Process
from tests.endpoints import own_endpoint, short_folder
from tests.runs.realrun import RealRun, wait

CLOCK = WallClock()
_ENDS_WITHIN_S = 15.0  # what neither ends by itself nor is held: an operator ends it
_ENDINGS = "fault: ", "stopped: "
_FILES = "summary.json", "report.html", "metrics.csv", "config.yaml", "run.mcap"


class Struck(NamedTuple):
    """What one strike left."""

    target_ms: list[float]  # to zero targets, of robots whose wheels turned
    output_ms: list[float]
    wrong: list[str]  # what is left over, and what is missing in the report


def victims(config: Path, settings: list[str]) -> list[Process]:
    """Return the processes of a configuration's run, but for the page."""
    return [process for process in table.processes(load_config(config, settings)) if process.row is not table.PAGE]


class _Wheels:
    """What the drivers say of their robots' wheels."""

    def __init__(self, bus: ZenohBus, units: list[str]) -> None:
        self._inboxes = {unit: Inbox(bus.newest(STATUS, unit), UNIT_STATUS.decode) for unit in units}
        self._newest: dict[str, UnitStatus] = {}

    def listen(self) -> dict[tuple[str, int], tuple[int, RobotStatus]]:
        """Return the newest status of each robot with its unit's nonce."""
        for unit, inbox in self._inboxes.items():
            if (status := inbox.take()) is not None:
                self._newest[unit] = status
        return {
            (unit, row): (status.nonce, robot)
            for unit, status in self._newest.items()
            for row, robot in enumerate(status.robots)
        }


def turns(robot: RobotStatus) -> bool:
    """Return whether the gate lets anything through to a wheel."""
    return bool(robot.left_output_rad_s or robot.right_output_rad_s)


def strike(
    config: Path, settings: list[str], victim: Process, number: signal.Signals, rng: np.random.Generator
) -> Struck:
    """Kill or freeze a process of a run at a random instant, and return what that left."""
    folder, endpoint = short_folder(), own_endpoint()
    own = [*settings, f"bus.endpoint={endpoint}", f"arena.name=kills-{folder.name[3:].lower().replace('_', '-')}"]
    tree = load_config(config, own)
    run = RealRun(folder, *(word for setting in own for word in ("--set", setting)), config=config)
    try:
        run.wait_until_running()
        bus = ZenohBus(tree.arena.name, endpoint, "kills", CLOCK)
        try:
            struck = _struck(run, _Wheels(bus, list(tree.units)), victim, number, rng)
        finally:
            bus.close()
        if not wait(lambda: _over(run) or _held(run), _ENDS_WITHIN_S) or _held(run):
            run.launcher.send_signal(signal.SIGINT)
        run.ended()
        return struck._replace(wrong=[*_left(run, folder), *_missing(run, victim)])
    finally:
        run.clean_up()


def _struck(run: RealRun, wheels: _Wheels, victim: Process, number: signal.Signals, rng: np.random.Generator) -> Struck:
    run.wait_for(lambda: any(turns(robot) for _, robot in wheels.listen().values()))
    until_ns = CLOCK.now_ns() + round(rng.uniform(0.2, 2.0) * S)
    wait(lambda: not wheels.listen() or CLOCK.now_ns() >= until_ns, 5.0)
    (process,) = run.children(*victim.command)
    before = {key: nonce for key, (nonce, robot) in wheels.listen().items() if turns(robot)}
    process.send_signal(number)
    frozen_ns = CLOCK.now_ns() + round(rng.uniform(0.7, 3.0) * S)

    def stood() -> dict[tuple[str, int], RobotStatus]:
        now = wheels.listen()
        return {
            key: robot
            for key, then_ns in before.items()
            for nonce, robot in (now[key],)
            if nonce > then_ns and robot.gate != 0 and not turns(robot) and robot.output_after_ns >= 0
        }

    wait(lambda: len(stood()) == len(before) or CLOCK.now_ns() >= frozen_ns, 5.0)
    robots = stood().values()
    wait(lambda: number == signal.SIGKILL or CLOCK.now_ns() >= frozen_ns, 5.0)
    if number == signal.SIGSTOP and process.is_running():
        process.send_signal(signal.SIGCONT)
    return Struck([r.target_after_ns / MS for r in robots], [r.output_after_ns / MS for r in robots], [])


def _over(run: RealRun) -> bool:
    """Return whether it makes its report, which Ctrl-C would end, or has made it."""
    return run.launcher.poll() is not None or any(line.startswith(_ENDINGS) for line in run.said.splitlines())


def _held(run: RealRun) -> bool:
    return run.newest.startswith("held") and not _over(run)


def _left(run: RealRun, folder: Path) -> list[str]:
    """Return the processes, files and sockets that outlive a run."""
    found = (
        [] if run.nothing_is_left() else [f"process {' '.join(process.cmdline()[2:6])}" for process in run.children()]
    )
    files = (path for name in ("rt", "tmp") for path in (folder / name).rglob("*") if not path.is_dir())
    return [*found, *(f"{'socket' if path.is_socket() else 'file'} {path.relative_to(folder)}" for path in files)]


def _missing(run: RealRun, victim: Process) -> list[str]:
    """Return what a run's report lacks; of a recorder that was struck the recording may end early."""
    found = [f"no {name}" for name in _FILES if not (run.folder / name).is_file()]
    if found:
        return [*found, *run.said.splitlines()[-2:]]
    summary = json.loads((run.folder / "summary.json").read_text())
    found += [] if summary["outcome"] in ("fault", "stopped") and summary["cause"] else [f"it {summary['outcome']}"]
    found += [] if (run.folder / "report.html").read_text().rstrip().endswith("</html>") else ["half a report"]
    found += ["a traceback"] if "Traceback" in run.said else []
    try:
        recording = read(run.folder)
    except RecordingError as error:
        return [*found, str(error)]
    whole = recording.trouble is None or victim.row is table.RECORDER
    return found if whole else [*found, f"the recording {recording.trouble}"]
