"""What the controller is made of beside its groups' behaviours, as the configuration says."""

import numpy as np

from robofleet.config import slices
from robofleet.config.barrier import body, keepout
from robofleet.config.tree import Config
from robofleet.safety.barrier import Barrier
from robofleet.tracking.filter.estimator import Bystanders, FleetFilter
from robofleet.vehicles.differential_drive import DifferentialDrive


def fleet_filter(config: Config) -> FleetFilter:
    """Return the Kalman filter of the members' poses."""
    delays_ns = tuple(slices.delay_ns(config, robot) for robot in config.members)
    return FleetFilter(drives(config), delays_ns, config.controller.filter_in_force)


def barrier(config: Config) -> Barrier:
    return Barrier(keepout(config), tuple(body(config, robot) for robot in config.bodies))


def bystanders(config: Config) -> Bystanders:
    radii = np.array([robot.vehicle.body_radius_m for robot in config.bystanders])
    return Bystanders(radii, config.controller.barrier.age_s)


def drives(config: Config) -> tuple[DifferentialDrive, ...]:
    return tuple(slices.drive(robot) for robot in config.members)
