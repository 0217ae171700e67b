"""The Robotarium's interface, version 2: from April 2026."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robofleet.gateways.robotarium import simulator
from robofleet.gateways.robotarium.simulator import Array, Simulator, collided, outside, utility

_SPACING, _WIDTH, _HEIGHT = 0.5, 2.75, 1.75  # of random initial conditions [m]
_NOTHING = np.empty(0)
_MICRO = 1e6
_TOO_CLOSE, _OUTSIDE, _BEYOND = (
    "robots_too_close", "robots_outside_boundaries", "exceeded_actuator_limits"
)  # fmt: skip


class Robotarium(Simulator):
    """The robots of a configuration, as scripts of version 2 drive them."""

    TIME_STEP = simulator.TIME_STEP
    MAX_LINEAR_VELOCITY = simulator.MAX_LINEAR_VELOCITY
    MAX_ANGULAR_VELOCITY = simulator.MAX_ANGULAR_VELOCITY
    MAX_WHEEL_VELOCITY = simulator.MAX_WHEEL_VELOCITY
    ROBOT_DIAMETER = simulator.ROBOT_DIAMETER
    WHEEL_RADIUS = simulator.WHEEL_RADIUS
    BASE_LENGTH = _base = 0.11
    COLLISION_DIAMETER = simulator.COLLISION_DIAMETER
    COLLISION_OFFSET = simulator.COLLISION_OFFSET
    BOUNDARIES = np.array([-simulator.LENGTH, simulator.LENGTH, -simulator.WIDTH, simulator.WIDTH]) / 2
    CENTER_OFFSET = 0.01  # [m]
    DISTANCE_SENSOR_ERROR = 0.03
    DISTANCE_SENSOR_DROPOUT_PROB = 0.035
    DISTANCE_SENSOR_OUTLIER_PROB = 0.014
    DISTANCE_SENSOR_RANGE = 1.2  # [m]
    DISTANCE_SENSORS_ORIENTATION = np.array([
        (-0.04, 0.04, math.pi), (0.0, 0.06, math.pi / 2), (0.04, 0.05, math.pi / 4), (0.05, 0.0, 0.0),
        (0.04, -0.05, -math.pi / 4), (0.0, -0.06, -math.pi / 2), (-0.04, -0.04, -math.pi),
    ]).T  # x, y [m], direction [rad] of each on the robot  # fmt: skip
    ENCODER_COUNTS_PER_REVOLUTION = 28
    MOTOR_GEAR_RATIO = 100.37
    IMU_ORIENTATION = np.array([0.05621, -0.0130372, 0.0])  # [m]
    ENCODER_NOISE_STD = 0.25
    ACCELEROMETER_NOISE_STDS = np.array([0.012929, 0.012127, 0.052979])  # [m/s^2]
    GYRO_NOISE_STDS = np.array([0.001663, 0.001216, 0.002372])  # [rad/s]
    MAGNETOMETER_NOISE_STDS = np.array([3.275843, 2.365798, 5.232685])  # [uT]
    MAGNETOMETER_Z_AVG, MAGNETOMETER_XY_AVG = -39.8594, 6.0712  # [uT]
    ORIENTATION_NOISE_STD = 0.310830  # [deg]

    def __init__(
        self, *, number_of_robots: int = -1, show_figure: bool = False, initial_conditions: Any = _NOTHING,
        use_distance_sensors: bool = False, obstacles: Any = None, sim_in_real_time: bool = True,
        skip_initialization: bool = False, show_arena_boundaries: bool = True, show_robot_patches: bool = True,
        show_distance_endpoints: bool = True, show_distance_rays: bool = False, show_obstacles: bool = True,
        **_others: Any,
    ) -> None:  # fmt: skip
        """Begin a run: the robots stand at ``initial_conditions`` (3, N) when it returns; else at random poses."""
        assert isinstance(use_distance_sensors, bool), "use_distance_sensors must be of bool"
        walls = np.empty((0, 2, 2)) if obstacles is None else np.asarray(obstacles, np.float64).reshape(-1, 2, 2)
        self.obstacles, self._ranging = obstacles, use_distance_sensors
        self.show_arena_boundaries, self.show_robot_patches = show_arena_boundaries, show_robot_patches
        self.show_distance_endpoints, self.show_distance_rays = show_distance_endpoints, show_distance_rays
        self.show_obstacles, self.initializing = show_obstacles, False
        super().__init__(
            number_of_robots, show_figure, sim_in_real_time, initial_conditions, self._random, True,
            walls.reshape(-1, 4).tolist(),
        )  # fmt: skip
        if self._drawing is not None:
            self._fig, self._axes_handle = self._drawing.figure, self._drawing.axes
            self._robot_handle = self._drawing.robots
            if show_obstacles:
                self._drawing.walls(walls)

    def initialize(self, initial_conditions: Array) -> None:
        """Bring the robots to other poses (3, N), round each other."""
        self._run.go_to(np.asarray(initial_conditions, np.float64))
        self._measured[:] = self._run.poses

    def set_velocities(self, ids: ArrayLike, velocities: Any) -> None:
        """Set v [m/s], omega [rad/s] (2, N) of robots."""
        self._take(ids, velocities)

    def robot_colormap(self) -> Any:
        import matplotlib as mpl  # noqa: PLC0415 - slow to load

        return mpl.colormaps["tab20"]

    def get_distances(self) -> Array:
        """Return what the distance sensors see (7, N) [m]; -1: nothing; NaN: they are not used."""
        n = self.number_of_robots
        if not self._ranging:
            return np.full((self.DISTANCE_SENSORS_ORIENTATION.shape[1], n), np.nan)
        seen = self._sensed("distances", self.DISTANCE_SENSORS_ORIENTATION.shape[1])
        return np.where(np.isnan(seen), -1.0, seen)

    def get_distance_endpoints(self) -> Array:
        """Return where each distance sensor sees something (2, 7, N) [m; world]; NaN: it sees nothing."""
        distances, (x, y, psi) = self.get_distances(), self._measured
        at_x, at_y, towards = self.DISTANCE_SENSORS_ORIENTATION[:, :, None]
        c, s, ray = np.cos(psi), np.sin(psi), psi + towards
        far = np.where(distances >= 0, distances, np.nan)
        return np.stack([x + c * at_x - s * at_y + far * np.cos(ray), y + s * at_x + c * at_y + far * np.sin(ray)])

    def get_accelerations(self) -> Array:
        """Return accelerations along x, y, z (3, N) [m/s^2]; at rest z is -9.8."""
        return np.asarray(self._sensed("accelerometer", 3) * [[1.0], [1.0], [-1.0]])

    def get_gyros(self) -> Array:
        """Return turning about x, y, z (3, N) [rad/s]."""
        return self._sensed("gyro", 3)

    def get_magnetic_fields(self) -> Array:
        """Return the magnetic field along x, y, z (3, N) [uT]."""
        return self._sensed("magnetometer", 3) * _MICRO

    def get_orientations(self) -> Array:
        """Return headings (N,) [deg; 0 to 360]."""
        return np.asarray(np.mod(np.degrees(self._sensed("heading", 1)[0]), 360.0))

    def get_encoders(self) -> NDArray[np.int32]:
        """Return the counts of the left and the right wheel (2, N) since the beginning."""
        a_turn = self.ENCODER_COUNTS_PER_REVOLUTION * self.MOTOR_GEAR_RATIO
        return np.rint(self._run.turned * a_turn / math.tau).astype(np.int32)

    def debug(self) -> None:
        found, lines = self._errors, []
        if _TOO_CLOSE in found:
            lines.append(f"{found[_TOO_CLOSE]} time(s) two robots too close in a step")
        if _OUTSIDE in found:
            lines.append(f"{found[_OUTSIDE]} step(s) with a robot outside the arena")
        if _BEYOND in found:
            share = found[_BEYOND] / max(1, self._steps)
            lines.append(f"{found[_BEYOND]} step(s) beyond the wheels' limits ({share:.0%}); the wheels did less")
        self._report("debug", lines)

    @property
    def _poses(self) -> Array:
        return self._measured

    @property
    def _velocities(self) -> Array:
        return self._commanded

    def _sensed(self, which: str, count: int) -> Array:
        """Return what sensors of a kind say (count, N), NaN where a robot has none."""
        filled = np.full((count, self.number_of_robots), np.nan)
        for robot, reading in enumerate(self._run.sensors):
            value = None if reading is None else getattr(reading, which)
            if value is not None and np.size(value) == count:
                filled[:, robot] = value
        return filled

    def _random(self, count: int) -> Array:
        utility("generate_initial_poses")(
            count, width=simulator.LENGTH - self.ROBOT_DIAMETER, height=simulator.WIDTH - self.ROBOT_DIAMETER
        )  # the original draws first where the robots come from
        draw = utility("generate_random_poses")
        return np.array(draw(count, spacing=_SPACING, width=_WIDTH, height=_HEIGHT), np.float64)

    def _let_through(self) -> Array:
        left, right = np.clip(self._wheels(self._commanded), -self.MAX_WHEEL_VELOCITY, self.MAX_WHEEL_VELOCITY)
        self._commanded[0] = self.WHEEL_RADIUS * (left + right) / 2
        self._commanded[1] = self.WHEEL_RADIUS * (right - left) / self.BASE_LENGTH
        return self._commanded

    def _judge(self, poses: Array, wheels: Array) -> None:
        self._count(_OUTSIDE, int(outside(poses).any()))
        self._count(_TOO_CLOSE, len(collided(poses)[0]))
        self._count(_BEYOND, int((np.abs(wheels) > self.MAX_WHEEL_VELOCITY).any()))

    def _count(self, what: str, times: int) -> None:
        if times:
            self._errors[what] = self._errors.get(what, 0) + times
