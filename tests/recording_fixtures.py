"""Hand-made recordings: robots whose true motion, images and commands are known to the last digit."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path as File
from typing import Any

import numpy as np
import pytest

from robofleet.behaviours import described
from robofleet.behaviours.paths import PathFile
from robofleet.bus.keys import CAMERA, POSES, STATE, STATUS, TICK, TRUTH, key
from robofleet.bus.messages import (
    FLEET_POSES,
    RUN_STATE,
    TICK_RECORD,
    FleetPoses,
    RobotState,
    RobotTick,
    RunState,
    TagPose,
    TickRecord,
)
from robofleet.config import groups
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.control.path import Path
from robofleet.core.clock import MS, S
from robofleet.recording.log import FILE, RunLog
from robofleet.recording.run import Recording
from robofleet.reports.metrics import summary
from robofleet.safety.latches import GateStatus
from robofleet.safety.supervisor import NOBODY, Event, Phase
from tests.bus.alone import ROBOT_STATUS, RobotStatus, Truth
from tests.bus.alone import TRUTH as TRUTH_LAYOUT
from tests.recording import recorded
from tests.shipped import PLATOON

TICK_NS = 33 * MS
START_NS = 1000 * S


@dataclass
class Story:
    """What happens in a hand-made run; (K, N) over ticks and robots. Points p move exactly as the path asks."""

    config: Config
    ticks: int
    run_messages: described.Group = field(init=False)
    path: Path = field(init=False)
    points: np.ndarray = field(init=False)  # (K, N, 2) [m]
    psi: np.ndarray = field(init=False)  # (K, N) [rad]
    estimate_off: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of the filter: x, y [m], psi [rad]
    control_error: np.ndarray = field(init=False)  # (K, N) [m]
    _written: np.ndarray = field(init=False)  # the centres, while they are written down
    before: int = 5  # ticks before the run
    origin: float = 0.0  # the leader's parameter at the start

    def __post_init__(self) -> None:
        (self.group,) = groups.descriptions(self.config)
        self.path = PathFile.model_validate(self.settings["path"]).path()
        self.place(np.zeros(len(self.config.members)))
        self.control_error = np.zeros((self.ticks, len(self.config.members)))

    @property
    def settings(self) -> dict[str, Any]:
        return self.config.groups[0].settings

    @property
    def t(self) -> np.ndarray:
        return np.arange(self.ticks) * self.config.controller.tick_s

    @property
    def centres(self) -> np.ndarray:
        heading = np.stack([np.cos(self.psi), np.sin(self.psi)], axis=-1)
        return np.asarray(self.points - self.config.controller.point_ahead_m * heading)

    def place(self, behind: Sequence[float] | np.ndarray) -> None:
        """Put every robot's point on the path, so many metres behind where it should be now."""
        path = self.path
        sigma = self.origin + self.settings["path_rate"] * self.t
        sigma = path.back(sigma % path.sides, behind[0]) if behind[0] else sigma
        columns = [sigma % path.sides]
        for late in behind[1:]:
            columns.append(path.back(columns[-1], self.settings["spacing_m"] + late))
        sigmas = np.stack(columns, axis=1)
        tangent = path.tangent(sigmas)
        self.points = path.position(sigmas)
        self.psi = np.arctan2(tangent[..., 1], tangent[..., 0])

    def aside(self, metres: float) -> None:
        """Move every point to the left of the path."""
        self.points = self.points + metres * np.stack([-np.sin(self.psi), np.cos(self.psi)], axis=-1)

    def recording(self, *, truth: bool = True) -> Recording:
        """Return the messages of this run: the ticks, and the truth at every tick."""
        recording, arena = Recording(self.config), self.config.arena.name
        self._written = self.centres
        for k in range(-self.before, self.ticks):
            recording.add(key(arena, TICK), TICK_RECORD.encode(self._tick(k)))
            for row, robot in enumerate(self.config.members) if truth else ():
                at = max(k, 0)
                pose = *self._written[at, row], math.remainder(self.psi[at, row], math.tau)
                message = Truth(1, self.stamp(k), *pose, 0.0, 0.0)
                recording.add(key(arena, TRUTH, robot.id), TRUTH_LAYOUT.encode(message))
        return recording

    def stamp(self, k: float) -> int:
        """Return the instant of a tick of the run [ns]."""
        return START_NS + round(k * TICK_NS)

    def _reference(self, k: int) -> float:
        """Return the leader's parameter a horizon after a tick's commands act: from ``origin`` on the lap."""
        c = self.config.controller
        ahead_s = k * c.tick_s + c.horizon_s + c.command_delay_s
        return float((self.origin + self.settings["path_rate"] * ahead_s) % self.path.sides)

    def _tick(self, k: int) -> TickRecord:
        at, items, numbers = max(k, 0), [], []
        for row in range(len(self.config.members)):
            off = np.array(self.estimate_off)
            x, y, psi = np.array([*self._written[at, row], self.psi[at, row]]) + off
            point = x + 0.08 * math.cos(psi), y + 0.08 * math.sin(psi)
            error = self.control_error[at, row] if k >= 0 else 9.0
            pose = x, y, math.remainder(psi, math.tau)
            saturated = float(row == 0 and k == 1)
            items.append(RobotTick(*pose, *point, 0, 0, 0, 0, saturated, 1, 0, 0, 0, 0))
            numbers += self._numbers(error, self._reference(at))
        phase, run_tick = (Phase.RUNNING, k) if k >= 0 else (Phase.ARMED, -1)
        exposure_ns = self.stamp(k) - 18 * MS
        overruns, lateness_ns = max(k, 0) // 10 + 7, 1000 * (k + 10)
        head = 1, 1, k + 10, run_tick, self.stamp(k), 1, 1, exposure_ns, 1, 1, 0, phase, 0, overruns, lateness_ns
        return TickRecord(*head, 50_000, tuple(items), tuple(numbers))

    def _numbers(self, error: float, reference: float) -> list[float]:
        """Return what a robot's behaviour told: no reference's place, and two of its figures."""
        figures = {"control_error": error, "reference_parameter": reference}
        return [math.nan, math.nan, *(figures.get(figure.name, math.nan) for figure in self.group.figures)]


