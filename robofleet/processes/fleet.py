"""What the controller is made of, as the configuration says."""

from collections.abc import Callable

import numpy as np

from robofleet.config import slices
from robofleet.config.barrier import body, keepout
from robofleet.config.tree import Config
from robofleet.control.excitation import Excitation, ExcitationSettings
from robofleet.control.path import Path
from robofleet.control.platoon import Platoon, PlatoonSettings
from robofleet.safety.barrier import Barrier
from robofleet.tracking.bystanders import Bystanders
from robofleet.tracking.estimator import FilterNoise, FleetFilter
from robofleet.vehicles.differential_drive import DifferentialDrive


def behaviour(config: Config) -> Platoon | Excitation:
    """Return what the group does."""
    return _BEHAVIOURS[config.groups[0].behaviour](config)


def excitation(config: Config) -> Excitation:
    """Return the calibrating drive of the group: the same one for the same seed."""
    c, robots = config.controller, config.platoon
    radii = tuple(robot.vehicle.body_radius_m for robot in robots)
    settings = ExcitationSettings(c.tick_s, c.point_ahead_m, config.arena.size_m, radii)
    return Excitation(settings, _drives(config), slices.generator(config.run.seed, "excitation"))


def fleet_filter(config: Config) -> FleetFilter:
    """Return the filter of the group's poses."""
    f = config.controller.filter
    noise = FilterNoise(
        f.position_noise_m,
        f.heading_noise_rad,
        f.position_drift_m,
        f.heading_drift_rad,
        f.gate_sigma,
        f.efficiency_sigma if config.controller.disturbance == "estimated" else 0.0,
        f.efficiency_time_s,
    )
    return FleetFilter(_drives(config), tuple(slices.delay_ns(config, robot) for robot in config.platoon), noise)


def barrier(config: Config) -> Barrier:
    """Return the barrier of the group among all bodies."""
    return Barrier(keepout(config), tuple(body(config, robot) for robot in config.bodies))


def bystanders(config: Config) -> Bystanders:
    """Return what knows where the robots stand that nobody drives."""
    radii = np.array([robot.vehicle.body_radius_m for robot in config.bystanders])
    return Bystanders(radii, config.controller.barrier.age_s)


def _platoon(config: Config) -> Platoon:
    group, c = config.groups[0], config.controller
    settings = PlatoonSettings(
        c.alpha,
        c.horizon_s,
        c.point_ahead_m,
        group.spacing_m,
        group.path_rate,
        c.tick_s,
        c.integrator,
        group.track,
    )
    return Platoon(Path.hermite(*slices.knots(group)), settings, _drives(config))


def _drives(config: Config) -> tuple[DifferentialDrive, ...]:
    return tuple(slices.drive(robot) for robot in config.platoon)


_BEHAVIOURS: dict[str, Callable[[Config], Platoon | Excitation]] = {"platoon": _platoon, "excitation": excitation}
