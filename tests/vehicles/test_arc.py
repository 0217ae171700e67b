"""Motion at constant body velocity is an arc."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.vehicles.differential_drive import arc

EXACT = settings(deadline=None, derandomize=True)
metres = st.floats(-2.0, 2.0)
heading = st.floats(-math.pi, math.pi, exclude_min=True)
speed = st.floats(-1.0, 1.0)
yaw_rate = st.floats(-6.0, 6.0)
seconds = st.floats(0.0, 2.0)


def apart(a: tuple[float, float, float], b: tuple[float, float, float]) -> float:
    """Return the largest difference of two poses, headings modulo a turn."""
    return max(abs(a[0] - b[0]), abs(a[1] - b[1]), abs(math.remainder(a[2] - b[2], math.tau)))


@pytest.mark.slow
@EXACT
@given(metres, metres, heading, speed, yaw_rate.filter(lambda w: abs(w) > 0.05), seconds)
def test_it_is_the_circle_about_its_centre(
    x: float, y: float, psi: float, v: float, omega: float, duration: float
) -> None:
    rho, end = v / omega, psi + omega * duration
    circle = x + rho * (math.sin(end) - math.sin(psi)), y - rho * (math.cos(end) - math.cos(psi)), end
    assert apart(arc(x, y, psi, v, omega, duration), circle) < 1e-12


@pytest.mark.parametrize("omega", [0.0, 1e-9, -1e-4, 0.3, -2.0])
def test_fine_euler_steps_converge_to_it(omega: float) -> None:
    n, v, duration = 20_000, 0.15, 1.0
    x = y = psi = 0.0
    for _ in range(n):
        middle = psi + omega * duration / n / 2
        x += v * duration / n * math.cos(middle)
        y += v * duration / n * math.sin(middle)
        psi += omega * duration / n
    assert apart(arc(0.0, 0.0, 0.0, v, omega, duration), (x, y, psi)) < 1e-9


@EXACT
@given(metres, metres, heading, speed, yaw_rate, seconds, st.floats(0.0, 1.0))
def test_two_pieces_make_the_whole(
    x: float, y: float, psi: float, v: float, omega: float, duration: float, fraction: float
) -> None:
    first = arc(x, y, psi, v, omega, fraction * duration)
    both = arc(*first, v, omega, (1 - fraction) * duration)
    assert apart(both, arc(x, y, psi, v, omega, duration)) < 1e-12


@EXACT
@given(heading, st.floats(-20.0, 20.0))
def test_heading_stays_in_its_range(psi: float, turn: float) -> None:
    result = arc(0.0, 0.0, psi, 0.0, turn, 1.0)[2]
    assert -math.pi < result <= math.pi
    assert math.remainder(result - psi - turn, math.tau) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("psi", [math.pi, -math.pi])
def test_backwards_is_plus_pi(psi: float) -> None:
    assert arc(0.0, 0.0, psi, 0.1, 0.0, 0.1)[2] == math.pi
