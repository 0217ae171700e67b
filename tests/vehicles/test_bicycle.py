"""The dynamic bicycle against eqs 16-22 and its Jacobians against differences."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.core.arrays import Array
from robofleet.vehicles import bicycle
from robofleet.vehicles.bicycle import FALCONE_2007, ZHOU_2017, BicycleParameters

EXACT = settings(deadline=None, derandomize=True, max_examples=60)
STATES = st.tuples(
    st.floats(-50, 50), st.floats(-50, 50), st.floats(2, 30), st.floats(-2, 2), st.floats(-4, 4), st.floats(-1, 1)
).map(np.array)
INPUTS = st.tuples(st.floats(-3, 3), st.floats(-0.5, 0.5)).map(np.array)
VEHICLES = st.sampled_from((ZHOU_2017, FALCONE_2007))


def differences(function, at: Array) -> Array:
    """Fourth-order central differences, one column a variable."""
    columns = []
    for k in range(len(at)):
        e = np.zeros(len(at))
        e[k] = 1e-3
        f1, f2 = function(at + e) - function(at - e), function(at + 2 * e) - function(at - 2 * e)
        columns.append((8 * f1 - f2) / 12e-3)
    return np.stack(columns, axis=1)


def test_parameters_are_the_papers() -> None:
    assert BicycleParameters(1587, 2315.3, 1.218, 1.628, 35000, 35000) == ZHOU_2017
    assert BicycleParameters(2050, 3344, 1.105, 1.738, 57500, 92500) == FALCONE_2007


@EXACT
@given(STATES, INPUTS, VEHICLES)
def test_derivative_is_the_printed_one(x: Array, u: Array, vehicle: BicycleParameters) -> None:
    v_l, v_n, psi, rate = x[2:]
    front = vehicle.front_stiffness * (u[1] - math.atan((v_n + vehicle.front_axle * rate) / v_l))
    rear = -vehicle.rear_stiffness * math.atan((v_n - vehicle.rear_axle * rate) / v_l)
    rotation = np.array([[math.cos(psi), -math.sin(psi)], [math.sin(psi), math.cos(psi)]])
    dx = bicycle.derivative(x, u, vehicle.numbers())
    assert dx[:2] == pytest.approx(rotation @ [v_l, v_n])
    assert dx[2] == pytest.approx(rate * v_n + u[0])
    lateral = 2 * (front * math.cos(u[1]) + rear) / vehicle.mass
    assert dx[3] == pytest.approx(-rate * v_l + lateral)
    assert dx[4] == rate
    moment = vehicle.front_axle * front * math.cos(u[1]) - vehicle.rear_axle * rear
    assert dx[5] == pytest.approx(2 * moment / vehicle.yaw_inertia)


@EXACT
@given(STATES, INPUTS, VEHICLES)
def test_jacobians_are_the_derivatives(x: Array, u: Array, vehicle: BicycleParameters) -> None:
    p = vehicle.numbers()
    for analytic, numeric in (
        (bicycle.state_jacobian(x, u, p), differences(lambda z: bicycle.derivative(z, u, p), x)),
        (bicycle.input_jacobian(x, u, p), differences(lambda w: bicycle.derivative(x, w, p), u)),
    ):
        assert np.abs(analytic - numeric).max() <= 1e-6 * np.abs(numeric).max()


def test_steering_left_turns_left() -> None:
    x, u = np.array([0.0, 0.0, 10.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.05])
    assert bicycle.derivative(x, u, FALCONE_2007.numbers())[5] > 0.0


@pytest.mark.parametrize("vehicle", [ZHOU_2017, FALCONE_2007])
@pytest.mark.parametrize("speed", [1.0, 4.2, 10.0, 19.0, 40.0])
def test_fastest_rate_is_the_largest_eigenvalue(vehicle: BicycleParameters, speed: float) -> None:
    x, u = np.array([3.0, 1.0, speed, 0.02, 0.3, 0.02]), np.array([0.1, 0.01])
    eigenvalues = np.linalg.eigvals(bicycle.state_jacobian(x, u, vehicle.numbers()))
    assert bicycle.fastest_rate(x, u, vehicle.numbers()) == pytest.approx(np.abs(eigenvalues).max(), rel=0.01)


def test_output_is_the_position() -> None:
    x = np.arange(6.0)
    assert (bicycle.position(x) == bicycle.position_jacobian(x) @ x).all()
    assert bicycle.position(x).tolist() == [0.0, 1.0]
