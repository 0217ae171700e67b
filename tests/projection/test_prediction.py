"""Where robots will be when the light falls."""

import numpy as np
import pytest

from robofleet.projection.prediction import ahead
from robofleet.vehicles.differential_drive import arc


def test_robots_go_on_along_their_arcs() -> None:
    """Straight on, slowly and fast turning, backwards, and past pi."""
    poses = np.array([[0.1, -0.2, 0.3], [0.0, 0.0, 3.1], [1.0, 1.0, -2.0], [0.5, 0.5, 1.0]])
    speeds = np.array([[0.2, 0.0], [0.1, 2.0], [0.2, 1e-7], [-0.1, -30.0]])
    for seconds in (0.0, 0.05, 1.0, -0.5):
        exact = [arc(x, y, psi, v, omega, seconds) for x, y, psi, v, omega in np.hstack([poses, speeds]).tolist()]
        assert ahead(poses, speeds, seconds) == pytest.approx(np.array(exact), abs=1e-9)


def test_each_robot_may_have_an_age_of_its_own() -> None:
    poses, speeds = np.zeros((2, 3)), np.array([[0.2, 0.0], [0.2, 0.0]])
    assert ahead(poses, speeds, np.array([1.0, 2.0]))[:, 0] == pytest.approx([0.2, 0.4])
