"""Odometry by the wheels, and where it lies in the map: against exact arcs."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robofleet.core.clock import MS
from robofleet.gateways.ros2.odometry import Odometry
from robofleet.vehicles.differential_drive import DifferentialDrive, arc, wheels_from_body

DRIVE = DifferentialDrive(0.016, 0.11, 12.5, 0.2, 0.06, 100.0)
NUMBERS = st.floats(-3.0, 3.0)
POSES = st.tuples(NUMBERS, NUMBERS, NUMBERS)
STEP_NS, STEP_S = 20 * MS, 0.02


def driven(odometry: Odometry, v: float, omega: float, steps: int, *, first: int = 0, boot: int = 1) -> None:
    """Let the first robot drive an arc, and the others stand."""
    n = len(odometry.poses)
    speeds = np.zeros((n, 2))
    speeds[0] = wheels_from_body(v, omega, DRIVE.wheel_radius, DRIVE.wheel_base)
    for k in range(first, first + steps + 1):
        odometry.turned(k * STEP_NS, boot, (k - first) * STEP_S * speeds, speeds)


@given(st.floats(-0.2, 0.2), st.floats(-3.0, 3.0), st.integers(1, 100))
def test_a_robot_is_where_its_arc_ends(v: float, omega: float, steps: int) -> None:
    odometry = Odometry([DRIVE, DRIVE])
    driven(odometry, v, omega, steps)
    x, y, psi = arc(0.0, 0.0, 0.0, v, omega, steps * STEP_S)
    assert odometry.poses[0, :2] == pytest.approx((x, y), abs=1e-9)
    assert np.exp(1j * odometry.poses[0, 2]) == pytest.approx(np.exp(1j * psi), abs=1e-9)
    assert not odometry.poses[1].any()
    assert odometry.twists[0] == pytest.approx((v, omega), abs=1e-9)


def test_a_driver_that_was_started_again_moves_no_robot() -> None:
    odometry = Odometry([DRIVE])
    driven(odometry, 0.1, 0.5, 50)
    before = odometry.poses.copy()
    odometry.turned(60 * STEP_NS, 2, np.array([[-500.0, 300.0]]), np.zeros((1, 2)))
    assert (odometry.poses == before).all()
    driven(odometry, 0.1, 0.0, 10, first=61, boot=3)
    assert np.linalg.norm(odometry.poses[0, :2] - before[0, :2]) == pytest.approx(0.02)


@pytest.mark.slow
@given(POSES, st.integers(5, 40))
def test_the_map_is_corrected_by_where_a_robot_was_when_it_was_seen(pose: tuple[float, ...], seen: int) -> None:
    """The odometry is exact, so whenever the image was exposed, map -> odom is where the robot began."""
    odometry, begin = Odometry([DRIVE]), np.array(pose)
    driven(odometry, 0.1, 1.0, 60)
    corrected = np.array(arc(*begin.tolist(), 0.1, 1.0, (seen + 0.5) * STEP_S))
    odometry.seen(0, seen * STEP_NS + STEP_NS // 2, corrected)
    assert odometry.corrected[0]
    assert odometry.corrections[0, :2] == pytest.approx(begin[:2], abs=1e-4)
    assert np.exp(1j * odometry.corrections[0, 2]) == pytest.approx(np.exp(1j * begin[2]), abs=1e-4)