@pytest.fixture
def story() -> Callable[..., Story]:
    """Return a run of ten seconds of the shipped platoon."""

    def make(*overrides: str, ticks: int = 300) -> Story:
        return Story(load_config(PLATOON, ["drivers.robots_per_process=1", *overrides]), ticks)

    return make


@pytest.fixture
def figures() -> Callable[[Recording], dict[str, Any]]:
    def make(recording: Recording) -> dict[str, Any]:
        return summary(recording, name="story", mode="lockstep", outcome="completed", cause=None)

    return make


@pytest.fixture
def add_status() -> Callable[..., None]:
    """Return what adds a robot's status to a recording."""

    def add(
        recording: Recording, robot: str, stamp_ns: int, *, applied: tuple[int, int] = (0, 0),
        gate: GateStatus = GateStatus.OPEN, rejected: int = 0, after_ms: tuple[float, float] = (-1, -1),
        output: float = 0.0,
    ) -> None:  # fmt: skip
        after = (round(ms * MS) for ms in after_ms)
        wheels = 0.0, 0.0, 0.0, 0.0, output, output
        message = RobotStatus(
            1, 1, 1, 1, 1, 1, stamp_ns, *applied, rejected, gate, 0, 0, 0, 0, *after, *wheels, 0.0, 0.0, 1.0
        )
        recording.add(key(recording.config.arena.name, STATUS, robot), ROBOT_STATUS.encode(message))

    return add


@pytest.fixture
def add_state() -> Callable[..., None]:
    """Return what adds the supervisor's word to a recording: (phase, cause, robot), and halts of single robots."""

    def add(
        recording: Recording, phase: Phase, cause: Event, robot: int = NOBODY, halts: tuple[int, ...] = (0, 0, 0, 0)
    ) -> None:
        robots = tuple(RobotState(int(phase == Phase.RUNNING and not halt), 0, halt) for halt in halts)
        message = RunState(1, 1, phase, cause, robot, 0.0, 0, robots)
        recording.add(key(recording.config.arena.name, STATE), RUN_STATE.encode(message))

    return add


@pytest.fixture
def add_image() -> Callable[..., None]:
    """Return what adds an image's poses to a recording."""

    def add(
        recording: Recording, exposure_ns: int, tags: Sequence[int], work_ns: int = 2 * MS, coasted_ns: int = 0
    ) -> None:
        poses = tuple(TagPose(tag, 0, coasted_ns, 0.0, 0.0, 0.0) for tag in tags)
        message = FleetPoses(1, 1, 1, exposure_ns, exposure_ns + 10 * MS, 1, 0, work_ns, 3, poses)
        recording.add(key(recording.config.arena.name, POSES, CAMERA), FLEET_POSES.encode(message))

    return add


@pytest.fixture(scope="session")
def run_messages() -> recorded.Messages:
    """Return what is said in a short run."""
    return recorded.said_in(recorded.config())


@pytest.fixture(scope="session")
def run_file(run_messages: recorded.Messages, tmp_path_factory: pytest.TempPathFactory) -> File:
    """Return the file of this run; it is read by many tests."""
    file = tmp_path_factory.mktemp("run") / FILE
    with RunLog(file, recorded.config()) as log:
        recorded.write(log, run_messages)
    return file
