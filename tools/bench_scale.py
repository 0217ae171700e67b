"""The rows ``scale`` of ``bench.py``: what grows with the number of robots."""

import json
import math
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from bench_tracker import Row, percentiles
from numpy.typing import NDArray

from robofleet import Fleet
from robofleet.behaviours.platoon import Platoon
from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import CAMERA, POSES, STATE, TICK
from robofleet.bus.messages import FLEET_POSES, RUN_STATE, TICK_RECORD, FleetPoses, RobotState, RunState, TagPose
from robofleet.config.groups import starts_of
from robofleet.config.load import load_config
from robofleet.config.robots import Robot, StartPose
from robofleet.config.tree import Config, Group
from robofleet.core.clock import MS, S, SimulatedClock, processor_ns
from robofleet.nodes.controller import Controller, compile_kernels
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.supervisor import NOBODY, Phase

Array = NDArray[np.float64]

CONFIGS = Path(__file__).resolve().parents[1] / "configs"
PLATOON, SCRIPT = CONFIGS / "platoon.yaml", CONFIGS / "script.yaml"
_IN_A_PLATOON = 20
_MOST_AT_THE_ROBOTARIUM = 22  # its barrier fails beyond
_ARMED_WITHIN_S, _LASTING_S, _WARM_S = 120.0, 5.0, 1.0
_MAY_MS = {4: 0.1, 20: 0.15, 100: 0.5, 1000: 4.0}  # p99 of a tick
_SEEN_BEFORE_NS, _DELAY_NS = 10 * MS, MS
_NOISE = 3e-4, 3e-4, 4e-3  # of a pose [m, m, rad]


def rows() -> list[Row]:
    """Return the rows."""
    return [*controller_ticks(), *lockstep_seconds(), *script_seconds()]


def lockstep_seconds() -> list[Row]:
    """The CPU time of a simulated second in lockstep, while the fleet drives, medians of three.

    Beside it, where the environment's ``ROBOTARIUM`` is a checkout of it, the Robotarium's simulator with its barrier.
    """
    found: list[Row] = []
    for count, source in ((4, "camera"), (4, "truth"), (20, "truth"), (100, "truth"), (1000, "truth")):
        config = fleet(count)
        tracker = config.tracker.model_copy(update={"source": source})
        drives = _Drives(config.model_copy(update={"tracker": tracker, "robots": _placed(config)}))
        peer = os.environ.get("ROBOTARIUM") if count <= _MOST_AT_THE_ROBOTARIUM else None
        ours, theirs = [], []
        for _ in range(3):
            ours.append(drives.second_ms())
            theirs += [_robotarium_ms(Path(peer), count)] if peer else []
        found += _beside(f"a simulated second, {count} robots, {source}, CPU", ours, theirs)
    return found


def script_seconds() -> list[Row]:
    """The CPU time of a simulated second in which a script drives circles in lockstep, medians of three.

    With the barrier, without a camera and a recording; beside it the Robotarium's simulator, as above.
    """
    found: list[Row] = []
    for count in (4, 20):
        peer, ours, theirs = os.environ.get("ROBOTARIUM"), [], []
        with Fleet(SCRIPT, lockstep=True, out=False, settings=_in_rows(count)) as driven:
            _script_second_ms(driven)
            for _ in range(3):
                ours.append(_script_second_ms(driven))
                theirs += [_robotarium_ms(Path(peer), count)] if peer else []
        found += _beside(f"a simulated second of a script, {count} robots, CPU", ours, theirs)
    return found


def _beside(what: str, ours: list[float], theirs: list[float]) -> Iterator[Row]:
    """Yield the medians, that of the Robotarium where it was measured."""
    value = statistics.median(ours)
    for who, median in (("robofleet", value), *([("Robotarium", statistics.median(theirs))] if theirs else [])):
        yield {"what": what, "who": who, "value": median, "unit": "ms", "ratio": median / value}


