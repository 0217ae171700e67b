"""MuJoCo as a plant: wheels that roll by friction, motors with back-EMF, bodies that collide.

A robot is a disc on two driven wheels and a castor behind them. Its frame is that of the axle: x ahead, y left, z up,
with its origin in the axle's middle. A motor gives the torque ``stall (u - omega / no_load)`` at the duty u, which a
battery limits to its charge's share. The firmware's loop is a proportional and integral one on the speed that its
encoder counts, tuned so that a wheel that drives straight ahead follows with the motor lag of its kind; it adds what
its gear's friction takes.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from robofleet.config.faults import did_you_mean
from robofleet.core.arrays import Array
from robofleet.core.settings import MANY, Fraction, Length, Model, Name, within
from robofleet.simulation.mujoco.extra import missing, mujoco, raise_walls, turned
from robofleet.vehicles.plants import PlantContext, PlantRobot, PlantState

_GRAVITY = 9.81  # [m/s^2]
_FLOOR, _CHASSIS, _OBSTACLE = 1, 2, 4  # bits of what collides with what
_TYRE = 0.2  # half width of a tyre [wheel radii]
_CASTOR_BEHIND, _CASTOR_RADIUS = 0.75, 0.3  # [body radii], [wheel radii]
_CASTOR_FRICTION, _BODY_FRICTION = 0.05, 0.3
_STIFF = {"solref": [0.004, 1.0], "solimp": [0.95, 0.99, 0.0001, 0.5, 2.0]}  # contacts: hundredths of a mm deep
_CENTRE_BEHIND, _CENTRE_HEIGHT = 0.2, 1.0  # of mass, from the axle's middle [body radii], above the floor [wheel radii]
_WHEEL_MASS = 0.05  # of a wheel [robot's mass]
_STILL_M_S = 0.005  # a cable's drag fades below this speed

Angle = Annotated[float, Field(ge=-10, le=10)]
Newtons = Annotated[float, within(0, 1000)]


class MujocoSettings(Model):
    """Floor, bodies and motors of MuJoCo's robots."""

    step_s: Annotated[float, within(1e-4, 0.005)] = 0.001
    """Longest step of the integrator."""
    mass_kg_m2: Annotated[float, within(1, 1000)] = 40.0
    """Mass of a robot by the area of its disc: 0.38 kg of a GTernal, 3.6 kg of a Create 2."""
    friction: Annotated[float, within(0.01, 5)] = 0.8
    """Friction coefficient between tyres and floor."""
    friction_spread: Fraction = 0.0
    """Relative spread of the friction: each patch of the floor has its own, drawn uniformly."""
    patch_m: Length = 0.25
    """Side of a patch of the floor."""
    tilt_deg: Annotated[tuple[Angle, Angle], Field(strict=False)] = (0.0, 0.0)
    """How much the floor rises along x and along y."""
    cables_n: Annotated[dict[Name, Newtons], Field(max_length=MANY)] = Field(default={})
    """Cables that robots drag, by the robots' ids: the force on the tail, against its motion."""
    stall_thrust: Annotated[float, within(0.05, 20)] = 1.0
    """Thrust of both motors at full duty and at rest, relative to the robot's weight."""
    no_load: Annotated[float, within(1.01, 10)] = 1.3
    """Speed of an unloaded wheel at full duty, relative to the kind's ``max_wheel_speed_rad_s``."""
    rotor_inertia: Annotated[float, within(0, 100)] = 0.5
    """Inertia of a motor's rotor behind its gear, relative to that of half the robot's mass at the wheel's radius."""
    gear_friction: Fraction = 0.05
    """Dry friction of a gear, relative to the motor's stall torque."""


