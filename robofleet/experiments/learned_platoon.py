"""The platoon with robots that are learned from a recording of other driving.

A robot is a unicycle on nominal wheels that follow their commands with a known lag, and what it does beyond: its speed
ahead, its slip to the side and its yaw rate, affine in what the wheels should give. These are learned from estimated
poses and commands alone, and the flow (eq. 14) runs on the whole plant, in the place of eq. 31.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from robofleet.behaviours.interface import Decision, Situation, Team
from robofleet.behaviours.platoon import Platoon
from robofleet.config import slices
from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.control.flow import FlowSettings, NewtonRaphsonFlow, Plant
from robofleet.control.learned import Polynomial, Samples, learned_plant
from robofleet.control.platoon import follow
from robofleet.control.prediction import compile_plant
from robofleet.control.wheels import feasible_ratio, wheels_from_body
from robofleet.core.arrays import Array
from robofleet.experiments.platoon import driven
from robofleet.experiments.results import Cell, Table
from robofleet.recording.run import Run
from robofleet.vehicles.plant import built

_STATES = 14  # of a robot's plant
_SETTLED_S = 3.0  # of a recording: before it the filter and the robots start
Row = Annotated[tuple[float, float, float], Field(strict=False)]  # at rest, and by v and omega that are asked for
Beyond = Annotated[tuple[Row, Row, Row], Field(strict=False)]  # of the speed ahead, to the left, and of the yaw rate


class LearnedPlatoon(Platoon):
    """Algorithm 1 with the flow (eq. 14) on a plant of each robot, in the place of eq. 31."""

    class Settings(Platoon.Settings):
        """Those of the platoon, and what each robot does beyond what its wheels should give, in the group's order."""

        beyond: tuple[Beyond, ...] = Field(strict=False)

    def __init__(self, settings: Settings, team: Team) -> None:
        super().__init__(settings, team)
        flow = FlowSettings(team.flow.alpha, team.flow.horizon, team.tick, team.flow.integrator)
        plants = [robot_plant(drive.motor_lag, team.point_ahead) for drive in team.drives]
        self._flows = [NewtonRaphsonFlow(plant, flow, np.zeros(2)) for plant in plants]
        self._rollouts = [compile_plant(plant).rollout for plant in plants]
        self._beyond = np.array(settings.beyond).reshape(len(team), 9)
        self._forget()

    def restart(self) -> None:
        super().restart()
        self._forget()

    def _forget(self) -> None:
        still = np.zeros((len(self.team), 5))
        self._states = np.hstack([still, self._beyond])  # when the last tick's commands began to act
        self._references = np.full(len(self.team), np.nan)  # parameters on the path
        for flow in self._flows:
            flow.applied(np.zeros(2))

    def decide(self, now: Situation) -> Decision:
        """Return v and omega of each robot, whose prediction is the next one's reference."""
        team, d, T = self.team, self.settings.spacing_m, self.team.flow.horizon
        path, none = self._path.coefficients, np.zeros(_STATES)
        velocities, references, errors, end = np.zeros((len(team), 2)), np.zeros((len(team), 2)), [], np.empty(_STATES)
        for i, (flow, rollout, drive) in enumerate(zip(self._flows, self._rollouts, team.drives, strict=True)):
            state = self._states[i]
            rollout(state, flow.u, none, team.tick, state)
            state[:3] = now.poses[i]
            if i == 0:
                self._references[0] = self.settings.path_rate * (now.t + T) % len(path)
            else:
                x, y = flow.plant.h(end)  # of the robot ahead
                _, self._references[i] = follow(path, x, y, d, math.nan, self._references[i])
            references[i] = self._path.position(self._references[i])
            u = flow.update(state, references[i]) if now.driving[i] else np.zeros(2)
            left, right = wheels_from_body(u[0], u[1], drive.wheel_radius, drive.wheel_base)
            u *= feasible_ratio(left, right, drive.wheel_radius, drive.max_wheel_speed, drive.max_speed)
            flow.applied(u)
            velocities[i] = u
            errors.append(flow.control_error)
            rollout(state, u, none, T, end)
        figures = {"control_error": np.array(errors), "reference_parameter": self._references.copy()}
        return Decision(velocities, "body", references, figures)

    def changed(self, velocities: Array) -> None:
        """Go on from what the robots are really asked for."""
        psi, l = self._states[:, 2], self.team.point_ahead
        for flow, u, c, s in zip(self._flows, velocities, np.cos(psi), np.sin(psi), strict=True):
            flow.applied([c * u[0] + s * u[1], (c * u[1] - s * u[0]) / l])

    def by_point_flow(self) -> bool:
        return False


