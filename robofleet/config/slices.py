"""From the configuration's tree to the parameters of other rooms, whose names have no units."""

import math
import secrets
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.metadata import version
from typing import Any

import numpy as np

from robofleet.config import obstacles
from robofleet.config.obstacles import Arena
from robofleet.config.robots import Robot, Vehicle
from robofleet.config.sensors import Distances
from robofleet.config.tree import OWN_PLANT, Config, PlantSettings
from robofleet.core.clock import S
from robofleet.core.patterns import OVERHEAD
from robofleet.core.plugins import load
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import BodyTrouble, Imperfections, Simulation, World, WorldObstacle, WorldRobot
from robofleet.vehicles.plant import built
from robofleet.vehicles.plants import PlantContext, PlantRobot, SharedPlant
from robofleet.vehicles.sensors import DistanceSensors, Errors, Sensing, SensorKind

PLANTS = "robofleet.plants"

_UT = 1e-6  # [T]


def drive(robot: Robot) -> DifferentialDrive:
    """Return what the controller and the gate believe of a robot: its vehicle's values, or what was measured of it."""
    nominal, measured = vehicle_drive(robot.vehicle), robot.calibration
    if measured is None:
        return nominal
    return replace(
        nominal,
        wheel_radius=_first(measured.wheel_radius_m, nominal.wheel_radius),
        wheel_base=_first(measured.wheel_base_m, nominal.wheel_base),
        motor_lag=_first(measured.motor_lag_s, nominal.motor_lag),
    )


def delay_ns(config: Config, robot: Robot) -> int:
    """Return the time from a tick to the moment when a robot's command of that tick acts [ns]."""
    measured = None if robot.calibration is None else robot.calibration.delay_s
    return round(_first(measured, config.controller.command_delay_s) * S)


def tag_height_m(config: Config, robot: Robot) -> float:
    """Return how high above the floor a robot's tag lies [m]: as measured, as the robot says, or as all robots' do."""
    measured = None if robot.calibration is None else robot.calibration.tag_height_m
    return _first(measured, _first(robot.tag_height_m, config.tracker.tag_height_m))


def vehicle_drive(vehicle: Vehicle) -> DifferentialDrive:
    """Return what is known of a kind of robot, whatever was measured of one: what a simulated one is made by."""
    return DifferentialDrive(
        vehicle.wheel_radius_m,
        vehicle.wheel_base_m,
        vehicle.max_wheel_speed_rad_s,
        vehicle.max_speed_m_s,
        vehicle.motor_lag_s,
        vehicle.max_wheel_acceleration_rad_s2,
    )


def imperfections(robot: Robot) -> Imperfections:
    """Return how bad the simulated robot is, as identified or as its vehicle says; ValueError where nothing says it."""
    p = None if robot.calibration is None else robot.calibration.simulated
    p = p or robot.vehicle.simulated
    if p is None:
        raise ValueError("a simulated robot needs its vehicle's `simulated`")
    return Imperfections(
        motor_lag=p.motor_lag_s,
        speed_quantum=p.speed_quantum_rad_s,
        loop_period=p.loop_period_s,
        deadband=p.deadband_rad_s,
        breakaway=p.breakaway_rad_s,
        wheel_gain_spread=p.wheel_gain_spread,
        wheel_base_spread=p.wheel_base_spread,
        slip=p.slip_s_per_rad,
        slip_noise=p.slip_noise,
        top_speed_sag=p.top_speed_sag,
        battery_life=p.battery_life_s,
        wheel_gain_error=p.wheel_gain_error,
        wheel_gain_difference=p.wheel_gain_difference,
        wheel_base_error=p.wheel_base_error,
        top_speed_error=p.top_speed_error,
        wiring=p.wiring,
        actuation_delay=p.actuation_delay_s,
        stop_lag=p.stop_lag_s,
    )