class MujocoPlant:
    """Robots (N,) in one world of MuJoCo."""

    Settings = MujocoSettings

    @staticmethod
    def refusals(settings: MujocoSettings, robots: Sequence[str]) -> Iterator[tuple[str, str]]:
        if lacking := missing("mujoco"):
            yield "model", lacking
        for robot in settings.cables_n:
            if robot not in robots:
                yield f"settings.cables_n.{robot}", f"there is no robot '{robot}': {did_you_mean(robot, robots)}"

    def __init__(self, context: PlantContext) -> None:
        self._mj = mujoco()
        s, robots = context.settings, context.robots
        self._settings, n = s, len(robots)
        self._model = _model(context).compile()
        self._data = self._mj.MjData(self._model)
        joint = self._model.joint
        free = [joint(f"{robot.robot}/free") for robot in robots]
        wheels = [joint(f"{robot.robot}/{side}") for robot in robots for side in ("left", "right")]
        self._position = np.array([each.qposadr[0] for each in free])
        self._velocity = np.array([each.dofadr[0] for each in free])
        self._angle = np.array([each.qposadr[0] for each in wheels]).reshape(n, 2)
        self._speed = np.array([each.dofadr[0] for each in wheels]).reshape(n, 2)
        self._tyres = np.array([self._model.geom(f"{r.robot}/{side}").id for r in robots for side in ("left", "right")])
        self._bodies = np.array([self._model.body(robot.robot).id for robot in robots])
        self._loops = [_Loop(robot, s) for robot in robots]
        self._tails = np.array([[-robot.radius, 0.0, 0.0] for robot in robots])
        self._drag = np.array([s.cables_n.get(robot.robot, 0.0) for robot in robots])
        self._size = np.array(context.world.size)
        cells = np.ceil(self._size / s.patch_m).astype(int) + 2
        self._patches = s.friction * (1.0 + s.friction_spread * context.rng.uniform(-1.0, 1.0, cells))
        self._uneven = s.friction_spread > 0.0
        self._mj.mj_forward(self._model, self._data)

    def step(self, setpoints: Array, duration: float) -> None:
        data, end = self._data, self._data.time + duration
        while (left := end - data.time) > 1e-10:
            due = self._look(setpoints)
            span = min(left, due - data.time)
            steps = math.ceil(span / self._settings.step_s - 1e-9)
            self._model.opt.timestep = span / steps
            if self._drag.any():
                for _ in range(steps):
                    self._pull()
                    self._mj.mj_step(self._model, data)
            else:
                self._mj.mj_step(self._model, data, steps)

    def state(self) -> PlantState:
        position, velocity = self._data.qpos, self._data.qvel
        quaternion = position[self._position[:, None] + np.arange(3, 7)]
        w, x, y, z = quaternion.T
        psi = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        poses = np.column_stack([position[self._position], position[self._position + 1], psi])
        ahead = velocity[self._velocity] * np.cos(psi) + velocity[self._velocity + 1] * np.sin(psi)
        velocities = np.column_stack([ahead, velocity[self._velocity + 5]])
        return PlantState(poses, velocities, position[self._angle], velocity[self._speed])

    def _look(self, setpoints: Array) -> float:
        """Run the firmwares' loops that are due; returns when the next one is [s]."""
        data, now = self._data, self._data.time + 1e-10
        for row, loop in enumerate(self._loops):
            if loop.due <= now:
                duties = loop.run(setpoints[row].tolist(), data.qpos[self._angle[row]].tolist(), now)
                data.ctrl[2 * row : 2 * row + 2] = duties
                if self._uneven:
                    self._feel(slice(2 * row, 2 * row + 2))
        return min(loop.due for loop in self._loops)

    def _feel(self, rows: slice) -> None:
        """Give tyres the friction of the patch on which they stand."""
        tyres = self._tyres[rows]
        cells = np.floor((self._data.geom_xpos[tyres, :2] + self._size / 2) / self._settings.patch_m).astype(int) + 1
        i, j = np.clip(cells, 0, np.array(self._patches.shape) - 1).T
        self._model.geom_friction[tyres, 0] = self._patches[i, j]

    def _pull(self) -> None:
        """Pull at the robots' tails, against their motion."""
        data = self._data
        turns = data.xmat[self._bodies].reshape(-1, 3, 3)
        arms = np.einsum("nij,nj->ni", turns, self._tails)
        spins = np.einsum("nij,nj->ni", turns, data.qvel[self._velocity[:, None] + np.arange(3, 6)])
        motion = data.qvel[self._velocity[:, None] + np.arange(3)] + np.cross(spins, arms)
        motion[:, 2] = 0.0
        speed = np.linalg.norm(motion, axis=1)
        forces = -(self._drag / np.maximum(speed, _STILL_M_S))[:, None] * motion
        data.xfrc_applied[self._bodies, :3] = forces
        data.xfrc_applied[self._bodies, 3:] = np.cross(
            data.xpos[self._bodies] + arms - data.xipos[self._bodies], forces
        )


class _Loop:
    """A firmware's wheel-speed loops, left and right."""

    def __init__(self, robot: PlantRobot, s: MujocoSettings) -> None:
        p = self._p = robot.build
        self.due = 0.0
        self._count = p.speed_quantum * p.loop_period
        self._seen, self._sums = [0.0, 0.0], [0.0, 0.0]
        no_load = s.no_load * p.max_wheel_speed
        inertia = (1.0 + s.rotor_inertia) * _half_inertia(robot, s)
        self._motor_s = inertia * no_load / _stall(robot, s)  # time constant of a motor that moves its half
        self._friction = s.gear_friction
        self._gain = self._motor_s / (max(p.motor_lag, 2.0 * p.loop_period) * no_load)

    def run(self, setpoints: list[float], angles: list[float], now: float) -> tuple[float, float]:
        """Return the duties in [-1, 1]."""
        p = self._p
        used = min(1.0, now / p.battery_life)
        most = 1.0 - p.top_speed_sag * used
        left, right = (self._wheel(side, setpoints[side], angles[side], most) for side in (0, 1))
        self.due += p.loop_period
        return left, right

    def _wheel(self, side: int, setpoint: float, angle: float, most: float) -> float:
        p = self._p
        if self._count:
            angle = self._count * math.floor(angle / self._count)
        speed = (angle - self._seen[side]) / p.loop_period
        self._seen[side] = angle
        if abs(setpoint) < (p.deadband if speed else p.breakaway):
            if not speed:
                self._sums[side] = 0.0
                return 0.0
            setpoint = 0.0
        error = math.copysign(min(abs(setpoint), p.max_wheel_speed), setpoint) - speed
        total = self._sums[side] + self._gain * error * p.loop_period / self._motor_s
        duty = self._gain * error + total + math.copysign(self._friction, setpoint or speed)
        if abs(duty) <= most or error * duty < 0.0:
            self._sums[side] = total
        return max(-most, min(most, duty))


