"""The Robotarium's interface, version 1: until 2026."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robofleet.gateways.robotarium import simulator
from robofleet.gateways.robotarium.simulator import Array, Simulator, collided, outside, utility

_SPACING, _WIDTH, _HEIGHT = 0.2, 2.5, 1.5  # of random initial conditions [m]
_BASE = 0.105  # [m]
_NOTHING = np.empty(0)


class Robotarium(Simulator):
    """The robots of a configuration, as scripts of version 1 drive them."""

    _base = _BASE

    def __init__(
        self, number_of_robots: int = -1, show_figure: bool = True, sim_in_real_time: bool = True,
        initial_conditions: Any = _NOTHING,
    ) -> None:  # fmt: skip
        """Begin a run: ``initial_conditions`` x, y [m], psi [rad] (3, N); else random ones."""
        self.time_step, self.robot_diameter = simulator.TIME_STEP, simulator.ROBOT_DIAMETER
        self.robot_radius, self.robot_length, self.robot_width = self.robot_diameter / 2, 0.095, 0.09  # [m]
        self.wheel_radius, self.base_length = simulator.WHEEL_RADIUS, _BASE
        self.max_linear_velocity = simulator.MAX_LINEAR_VELOCITY
        self.max_angular_velocity = simulator.MAX_ANGULAR_VELOCITY
        self.max_wheel_velocity = simulator.MAX_WHEEL_VELOCITY
        self.collision_offset, self.collision_diameter = simulator.COLLISION_OFFSET, simulator.COLLISION_DIAMETER
        length, width = simulator.LENGTH, simulator.WIDTH
        self.boundaries = [-length / 2, -width / 2, length, width]  # x, y of a corner, and the sides [m]
        self.initial_conditions, self.sim_in_real_time = initial_conditions, sim_in_real_time
        super().__init__(number_of_robots, show_figure, sim_in_real_time, initial_conditions, self._random)
        drawing = self._drawing
        self.figure: Any = [] if drawing is None else drawing.figure
        self.axes: Any = [] if drawing is None else drawing.axes
        self.chassis_patches: list[Any] = [] if drawing is None else drawing.robots
        self.poses, self.velocities = self._measured, self._commanded

    def set_velocities(self, ids: ArrayLike, velocities: Any) -> None:
        """Set v [m/s], omega [rad/s] (2, N) of robots, each within the limit of its own."""
        limits = np.array([[self.max_linear_velocity], [self.max_angular_velocity]])
        self._take(ids, np.clip(np.asarray(velocities, np.float64), -limits, limits))

    def set_leds(self, ids: ArrayLike, colours: ArrayLike) -> None:
        """Show colours (3, N), 0 to 255, on the robots of the figure."""
        if self._drawing is not None:
            rgb = np.clip(np.asarray(colours, np.float64) / 255.0, 0.0, 1.0)
            for index, robot in enumerate(np.asarray(ids, np.intp).ravel()):
                self._drawing.colour(int(robot), tuple(rgb[:, index]))

    set_left_leds = set_right_leds = set_leds

    def call_at_scripts_end(self) -> None:
        found, lines = self._errors, []
        if "boundary" in found:
            lines.append(f"{max(found['boundary'].values())} {found['boundary_string']}")
        if "collision" in found:
            lines.append(f"{max(found['collision'].values())} {found['collision_string']}")
        if "actuator" in found:
            lines.append(f"{found['actuator']} {found['actuator_string']}")
        self._report("call_at_scripts_end", lines)

    def _random(self, count: int) -> Array:
        draw = utility("generate_initial_conditions")
        return np.array(draw(count, spacing=_SPACING, width=_WIDTH, height=_HEIGHT), np.float64)

    def _seen(self) -> Array:
        return self._measured  # scripts of version 1 may see it change with the next step

    def _judge(self, poses: Array, wheels: Array) -> None:
        pairs = collided(poses)
        self._count("boundary", np.flatnonzero(outside(poses)).tolist(), "step(s) of a robot outside the arena")
        self._count("collision", np.concatenate(pairs).tolist(), "step(s) of a robot in a collision")
        if (np.abs(wheels) > self.max_wheel_velocity).any():
            self._errors["actuator"] = self._errors.get("actuator", 0) + 1
            self._errors["actuator_string"] = "step(s) beyond the wheels' limits"

    def _count(self, what: str, robots: Sequence[int], meaning: str) -> None:
        for robot in robots:
            each = self._errors.setdefault(what, {})
            each[robot] = each.get(robot, 0) + 1
            self._errors[f"{what}_string"] = meaning
