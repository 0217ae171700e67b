"""What the controller is made of beside its groups' behaviours, as the configuration says."""

import numpy as np

from robofleet.config import slices
from robofleet.config.barrier import body, keepout
from robofleet.config.tree import Config
from robofleet.safety.barrier import Barrier
from robofleet.tracking.filter.estimator import Bystanders, FilterNoise, FleetFilter
from robofleet.vehicles.differential_drive import DifferentialDrive


def fleet_filter(config: Config) -> FleetFilter:
    f = config.controller.filter
    efficiency_sigma = f.efficiency_sigma if config.controller.disturbance == "estimated" else 0.0
    noise = FilterNoise(
        f.position_noise_m, f.heading_noise_rad, f.position_drift_m, f.heading_drift_rad, f.gate_sigma,
        efficiency_sigma, f.efficiency_time_s,
    )  # fmt: skip
    return FleetFilter(drives(config), tuple(slices.delay_ns(config, robot) for robot in config.members), noise)


def barrier(config: Config) -> Barrier:
    return Barrier(keepout(config), tuple(body(config, robot) for robot in config.bodies))


def bystanders(config: Config) -> Bystanders:
    radii = np.array([robot.vehicle.body_radius_m for robot in config.bystanders])
    return Bystanders(radii, config.controller.barrier.age_s)


def drives(config: Config) -> tuple[DifferentialDrive, ...]:
    return tuple(slices.drive(robot) for robot in config.members)
