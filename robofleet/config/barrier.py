"""From the configuration's tree to what the control barrier function (CBF) takes.

The controller keeps it; checks and pictures show it.
"""

from robofleet.config import obstacles, slices
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.safety.distances import Body, Keepout, apart


def keepout(config: Config) -> Keepout:
    c = config.controller
    b, pose_error_m = c.barrier, c.filter.gate_sigma * c.filter.position_noise_m  # an image further off is not used
    return Keepout(
        b.gap_m, b.ahead_m, b.rate_per_s, pose_error_m, b.age_s, c.filter.lost_after_s, c.point_ahead_m, c.tick_s,
        config.arena.size_m, obstacles.every(config.arena),
    )  # fmt: skip


def body(config: Config, robot: Robot) -> Body:
    return Body(slices.drive(robot), robot.vehicle.body_radius_m, slices.delay_ns(config, robot) / S)


def disc_radius_m(config: Config, robot: Robot) -> float:
    """Return the radius of the disc that the barrier keeps apart from other robots' of the same kind: two may touch."""
    own = body(config, robot)
    return apart(keepout(config), own, own) / 2.0
