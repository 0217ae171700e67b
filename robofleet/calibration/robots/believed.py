"""What the configuration believes of a robot: the prior of its identification."""

import math

from robofleet.calibration.robots.drive_file import RobotDrive
from robofleet.calibration.robots.information import Prior
from robofleet.calibration.robots.shooting import Noise, Shots, Wheels
from robofleet.config import slices
from robofleet.config.plant_errors import NO_ERRORS, PlantErrors
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.core.clock import S

_LEAST_WANDER = 1e-4  # as in Noise


def believed_errors(robot: Robot) -> PlantErrors:
    """Return how the robot would be simulated before it is identified."""
    known = None if robot.calibration is None else robot.calibration.simulated
    return known or robot.vehicle.simulated or NO_ERRORS


def prior(config: Config, robot: Robot) -> Prior:
    """Return what the configuration believes of a robot, and how far it may be wrong."""
    nominal, believed, errors = slices.vehicle_drive(robot.vehicle), slices.drive(robot), believed_errors(robot)
    offset, difference = robot.tag_offset, errors.wheel_gain_difference / 2.0
    values = Wheels(
        left_radius_m=believed.wheel_radius * (1.0 - difference),
        right_radius_m=believed.wheel_radius * (1.0 + difference),
        wheel_base_m=believed.wheel_base,
        motor_lag_s=believed.motor_lag,
        stop_lag_s=believed.motor_lag if errors.stop_lag_s is None else errors.stop_lag_s,
        delay_s=slices.delay_ns(config, robot) / S,
        deadband_rad_s=errors.deadband_rad_s,
        breakaway_rad_s=errors.breakaway_rad_s,
        top_speed_rad_s=nominal.max_wheel_speed * (1.0 + errors.top_speed_error),
        top_speed_sag=errors.top_speed_sag,
        slip_s_per_rad=errors.slip_s_per_rad,
        tag_forward_m=offset.forward_m,
        tag_left_m=offset.left_m,
        tag_heading_rad=math.radians(offset.heading_deg),
        left_encoder=1.0,
        right_encoder=1.0,
        encoder_offset_s=0.0,
    )
    sigma = {
        "left_radius_m": 0.1 * nominal.wheel_radius, "right_radius_m": 0.1 * nominal.wheel_radius,
        "wheel_base_m": 0.1 * nominal.wheel_base, "motor_lag_s": 0.05, "stop_lag_s": 0.05, "delay_s": 0.05,
        "deadband_rad_s": 0.4, "breakaway_rad_s": 0.4, "top_speed_rad_s": 0.1 * nominal.max_wheel_speed,
        "top_speed_sag": 0.1,
        "slip_s_per_rad": 0.03, "tag_forward_m": 0.05, "tag_left_m": 0.05, "tag_heading_rad": 2.0,
        "left_encoder": 0.05, "right_encoder": 0.05, "encoder_offset_s": 0.02,
    }  # fmt: skip
    slip = errors.slip_noise * errors.slip_s_per_rad * math.sqrt(errors.loop_period_s)
    return Prior(values, sigma, Noise(slip=max(_LEAST_WANDER, slip), way=_LEAST_WANDER))


def shots(robot: Robot, drive: RobotDrive) -> Shots:
    """Return a robot's drive, as the fit takes it."""
    errors = believed_errors(robot)
    return Shots(drive, loop_period_s=errors.loop_period_s, battery_life_s=errors.battery_life_s)