def robot_plant(lag: float, ahead: float) -> Plant:
    """Return any robot with a motor ``lag`` [s] as a plant, whose output is the point ``ahead`` [m] of its axle.

    State (14,): x, y [m], psi [rad] of the centre; v [m/s], omega [rad/s] that the wheels should give; what the robot
    does beyond, constant: as states, one compiled plant is that of all robots. Input (2,): v, omega that are asked for.
    """

    def f(x: Array, u: Array) -> Array:
        c, s, v, omega = math.cos(x[2]), math.sin(x[2]), x[3], x[4]
        forward = v + x[5] + x[6] * v + x[7] * omega
        left = x[8] + x[9] * v + x[10] * omega
        dx = np.zeros(_STATES)
        dx[0], dx[1] = c * forward - s * left, s * forward + c * left
        dx[2] = omega + x[11] + x[12] * v + x[13] * omega
        dx[3], dx[4] = (u[0] - v) / lag, (u[1] - omega) / lag
        return dx

    def h(x: Array) -> Array:
        return np.array([x[0] + ahead * math.cos(x[2]), x[1] + ahead * math.sin(x[2])])

    return Plant(f, h, _STATES, 2)


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
    """Drive a shipped configuration in lockstep; ``changes`` of its first group."""
    tree = load_config(SHIPPED / f"{name}.yaml", [f"run.seed={seed}", "run.bounds={}"])
    group = tree.groups[0]
    settings = {**group.settings, **changes.get("settings", {})}
    changed = group.model_copy(update={**changes, "settings": settings})
    return driven(tree.model_copy(update={"groups": (changed, *tree.groups[1:])}), name)


def exact_robots(config: Config) -> list[list[list[float]]]:
    """Return the same of simulated robots as they were built; their slip is not linear, and left out."""
    found = []
    for robot in config.members:
        simulated = slices.simulation(config, robot, None)
        nominal, build = simulated.drive, built(simulated.drive, simulated.imperfections, simulated.rng)
        mean, difference = (build.left_gain + build.right_gain) / 2.0, build.right_gain - build.left_gain
        ahead = [0.0, mean - 1.0, nominal.wheel_base * difference / 4.0]
        turning = [0.0, difference / build.wheel_base, mean * nominal.wheel_base / build.wheel_base - 1.0]
        found.append([ahead, [0.0] * 3, turning])
    return found


def learned_table(recorded: str, seed: int) -> tuple[Table, dict[str, float]]:
    """Return the platoon's figures by eq. 31, and by the flow on robots as built and as learned from a recording."""
    plain = driven_platoon("platoon", seed, {})
    models = {"exact": exact_robots(plain.config), "learned": learned_robots(driven_platoon(recorded, seed, {}))}
    behaviour = f"{__name__}:{LearnedPlatoon.__name__}"
    figures = {"eq. 31": _figures(plain)}
    for name, beyond in models.items():
        changes = {"behaviour": behaviour, "settings": {"beyond": beyond}}
        figures[name] = _figures(driven_platoon("platoon", seed, changes))
    rows: list[tuple[Cell, ...]] = [(what, *(each[what] for each in figures.values())) for what in figures["eq. 31"]]
    notes = (
        f"learned from configs/{recorded}.yaml: estimated poses and commands; exact: as built, but for the slip; "
        "measured on this project's plant and pixels",
    )
    columns, formats = ("mean of four robots, mm", *figures), ("", ".2f", ".2f", ".2f")
    table = Table("The platoon with robots that are learned", columns, tuple(rows), notes, formats)
    return table, {name: each["control error"] for name, each in figures.items()}


def _figures(run: Run) -> dict[str, float]:
    late, ahead = run.t > _SETTLED_S, round(run.config.controller.horizon_s / run.config.controller.tick_s)
    (group,) = run.group_figures
    off = np.linalg.norm(run.points()[ahead:] - run.references[:-ahead], axis=2)[late[:-ahead]]
    return {
        "control error": 1e3 * float(np.nanmean(group.figures["control_error"][late])),
        "from the reference, when it is due": 1e3 * float(np.nanmean(off)),
    }
