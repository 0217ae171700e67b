"""The discs of constant grey in which projectors leave robots' tags: light that changes there moves a tag's edges."""

import math

import numpy as np

from robofleet.config.tree import Config
from robofleet.core.arrays import Array

_MARGIN_M = 0.02  # errors of pose, prediction and projector, and the blur of projector and camera
_PAPER = 1.25  # sides of a tag's paper: a cell around the black square


def disc_radii(config: Config) -> Array:
    """Return the radius (N,) [m] of the disc around each robot, in the bodies' order: body and tag, and a margin."""
    tag = math.sqrt(0.5) * _PAPER * config.tracker.tag_side_m
    return np.array([max(robot.vehicle.body_radius_m, tag) + _MARGIN_M for robot in config.bodies])