def _mass(robot: PlantRobot, s: MujocoSettings) -> float:
    return s.mass_kg_m2 * math.pi * robot.radius**2


def _half_inertia(robot: PlantRobot, s: MujocoSettings) -> float:
    """Return what half a robot's mass is at its wheel [kg m^2]."""
    return _mass(robot, s) / 2.0 * robot.build.wheel_radius**2


def _stall(robot: PlantRobot, s: MujocoSettings) -> float:
    """Return a motor's torque at full duty and at rest [N m]."""
    return s.stall_thrust * _mass(robot, s) * _GRAVITY / 2.0 * robot.build.wheel_radius


def _model(context: PlantContext) -> Any:
    """Return the world as MuJoCo's specification."""
    mj, s = mujoco(), context.settings
    spec = mj.MjSpec()
    x, y = np.radians(s.tilt_deg)
    down = np.array([math.tan(x), math.tan(y), 1.0])
    spec.option.gravity = -_GRAVITY * down / np.linalg.norm(down)
    spec.option.integrator = mj.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mj.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 20.0
    spec.option.timestep = s.step_s
    spec.worldbody.add_geom(
        type=mj.mjtGeom.mjGEOM_PLANE, size=[*context.world.size, 0.1], contype=_FLOOR, conaffinity=0, name="floor"
    )
    for obstacle in context.world.obstacles:
        raise_walls(spec.worldbody, obstacle, **_STIFF, contype=_OBSTACLE, conaffinity=0)
    for robot in context.robots:
        _add(spec, robot, s)
    return spec


def _add(spec: Any, robot: PlantRobot, s: MujocoSettings) -> None:
    """Add a robot: a free disc, two wheels, a castor."""
    mj, p, mass, name = mujoco(), robot.build, _mass(robot, s), robot.robot
    x, y, psi = robot.start
    r, radius = p.wheel_radius, robot.radius
    body = spec.worldbody.add_body(name=name, pos=[x, y, r], quat=turned(psi))
    body.add_freejoint(name=f"{name}/free")
    chassis, low, high = mass * (1.0 - 2.0 * _WHEEL_MASS), 0.3 * r, max(robot.height, 2.0 * r)
    half = (high - low) / 2.0
    flat, upright = chassis * (3.0 * radius**2 + 4.0 * half**2) / 12.0, chassis * radius**2 / 2.0
    body.mass, body.ipos = chassis, [-_CENTRE_BEHIND * radius, 0.0, (_CENTRE_HEIGHT - 1.0) * r]
    body.inertia, body.explicitinertial = [flat, flat, upright], True
    body.add_geom(
        type=mj.mjtGeom.mjGEOM_CYLINDER, size=[radius, half, 0.0], pos=[0.0, 0.0, low + half - r],
        contype=_CHASSIS, conaffinity=_CHASSIS | _OBSTACLE, friction=[_BODY_FRICTION, 0.0, 0.0], **_STIFF,
    )  # fmt: skip
    on_floor = {**_STIFF, "priority": 1, "condim": 3, "contype": 0, "conaffinity": _FLOOR}
    castor = _CASTOR_RADIUS * r
    body.add_geom(
        type=mj.mjtGeom.mjGEOM_SPHERE, size=[castor, 0.0, 0.0], pos=[-_CASTOR_BEHIND * radius, 0.0, castor - r],
        friction=[_CASTOR_FRICTION, 0.0, 0.0], **on_floor,
    )  # fmt: skip
    half_inertia, stall = _half_inertia(robot, s), _stall(robot, s)
    no_load = s.no_load * p.max_wheel_speed
    for side, sign, gain in (("left", 1.0, p.left_gain), ("right", -1.0, p.right_gain)):
        own = gain * r
        wheel = body.add_body(pos=[0.0, sign * p.wheel_base / 2.0, own - r])
        wheel.add_joint(
            name=f"{name}/{side}", type=mj.mjtJoint.mjJNT_HINGE, axis=[0.0, 1.0, 0.0],
            armature=s.rotor_inertia * half_inertia, frictionloss=s.gear_friction * stall,
        )  # fmt: skip
        wheel.add_geom(
            name=f"{name}/{side}", type=mj.mjtGeom.mjGEOM_ELLIPSOID, size=[own, _TYRE * own, own],
            mass=_WHEEL_MASS * mass, friction=[s.friction, 0.0, 0.0], **on_floor,
        )  # fmt: skip
        motor = spec.add_actuator(
            name=f"{name}/{side}", target=f"{name}/{side}", trntype=mj.mjtTrn.mjTRN_JOINT,
            gaintype=mj.mjtGain.mjGAIN_FIXED, biastype=mj.mjtBias.mjBIAS_AFFINE,
        )  # fmt: skip
        motor.gainprm[0], motor.biasprm[2] = stall, -stall / no_load