def build(config: Config) -> int:
    """Return a number that is the same in every process of a run: of one version and one configuration."""
    return zlib.crc32(f"{version('robofleet')}\n{config.model_dump_json(exclude=_unused(config))}".encode())


def _unused(config: Config) -> dict[str, Any]:
    """Return the keys that change nothing in this run, for ``build`` to leave out: unread sensors, unseen walls,
    empty lists of obstacles, settings of an exposure or a light that stays, a camera's default name, the own plant."""
    camera: dict[str, Any] = {} if config.camera.adjusts_exposure else {"exposure_control": True, "exposure": True}
    if config.camera.name == OVERHEAD:
        camera["name"] = True
    if not config.camera.simulated.daylight:
        camera["simulated"] = {"daylight"}
    robots = {i: {"sensors": True, "vehicle": {"sensors"}} for i, r in enumerate(config.robots) if not r.sensors}
    arena = {key for key in ("floor_m", "obstacles", "moving") if not getattr(config.arena, key)}
    if config.arena.walls is None or not config.sensing:
        arena.add("walls")
    unused: dict[str, Any] = {"robots": robots, "arena": arena, "camera": camera}
    return unused if config.plant != PlantSettings() else {**unused, "plant": True}


def simulation(config: Config, robot: Robot, trouble: Callable[[], BodyTrouble] | None) -> Simulation:
    """Return what a simulated robot is made from; the same robot of the same seed is the same one.

    ValueError where the configuration does not say how bad it is, or where it begins: only a real robot needs neither.
    """
    return Simulation(
        drive=vehicle_drive(robot.vehicle),
        imperfections=imperfections(robot),
        start=start_pose(robot),
        trouble=trouble,
        rng=generator(config.run.seed, "plant", robot.id),
        radius=robot.vehicle.body_radius_m,
        sensing=_sensing(config, robot),
    )


def plant_settings(config: Config) -> Any:
    """Return ``plant.settings`` as the plant's own model; None where it takes none.

    Raises:
        PluginError: there is no such plant.
        ValidationError: the settings are wrong.
    """
    kind = getattr(load(PLANTS, config.plant.model), "Settings", None)
    return None if kind is None else kind.model_validate(config.plant.settings)


def shared_plant(config: Config, robots: Sequence[str], now_ns: int) -> SharedPlant | None:
    """Return the plant that the simulated robots of a process share; None where each is moved by the own equations.

    Raises as ``plant_settings`` does, and what the plant raises.
    """
    if config.plant.model == OWN_PLANT:
        return None
    planted = tuple(_plant_robot(config, config.robot(robot)) for robot in robots)
    rng = generator(config.run.seed, "plant", *robots)
    context = PlantContext(robots=planted, world=world(config), settings=plant_settings(config), rng=rng)
    return SharedPlant(load(PLANTS, config.plant.model)(context), planted, now_ns)


def _plant_robot(config: Config, robot: Robot) -> PlantRobot:
    s = simulation(config, robot, None)
    build, height = built(s.drive, s.imperfections, s.rng), tag_height_m(config, robot)
    return PlantRobot(robot=robot.id, build=build, start=s.start, radius=s.radius, height=height)


def world(config: Config) -> World:
    """Return everything that stands in the arena, for drivers."""
    arena = config.arena
    return World(
        size=arena.size_m,
        floor=arena.floor_m,
        robots=tuple(
            WorldRobot(
                robot=robot.id,
                unit=config.unit_of[robot.id],
                drive=drive(robot),
                radius=robot.vehicle.body_radius_m,
                start=None if robot.start is None else start_pose(robot),
            )
            for robot in config.robots
        ),
        obstacles=tuple(
            WorldObstacle(
                name=solid.name,
                points=solid.points if solid.radius else tuple(map(tuple, solid.outline.tolist())),
                radius=solid.radius,
                height=obstacle.height_m,
            )
            for solid, obstacle in zip(obstacles.standing(arena), arena.obstacles, strict=True)
        ),
    )


