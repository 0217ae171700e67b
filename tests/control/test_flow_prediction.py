"""The predicted output and its sensitivity against complex steps; the number of prediction steps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.control.arrays import compiled, invert
from robofleet.control.bicycle import bicycle_plant
from robofleet.control.flow import Plant
from robofleet.control.prediction import compile_plant, spectral_radius_bound
from robofleet.core.arrays import Array
from robofleet.vehicles import bicycle
from robofleet.vehicles.bicycle import FALCONE_2007

EXACT = settings(deadline=None, derandomize=True, max_examples=40)
BY_HAND = bicycle_plant(FALCONE_2007)
DIFFERENCES = Plant(BY_HAND.f, BY_HAND.h, 6, 2)
STATES = st.tuples(
    st.floats(-200, 200),
    st.floats(-200, 200),
    st.floats(8, 30),
    st.floats(-1, 1),
    st.floats(-4, 4),
    st.floats(-0.5, 0.5),
).map(np.array)
INPUTS = st.tuples(st.floats(-3, 3), st.floats(-0.3, 0.3)).map(np.array)


def slope(x, u):
    """Eqs 16-22 for complex numbers."""
    m, inertia, l_f, l_r, c_f, c_r = FALCONE_2007.numbers()
    _, _, v_l, v_n, psi, rate = x
    front = c_f * (u[1] - np.arctan((v_n + l_f * rate) / v_l)) * np.cos(u[1])
    rear = -c_r * np.arctan((v_n - l_r * rate) / v_l)
    position = [v_l * np.cos(psi) - v_n * np.sin(psi), v_l * np.sin(psi) + v_n * np.cos(psi)]
    lateral = -rate * v_l + 2 * (front + rear) / m
    return np.array([*position, rate * v_n + u[0], lateral, rate, 2 * (l_f * front - l_r * rear) / inertia])


def output(x, u, T, steps, euler):
    x, h = x.astype(complex), T / steps
    for _ in range(steps):
        k1 = slope(x, u)
        if euler:
            x = x + h * k1
            continue
        k2 = slope(x + h / 2 * k1, u)
        k3 = slope(x + h / 2 * k2, u)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + slope(x + h * k3, u))
    return x[:2]


def by_complex_step(x, u, T, steps, euler=False) -> tuple[Array, Array]:
    columns = [output(x, u + 1e-30j * e, T, steps, euler).imag / 1e-30 for e in np.eye(2)]
    return output(x, u.astype(complex), T, steps, euler).real, np.stack(columns, axis=1)


@EXACT
@given(STATES, INPUTS, st.floats(0.05, 0.6))
@pytest.mark.long
def test_by_hand_and_with_jacobians_are_exact(x: Array, u: Array, T: float) -> None:
    g, sensitivity = by_complex_step(x, u, T, 12)
    y, dg = np.empty(2), np.empty((2, 2))
    for predict in (
        lambda: compiled_by_hand(x, u, T, 12, y, dg),
        lambda: compile_plant(BY_HAND).predict(x, u, np.zeros(6), T, 12, False, y, dg),
    ):
        y[:], dg[:] = np.nan, np.nan
        assert predict() == 0
        assert y == pytest.approx(g, rel=1e-12, abs=1e-11)
        assert np.abs(dg - sensitivity).max() <= 1e-11 * np.abs(sensitivity).max()


compiled_by_hand = compiled(BY_HAND.fused)


@EXACT
@given(STATES, INPUTS, st.floats(0.05, 0.6), st.booleans())
@pytest.mark.long
def test_without_jacobians_each_column_is_right_to_1e_6(x: Array, u: Array, T: float, euler: bool) -> None:
    steps = 100 if euler else 12
    g, sensitivity = by_complex_step(x, u, T, steps, euler)
    y, dg = np.empty(2), np.empty((2, 2))
    assert compile_plant(DIFFERENCES).predict(x, u, np.zeros(6), T, steps, euler, y, dg) == 0
    assert y == pytest.approx(g, rel=1e-12, abs=1e-11)
    assert (np.abs(dg - sensitivity).max(axis=0) <= 1e-6 * np.abs(sensitivity).max(axis=0)).all()


@pytest.mark.slow
def test_five_steps_are_within_half_a_millimetre_of_500_of_the_papers() -> None:
    x, u, y, dg = np.array([0.0, 0, 19, 0.1, 0.05, 0.1]), np.array([0.3, 0.02]), np.empty(2), np.empty((2, 2))
    assert compiled_by_hand(x, u, 0.5, 5, y, dg) == 0
    fine = output(x, u, 0.5, 2000, False).real
    assert np.abs(y - fine).max() < 5e-4


@pytest.mark.slow
@pytest.mark.parametrize("predict", ["by hand", pytest.param("general", marks=pytest.mark.long)])
def test_an_eigenvalue_that_grows_on_the_way_asks_for_more_steps(predict: str) -> None:
    x, u, y, dg = np.array([0.0, 0, 10, 0, 0, 0]), np.array([-15.0, 0.0]), np.empty(2), np.empty((2, 2))
    found = (
        compiled_by_hand(x, u, 0.6, 5, y, dg)
        if predict == "by hand"
        else compile_plant(BY_HAND).predict(x, u, np.zeros(6), 0.6, 5, False, y, dg)
    )
    at_end = bicycle.fastest_rate(np.array([0.0, 0, 1, 0, 0, 0]), u, FALCONE_2007.numbers())
    assert found == -np.ceil(0.6 * at_end / 2.7)


matrix_bound = spectral_radius_bound(compiled(lambda x, u: x.reshape(4, 4).copy()))


@pytest.mark.slow
@EXACT
@given(st.integers(0, 10_000), st.floats(1e-6, 1e6))
def test_the_bound_holds_and_is_near(seed: int, scale: float) -> None:
    a = scale * np.random.default_rng(seed).standard_normal((4, 4))
    radius = np.abs(np.linalg.eigvals(a)).max()
    assert radius * (1 - 1e-9) <= matrix_bound(a.ravel(), np.zeros(1)) <= 2.0 * radius


@pytest.mark.slow
def test_integrators_are_not_fast() -> None:
    assert matrix_bound(np.triu(np.full((4, 4), 1e5), 1).ravel(), np.zeros(1)) == 0.0


@EXACT
@given(st.integers(1, 6), st.integers(0, 10_000))
def test_inverse_whatever_the_units(m: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    a = rng.standard_normal((m, m)) * 10.0 ** rng.integers(-8, 9, m)
    inverse, condition = a.copy(), invert(rng.standard_normal((m, m)), np.empty(3 * m))
    scaled = invert(inverse, np.empty(3 * m))
    assert condition >= 1.0 - 1e-12
    assert np.abs(a @ inverse - np.eye(m)).max() <= 1e-10 * max(scaled, 1.0)
    bare = a / np.abs(a).max(axis=1, keepdims=True)
    bare /= np.abs(bare).max(axis=0)
    assert scaled == pytest.approx(np.linalg.cond(bare, 1), rel=1e-6)


@pytest.mark.parametrize("a", [np.zeros((2, 2)), np.array([[1.0, 2], [2, 4]]), np.array([[0.0, 1], [0, 2]])])
def test_singular_is_infinite(a: Array) -> None:
    assert invert(a.copy(), np.empty(6)) == np.inf
