"""``python -m tests.recordings.make``: drives every scenario in lockstep and keeps what replaying it needs.

To be run when a change of what the controller does, of the messages or of the configuration is meant; look at what
``robofleet replay`` says of the old ones before.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from robofleet.bus.keys import CAMERA, POSES, STATE, TICK, key
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.recording.log import RunLog
from robofleet.recording.run import Run
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.supervisor import Phase

HERE = Path(__file__).parent
PLATOON = HERE.parents[1] / "configs" / "platoon.yaml"
_ARMED_WITHIN_S = 60.0


class Scenario(NamedTuple):
    """A short run, what is asked of its supervisor meanwhile, and how one sees that it shows what it is for."""

    keys: tuple[str, ...] = ()
    faults: str = ""
    requests: tuple[tuple[float, bytes], ...] = ((3.0, b"stop"),)  # seconds after the first start
    shows: Callable[[Run], bool] = lambda run: bool(len(run.ticks) > 80 and run.items["measured"].mean() > 0.9)


def _phases(run: Run) -> list[int]:
    """Return the run's phases one after the other."""
    phases = run.all_ticks["phase"]
    return [int(phase) for phase in phases[np.append([True], np.diff(phases) != 0)]]


def _lost_and_found(run: Run) -> bool:
    lost = run.items["lost"][:, 1]
    return bool(lost.any() and not lost[0] and not lost[-1])


def _jumped(run: Run) -> bool:
    x = run.all_ticks["items"]["x_m"][run.all_ticks["phase"] == Phase.FAULT]
    return bool((np.abs(np.diff(x, axis=0)) > 0.1).any())


def _two_controllers(run: Run) -> bool:
    return len(np.unique(run.all_ticks["epoch"])) == 2 and bool(np.diff(run.all_ticks["tick"][-20:]).all())


_ARMED, _RUNNING, _HOLD, _IDLE = Phase.ARMED, Phase.RUNNING, Phase.HOLD, Phase.IDLE
SCENARIOS = {
    "platoon": Scenario(("groups.0.robots=[r1, r2, r3]",), requests=((3.5, b"stop"),)),
    "centre": Scenario(("groups.0.settings.track=centre",)),
    "euler": Scenario(("controller.integrator=euler",)),
    "disturbed": Scenario(("controller.disturbance=estimated",), "{kind: slip, robot: r2, at_s: 1}"),
    "lost": Scenario((), "{kind: pose_dropout, robot: r2, at_s: 1, duration_s: 1.2}", shows=_lost_and_found),
    "carried": Scenario((), "{kind: id_swap, robots: [r1, r2], at_s: 1.5}", ((3.0, b"stop"),), _jumped),
    "held": Scenario(
        requests=((1.0, b"hold"), (1.8, b"resume"), (3.0, b"stop")),
        shows=lambda run: _phases(run) == [_ARMED, _RUNNING, _HOLD, _RUNNING, _IDLE],
    ),
    "restarted": Scenario(
        ("groups.0.robots=[r1]",),
        requests=((1.5, b"stop"), (2.5, b"start"), (6.5, b"stop")),
        shows=lambda run: _phases(run) == [_ARMED, _RUNNING, _IDLE, _ARMED, _RUNNING, _IDLE],
    ),
    "barrier": Scenario(
        ("groups.0.settings.spacing_m=0.215",),
        "{kind: motor_stuck, robot: r1, at_s: 1}",
        shows=lambda run: bool(run.items["filtered"].any()),
    ),
    "excitation": Scenario(("groups.0.behaviour=excitation", "groups.0.settings={}")),
    "lossy": Scenario(
        (),
        "{kind: lost, topics: [poses, state], share: 0.2}, {kind: late, topics: [poses, state]}, "
        "{kind: duplicated, topics: [poses, state], share: 0.3}",
        shows=lambda run: bool(0.3 < run.items["measured"].mean() < 0.9),
    ),
    "second-controller": Scenario(
        ("groups.0.robots=[r1]",),
        "{kind: second_controller, at_s: 1}, {kind: killed, process: controller, at_s: 2}",
        ((5.0, b"stop"),),
        _two_controllers,
    ),
}


def made(name: str) -> Lockstep:
    """Return a scenario's run, driven to its end; everything that was said is in its ``recording``."""
    scenario = SCENARIOS[name]
    run = Lockstep(_config(scenario))
    run.request(b"start")
    if not run.advance(_ARMED_WITHIN_S, lambda: run.status.phase is Phase.RUNNING):
        raise RuntimeError(f"{name}: {run.status}")
    t = 0.0
    for at_s, what in scenario.requests:
        run.advance(at_s - t)
        run.request(what)
        t = at_s
    run.advance(0.2)
    run.close()
    return run


def _config(scenario: Scenario) -> Config:
    faults = f"faults=[{scenario.faults}]"
    return load_config(PLATOON, ["tracker.source=truth", "groups.0.robots=[r1, r2]", *scenario.keys, faults])


def keep(run: Lockstep, file: Path) -> None:
    """Write the messages that a replay needs, in the order in which they were said."""
    recording = run.recording
    arena = recording.config.arena.name
    keys = key(arena, TICK), key(arena, STATE), key(arena, POSES, CAMERA)
    placed = sorted((index, full, payload) for full in keys for index, payload in recording.placed(full))
    with RunLog(file, recording.config, drawn=False) as log:
        for index, full, payload in placed:
            log.add(full, payload, index)


def main() -> None:
    """Make the recordings that are named, or all."""
    for name in sys.argv[1:] or SCENARIOS:
        run = made(name)
        if not SCENARIOS[name].shows(Run(run.recording)):
            sys.exit(f"{name} does not show what it is for: {_phases(Run(run.recording))}")
        file = HERE / f"{name}.mcap"
        file.unlink(missing_ok=True)
        keep(run, file)
        print(f"{name}: {len(Run(run.recording).all_ticks)} ticks, {file.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