def sensors(robot: Robot) -> SensorKind | None:
    """Return the sensors that a robot's driver is to tell of; None where nobody asks for any."""
    s = robot.vehicle.sensors
    if s is None or not robot.sensors:
        return None
    gyro, accelerometer, magnetometer, heading, d = s.gyro, s.accelerometer, s.magnetometer, s.heading, s.distances
    return SensorKind(
        s.period_s,
        None if gyro is None else Errors(gyro.noise_rad_s, gyro.bias_rad_s),
        None if accelerometer is None else Errors(accelerometer.noise_m_s2, accelerometer.bias_m_s2),
        (0.0, 0.0) if accelerometer is None else (accelerometer.x_m, accelerometer.y_m),
        None if magnetometer is None else Errors(_tesla(magnetometer.noise_ut), magnetometer.bias_ut * _UT),
        (0.0, 0.0, 0.0) if magnetometer is None else _tesla(magnetometer.field_ut),
        None if heading is None else Errors((heading.noise_rad,), heading.bias_rad),
        None if d is None else _distances(d),
    )


def _distances(d: Distances) -> DistanceSensors:
    places = tuple((sensor.x_m, sensor.y_m, math.radians(sensor.heading_deg)) for sensor in d.places)
    return DistanceSensors(places, d.range_m, d.noise, d.dropout, d.outliers)


def sensing_period_ns(config: Config, unit: str) -> int | None:
    """Return the time between two messages of a unit's sensors [ns]; None where nobody asks for any."""
    kinds = [kind for robot_id in config.units[unit] if (kind := sensors(config.robot(robot_id))) is not None]
    return round(min(kind.period for kind in kinds) * S) if kinds else None


def walls(arena: Arena) -> tuple[tuple[float, float, float, float], ...]:
    """Return what simulated distance sensors see beside robots: x, y of both ends of each wall [m; world]."""
    x, y = arena.size_m[0] / 2, arena.size_m[1] / 2
    floor = arena.floor_m or ((-x, -y), (x, -y), (x, y), (-x, y))
    outlines = [solid.outline.tolist() for solid in obstacles.standing(arena)]
    outer = _sides(floor) if arena.walls is None else arena.walls
    return (*outer, *(side for corners in outlines for side in _sides(corners)))


def _sides(corners: Sequence[Sequence[float]]) -> tuple[tuple[float, float, float, float], ...]:
    ends = zip(corners, (*corners[1:], corners[0]), strict=True)
    return tuple((*end, *other) for (end, other) in ends)  # type: ignore[misc]


def _sensing(config: Config, robot: Robot) -> Sensing | None:
    kind = sensors(robot)
    own = generator(config.run.seed, "sensors", robot.id)
    return None if kind is None else Sensing(kind, walls(config.arena), own)


def _tesla(microtesla: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = microtesla
    return x * _UT, y * _UT, z * _UT


def start_pose(robot: Robot) -> tuple[float, float, float]:
    """Return x, y [m], psi [rad] of a robot at first; ValueError where nothing says it."""
    if robot.start is None:
        raise ValueError(f"{robot.id} has no start")
    return robot.start.x_m, robot.start.y_m, robot.start.psi


def generator(seed: int, *key: str) -> "np.random.Generator":
    """Return the randomness of one part of a run: a seed and a name give one stream, whoever else draws."""
    return np.random.default_rng([seed, *("/".join(key)).encode()])


def entropy(seed: int, *key: str) -> "np.random.Generator":
    """Return randomness that no other start of the same process draws again: boot ids must differ."""
    return np.random.default_rng([seed, *("/".join(key)).encode(), *secrets.token_bytes(16)])


def drawn_id(rng: "np.random.Generator", bits: int) -> int:
    """Return a number above 0 that names one start of a process."""
    return int(rng.integers(1, 2 ** (bits - 1)))


def _first(measured: float | None, believed: float) -> float:
    return believed if measured is None else measured
