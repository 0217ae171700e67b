"""The platoon with robots that are learned from a recording of other driving.

A robot is a unicycle of its nominal wheels, and what it does beyond: its speed ahead, its slip to the side and its yaw
rate, affine in what it is asked for. These are learned from estimated poses and commands alone, and the flow's
prediction has them: x + T (u + w), w being what the learned robot adds to u.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from robofleet.behaviours.interface import Decision, Situation, Team
from robofleet.behaviours.platoon import Platoon
from robofleet.config import slices
from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.control.flow import Plant
from robofleet.control.learned import Polynomial, Samples, learned_plant
from robofleet.core.arrays import Array
from robofleet.experiments.results import Cell, Table
from robofleet.recording.run import Run
from robofleet.runs.lockstep import Lockstep

_SETTLED_S = 3.0  # of a recording: before it the filter and the robots start
Row = Annotated[tuple[float, float, float], Field(strict=False)]  # at rest, and by v and omega that are asked for
Beyond = Annotated[tuple[Row, Row, Row], Field(strict=False)]  # of the speed ahead, to the left, and of the yaw rate


class LearnedPlatoon(Platoon):
    """The platoon, whose robots do more than they are asked for."""

    class Settings(Platoon.Settings):
        """Those of the platoon, and what each robot does beyond, in the group's order."""

        beyond: tuple[Beyond, ...] = Field(strict=False)

    def __init__(self, settings: Settings, team: Team) -> None:
        super().__init__(settings, team)
        self._beyond, self._u = np.array(settings.beyond), np.zeros((len(team), 2))

    def decide(self, now: Situation) -> Decision:
        """Return Algorithm 1's inputs, with what the robots do beyond the newest ones as disturbance."""
        c, s, l = np.cos(now.poses[:, 2]), np.sin(now.poses[:, 2]), self.team.point_ahead
        v, omega = c * self._u[:, 0] + s * self._u[:, 1], (c * self._u[:, 1] - s * self._u[:, 0]) / l
        more = np.einsum("nij,jn->in", self._beyond, np.stack([np.ones_like(v), v, omega]))
        left = more[1] + l * more[2]
        w = np.column_stack([c * more[0] - s * left, s * more[0] + c * left])
        return super().decide(replace(now, disturbance=w * (np.abs(self._u).max(axis=1) > 0.0)[:, None]))

    def restart(self) -> None:
        super().restart()
        self._u[:] = 0.0

    def changed(self, velocities: Array) -> None:
        super().changed(velocities)
        self._u[:] = velocities


def _slope(x: Array, u: Array) -> Array:
    return np.array([u[0] * math.cos(x[2]), u[0] * math.sin(x[2]), u[1]])


UNICYCLE = Plant(_slope, lambda x: x[:2].copy(), 3, 2)


def learned_robots(run: Run) -> list[list[list[float]]]:
    """Return what each robot of a recording does beyond what it is asked for, as ``beyond`` of the settings."""
    counted, found = run.t > _SETTLED_S, []
    estimated = np.stack([run.items[name] for name in ("x_m", "y_m", "psi_rad")], axis=-1)
    commands = np.stack([run.items[name] for name in ("left_rad_s", "right_rad_s")], axis=-1)
    for i, robot in enumerate(run.config.members):
        drive, h = slices.drive(robot), run.config.controller.tick_s
        wheels = _lagged(commands[:, i], drive.motor_lag, h, slices.delay_ns(run.config, robot) / 1e9)
        requested = np.column_stack([
            drive.wheel_radius * wheels.sum(axis=1) / 2.0,
            drive.wheel_radius / drive.wheel_base * (wheels[:, 1] - wheels[:, 0]),
        ])  # fmt: skip
        pose = estimated[:, i]
        moved, c, s = np.diff(pose, axis=0), np.cos(pose[:-1, 2]), np.sin(pose[:-1, 2])
        turned = np.remainder(moved[:, 2] + np.pi, 2.0 * np.pi) - np.pi
        after = np.column_stack([c * moved[:, 0] + s * moved[:, 1], c * moved[:, 1] - s * moved[:, 0], turned])
        use = counted[:-1] & counted[1:]
        samples = Samples(np.zeros((int(use.sum()), 3)), requested[:-1][use], after[use], h)
        plant = learned_plant(UNICYCLE, samples, (), (0, 1, 2), Polynomial(1)).plant
        known, x = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.zeros(3)
        rest = plant.f(x, np.zeros(2))
        by_input = [plant.f(x, np.eye(2)[k]) - rest for k in range(2)]
        found.append((np.column_stack([rest, *by_input]) - known).tolist())
    return found


def _lagged(commands: Array, lag: float, h: float, delay: float) -> Array:
    """Return the mean speeds (K, 2) of wheels in each tick, which follow their commands (K, 2) with lag and delay."""
    means, speed = np.empty_like(commands), commands[0].copy()
    for k in range(len(commands)):
        total = np.zeros(2)
        for command, duration in ((commands[max(k - 1, 0)], delay), (commands[k], h - delay)):
            decay, ahead = math.exp(-duration / lag) if lag > 0.0 else 0.0, speed - command
            total += command * duration + ahead * (1.0 - decay) * lag
            speed = command + ahead * decay
        means[k] = total / h
    return means


def driven_platoon(name: str, seed: int, changes: Mapping[str, Any]) -> Run:
    """Drive a shipped configuration in lockstep, with poses in the pixels' place; ``changes`` of its first group."""
    tree = load_config(SHIPPED / f"{name}.yaml", ["tracker.source=truth", f"run.seed={seed}", "run.bounds={}"])
    group = tree.groups[0]
    settings = {**group.settings, **changes.get("settings", {})}
    changed = group.model_copy(update={**changes, "settings": settings})
    config = tree.model_copy(update={"groups": (changed, *tree.groups[1:])})
    lockstep = Lockstep(config)
    outcome, cause = lockstep.run()
    if outcome != "completed":
        raise RuntimeError(f"{name} ended: {cause}")
    return Run(lockstep.recording)


def learned_table(recorded: str, seed: int) -> tuple[Table, dict[str, float]]:
    """Return the platoon's figures with nominal robots, and with those learned from another recording."""
    recording = driven_platoon(recorded, seed, {})
    beyond = learned_robots(recording)
    runs = {
        "nominal": driven_platoon("platoon", seed, {}),
        "learned": driven_platoon(
            "platoon", seed, {"behaviour": f"{__name__}:LearnedPlatoon", "settings": {"beyond": beyond}}
        ),
    }
    figures = {kind: _figures(run) for kind, run in runs.items()}
    rows: list[tuple[Cell, ...]] = [
        (what, *(figures[kind][what] for kind in runs)) for what in next(iter(figures.values()))
    ]
    notes = (f"robots learned from configs/{recorded}.yaml: estimated poses and commands",)
    columns, formats = ("mean of four robots, mm", *runs), ("", ".2f", ".2f")
    table = Table("The platoon with robots that are learned", columns, tuple(rows), notes, formats)
    return table, {kind: each["control error"] for kind, each in figures.items()}


def _figures(run: Run) -> dict[str, float]:
    late, ahead = run.t > _SETTLED_S, round(run.config.controller.horizon_s / run.config.controller.tick_s)
    (group,) = run.group_figures
    off = np.linalg.norm(run.points()[ahead:] - run.references[:-ahead], axis=2)[late[:-ahead]]
    return {
        "control error": 1e3 * float(np.nanmean(group.figures["control_error"][late])),
        "from the reference, when it is due": 1e3 * float(np.nanmean(off)),
    }
