"""A configuration in lockstep, and the run as arrays."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from robofleet.behaviours.interface import Past
from robofleet.config.load import ConfigError
from robofleet.config.tree import Config
from robofleet.recording.run import Run
from robofleet.reports.metrics import summary
from robofleet.runs.check import refusals
from robofleet.runs.lockstep import Lockstep


@dataclass(frozen=True, kw_only=True)
class LockstepRun:
    """What a run in lockstep left.

    Attributes:
        outcome: ``completed``, ``stopped`` or ``fault``.
        cause: What ended the run early. None: nothing did.
        groups: What became of each group, by its name: poses, points, references and figures at each tick.
        summary: The run's figures, as ``summary.json`` has them.
        trace_hash: Hash of all messages. It is the same for the same seed, configuration, machine and versions.
    """

    outcome: str
    cause: str | None
    groups: Mapping[str, Past]
    summary: Mapping[str, Any]
    trace_hash: str


def run_lockstep(config: Config) -> LockstepRun:
    """Drive a configuration in lockstep: arm, run for ``run.duration_s``, stop.

    Nothing is written to disk, and no time is waited for.

    Args:
        config: The configuration. All robots must be simulated.

    Returns:
        The run as arrays.

    Raises:
        ConfigError: Where ``robofleet check --lockstep`` refuses the configuration.
    """
    if complaints := refusals(config, lockstep=True):
        raise ConfigError(f"{path}: {message}" for path, message in complaints)
    lockstep = Lockstep(config)
    outcome, cause = lockstep.run()
    columns = Run(lockstep.recording)
    return LockstepRun(
        outcome=outcome,
        cause=cause,
        groups={group.name: part.past for group, part in zip(columns.groups, columns.parts, strict=True)},
        summary=summary(
            lockstep.recording, name=config.arena.name, mode="lockstep", outcome=outcome, cause=cause, run=columns
        ),
        trace_hash=lockstep.recording.trace_hash or "",
    )
