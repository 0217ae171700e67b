"""A run in lockstep and what was said in it, as a recorder hears it."""

from pathlib import Path

from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.processes.lockstep import Lockstep
from robofleet.recording.log import RunLog

PLATOON = Path(__file__).parent.parent.parent / "configs" / "platoon.yaml"
Said = list[tuple[str, bytes, int]]  # key, payload, instant [ns]


def config(*overrides: str) -> Config:
    return load_config(PLATOON, ["tracker.source=truth", "run.duration_s=2", *overrides])


def said_in(run_config: Config) -> Said:
    said: Said = []
    run = Lockstep(run_config)
    run.bus.tap(lambda message: said.append((*message, run.clock.now_ns())))
    run.run()
    return said


def write(log: RunLog, said: Said) -> None:
    for full, payload, at_ns in said:
        log.add(full, payload, at_ns)
        log.flush(at_ns)
