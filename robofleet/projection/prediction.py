"""Where robots will be when the light of a picture falls: the projector takes its time, and poses have an age."""

import math

import numpy as np

from robofleet.core.arrays import Array


def ahead(poses: Array, speeds: Array, seconds: float | Array) -> Array:
    """Return the poses (N, 3) of robots that go on for some seconds, one for all or one each (N,), along exact arcs.

    Args:
        poses: x, y [m], psi [rad] (N, 3), now.
        speeds: v [m/s] and omega [rad/s] (N, 2), constant meanwhile.
        seconds: May be negative.

    Returns:
        x, y [m], psi [rad; (-pi, pi]].
    """
    turn = speeds[:, 1] * seconds
    chord = speeds[:, 0] * seconds * np.sinc(turn / math.tau)  # numpy's: sin(turn / 2) / (turn / 2)
    middle, psi = poses[:, 2] + turn / 2.0, poses[:, 2] + turn
    psi -= math.tau * np.ceil((psi - math.pi) / math.tau)
    return np.column_stack([poses[:, 0] + chord * np.cos(middle), poses[:, 1] + chord * np.sin(middle), psi])