def _in_rows(count: int) -> list[str]:
    """Return the keys of so many robots that stand as those of ``bench_robotarium.py``."""
    columns = math.ceil(math.sqrt(count * 1.6))
    robots = [
        {"id": f"r{k + 1}", "tag": k + 1, "vehicle": "gternal", "start": {
            "x_m": k % columns * 2.4 / max(1, columns - 1) - 1.2, "y_m": k // columns * 0.38 - 0.6, "heading_deg": 0}}
        for k in range(count)
    ]  # fmt: skip
    ids = [robot["id"] for robot in robots]
    return ["tracker.source=truth", f"robots={json.dumps(robots)}", f"groups.0.robots={json.dumps(ids)}"]


def _script_second_ms(driven: Fleet) -> float:
    """Return the CPU time of the script's next second, its own loop with it."""
    circles = np.tile([0.08, 0.4], (len(driven.robots), 1))
    began_ns = 0
    for t in driven.ticks(_WARM_S + _LASTING_S):
        began_ns = began_ns or (processor_ns() if t >= _WARM_S else 0)
        assert len(driven.poses)
        driven.drive(circles)
    return (processor_ns() - began_ns) / MS / _LASTING_S


class _Drives:
    """A fleet that drives in lockstep."""

    def __init__(self, config: Config) -> None:
        self._lockstep = Lockstep(config)
        self._lockstep.request(b"start")
        assert self._lockstep.advance(_ARMED_WITHIN_S, lambda: self._lockstep.status.phase is Phase.RUNNING)
        self._lockstep.advance(_LASTING_S)

    def second_ms(self) -> float:
        """Return the CPU time of the next second."""
        began_ns = processor_ns()
        self._lockstep.advance(_LASTING_S)
        assert self._lockstep.status.phase is Phase.RUNNING
        return (processor_ns() - began_ns) / MS / _LASTING_S


def _placed(config: Config) -> tuple[Robot, ...]:
    """Return the robots, each with its start."""
    starts = starts_of(config)
    poses = {name: (x, y, math.degrees(psi)) for name, (x, y, psi) in starts.items()}
    named = ("x_m", "y_m", "heading_deg")
    return tuple(
        robot.model_copy(update={"start": StartPose(**dict(zip(named, poses[robot.id], strict=True)))})
        for robot in config.robots
    )


def _robotarium_ms(checkout: Path, count: int) -> float:
    own = checkout / ".venv" / "bin" / "python"
    program = [str(own if own.exists() else sys.executable), str(Path(__file__).with_name("bench_robotarium.py"))]
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    done = subprocess.run([*program, str(count)], env=environment, capture_output=True, text=True, check=True)
    return 1000.0 * float(done.stdout.split()[-1])


def fleet(count: int) -> Config:
    """Return so many robots: the shipped platoon, or platoons of 20 side by side, each on its own copy of the path."""
    shipped = load_config(PLATOON, ["tracker.source=truth"])
    if count == len(shipped.robots):
        return shipped
    path = Platoon.Settings.model_validate(shipped.groups[0].settings).path
    width, height = shipped.arena.size_m
    platoons = math.ceil(count / _IN_A_PLATOON)
    columns = math.ceil(math.sqrt(platoons * height / width))
    rows = math.ceil(platoons / columns)
    groups = []
    for k in range(platoons):
        x, y = (k % columns - (columns - 1) / 2) * width, (k // columns - (rows - 1) / 2) * height
        knots = [
            {"at_m": [at[0] + x, at[1] + y], "derivative_m": list(along)}
            for at, along in ((q.at_m, q.derivative_m) for q in path.knots)
        ]
        ids = [f"r{i + 1}" for i in range(_IN_A_PLATOON * k, min(count, _IN_A_PLATOON * (k + 1)))]
        settings = shipped.groups[0].settings | {"path": {"knots": knots}}
        groups.append({"name": f"platoon{k + 1}", "behaviour": "platoon", "robots": ids, "settings": settings})
    template = shipped.robots[0]
    robots = [template.model_copy(update={"id": f"r{i + 1}", "tag": i + 1, "start": None}) for i in range(count)]
    arena = shipped.arena.model_copy(update={"size_m": (columns * width, rows * height)})
    made = tuple(Group.model_validate(json.loads(json.dumps(group))) for group in groups)
    return shipped.model_copy(update={"arena": arena, "robots": tuple(robots), "groups": made})


def controller_ticks() -> list[Row]:
    """A tick of the controller with filter, law, barrier and record, warm, with an image and a state to read.

    CPU time, as other processes of a shared machine would else be in the 99th percentile. Its drivers are silent: what
    they say and hear is not in these rows. The ratio is to what the tick's p99 may take.
    """
    found = []
    for count, may_ms in _MAY_MS.items():
        times = _tick_times(fleet(count), 2500 if count <= _IN_A_PLATOON else 600)
        for row in percentiles(f"controller's tick, {count} robots, CPU", {"robofleet": times}):
            found.append(row | {"ratio": row["value"] / may_ms})
    return found


def _tick_times(config: Config, ticks: int) -> list[float]:
    """Return the CPU time of each tick [ms]; robots do exactly what the tick before said, and are seen with noise."""
    compile_kernels(config)
    clock, rng = SimulatedClock(), np.random.default_rng(1)
    clock.advance_to(S)
    bus = MemoryBus(config.arena.name, clock, _DELAY_NS)
    controller = Controller(config, bus, clock, rng)
    say_poses, say_state, tick_records = bus.publisher(POSES, CAMERA), bus.publisher(STATE), bus.newest(TICK)
    period_ns, starts = round(config.controller.tick_s * S), starts_of(config)
    tags, poses = [robot.tag for robot in config.members], np.array([starts[robot.id] for robot in config.members])
    vehicle = config.members[0].vehicle
    permitted = (RobotState(1, 0, 0),) * len(poses)
    times = []
    for tick in range(1, ticks + 1):
        now_ns = S + tick * period_ns
        clock.advance_to(now_ns - 2 * _DELAY_NS)
        seen = (poses + rng.normal(0.0, _NOISE, poses.shape)).tolist()
        image = tuple(TagPose(tag, 0, 0, *pose) for tag, pose in zip(tags, seen, strict=True))
        since_ns = period_ns - _SEEN_BEFORE_NS
        say_poses(FLEET_POSES.encode(FleetPoses(1, tick, 0, S, S, tick - 1, since_ns, 0, 0, image)))
        say_state(RUN_STATE.encode(RunState(1, tick, Phase.RUNNING, 0, NOBODY, 0.0, 0, permitted)))
        clock.advance_to(now_ns)
        began_ns = processor_ns()
        controller.step(now_ns)
        times.append((processor_ns() - began_ns) / MS)
        clock.advance_to(now_ns + _DELAY_NS)
        poses = _driven(poses, tick_records.take(), vehicle.wheel_radius_m, vehicle.wheel_base_m, period_ns / S)
    return times[ticks // 5 :]


def _driven(poses: Array, record: bytes | None, radius: float, base: float, duration: float) -> Array:
    """Return where robots are that do at once what a tick's record says."""
    arrays: Any = None if record is None else TICK_RECORD.view(record)
    assert arrays is not None
    left, right = arrays[1]["left_rad_s"], arrays[1]["right_rad_s"]
    v, turn = radius * (right + left) / 2, radius * (right - left) / base * duration
    heading = poses[:, 2] + turn / 2
    way = np.column_stack([v * duration * np.cos(heading), v * duration * np.sin(heading), turn])
    return np.asarray(poses + way)
