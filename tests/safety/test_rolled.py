"""What a stroke proves: every wiring by name, and a gain that is a fifth off from one that is a robot's own."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robofleet.safety.rolled import Leg, Wheels, gain_fault, mean_of, rolled, wiring_fault
from robofleet.safety.supervisor import Event
from robofleet.vehicles.differential_drive import arc, body_from_wheels

RADIUS, BASE = 0.016, 0.105
FORTH: Wheels = (1.5, 0.9)  # about what a stroke gives [rad]
BACK: Wheels = (-1.5, -0.9)
WIRINGS = {
    "straight": (lambda l, r: (l, r), None),
    "swapped": (lambda l, r: (r, l), Event.WHEELS_SWAPPED),
    "swapped, left reversed": (lambda l, r: (-r, l), Event.WHEELS_SWAPPED),
    "swapped, right reversed": (lambda l, r: (r, -l), Event.WHEELS_SWAPPED),
    "tag the wrong way round": (lambda l, r: (-r, -l), Event.WHEELS_SWAPPED),
    "left reversed": (lambda l, r: (-l, r), Event.LEFT_REVERSED),
    "right reversed": (lambda l, r: (l, -r), Event.RIGHT_REVERSED),
    "both reversed": (lambda l, r: (-l, -r), Event.BOTH_REVERSED),
    "left stands": (lambda l, r: (0.0, r), Event.DID_NOT_MOVE),
    "right stands": (lambda l, r: (l, 0.0), Event.DID_NOT_MOVE),
    "both stand": (lambda l, r: (0.0, 0.0), Event.DID_NOT_MOVE),
}
angles = st.floats(-3.0, 3.0)


def after(before: tuple[float, float, float], wheels: Wheels, base: float = BASE) -> tuple[float, float, float]:
    """Return where a robot ends whose wheels roll so far [rad]: the vehicle's own equations."""
    return arc(*before, *body_from_wheels(*wheels, RADIUS, base), 1.0)


@given(st.tuples(angles, angles), st.tuples(st.floats(-2.0, 2.0), st.floats(-1.0, 1.0), st.floats(-math.pi, math.pi)))
def test_what_was_rolled_is_found_from_two_poses(wheels: Wheels, before: tuple[float, float, float]) -> None:
    assert rolled(before, after(before, wheels), RADIUS, BASE) == pytest.approx(wheels, abs=1e-9)


@pytest.mark.parametrize("wiring", list(WIRINGS))
def test_every_wiring_is_named(wiring: str) -> None:
    wires, event = WIRINGS[wiring]
    fault = wiring_fault(Leg(FORTH, FORTH, wires(*FORTH)))
    assert fault == (None if event is None else (event, 0.0))


@pytest.mark.slow_after_first
@pytest.mark.parametrize("wiring", list(WIRINGS))
@pytest.mark.parametrize("wheels", [FORTH, BACK])
@given(gain=st.floats(0.75, 1.3), errors=st.tuples(st.floats(-0.075, 0.075), st.floats(-0.075, 0.075)))
def test_every_wiring_is_named_whatever_the_gain_and_the_noise(
    wiring: str, wheels: Wheels, gain: float, errors: Wheels
) -> None:
    """Errors of four sigmas of one stroke."""
    wires, event = WIRINGS[wiring]
    left, right = wires(*wheels)
    fault = wiring_fault(Leg(wheels, wheels, (gain * left + errors[0], gain * right + errors[1])))
    assert (None if fault is None else fault[0]) == event


@pytest.mark.parametrize(
    "counts", [(-1.0, 1.0), (1.0, -1.0), (0.0, 1.0), (1.0, 0.0), (0.6, 1.0), (1.0, 1.4), (0.6, 1.67)]
)
def test_an_encoder_that_does_not_count_what_its_wheel_turns_is_found(counts: Wheels) -> None:
    """The last one: left and right exchanged."""
    counted = counts[0] * FORTH[0], counts[1] * FORTH[1]
    fault = wiring_fault(Leg(FORTH, counted, FORTH))
    assert fault is not None
    assert fault[0] is Event.ENCODER_WRONG
    assert fault[1] == pytest.approx(max(counts, key=lambda c: abs(c - 1.0)))


@pytest.mark.parametrize("counts", [(1.0, 1.0), (0.7, 0.7), (1.3, 1.3), (0.0, 0.0)])
def test_encoders_that_count_about_what_was_asked_or_nothing_are_no_fault(counts: Wheels) -> None:
    assert wiring_fault(Leg(FORTH, (counts[0] * FORTH[0], counts[1] * FORTH[1]), FORTH)) is None


@pytest.mark.parametrize("counts", [(0.0, 0.0), (0.5, -0.5)])
def test_wheels_that_were_told_nothing_yet_have_no_fault(counts: Wheels) -> None:
    """Somebody pushes the robot at the beginning of its stroke."""
    assert wiring_fault(Leg((0.0, 0.0), counts, (0.5, -0.5))) is None


def test_an_encoder_at_its_tolerance_passes() -> None:
    assert wiring_fault(Leg((2.0, 1.0), (1.3, 1.0), (2.0, 1.0))) is None


def leg(mean: float, *, left: float = 1.0, right: float = 1.0, counted: bool = True) -> Leg:
    return Leg(FORTH, FORTH if counted else (0.0, 0.0), (mean * left * FORTH[0], mean * right * FORTH[1]))


@pytest.mark.parametrize(
    ("bad", "good"),
    [
        (leg(0.875), leg(0.885)),
        (leg(1.125), leg(1.115)),
        (leg(1.0, left=0.865), leg(1.0, left=0.875)),
        (leg(1.0, right=1.135), leg(1.0, right=1.125)),
        (leg(0.845, counted=False), leg(0.855, counted=False)),
        (leg(1.155, counted=False), leg(1.145, counted=False)),
        (leg(1.0, right=0.845, counted=False), leg(1.0, right=0.855, counted=False)),
    ],
)
def test_a_gain_is_refused_beyond_its_tolerance(bad: Leg, good: Leg) -> None:
    assert gain_fault(good) is None
    fault = gain_fault(bad)
    assert fault is not None
    assert fault[0] is Event.WRONG_GAIN
    ratios = [a / b for a, b in zip(bad.rolled, FORTH, strict=True)]
    assert min(ratios) - 1e-9 <= fault[1] <= max(ratios) + 1e-9


@pytest.mark.parametrize("just", [(0.88, 0.88), (0.87, 1.0), (1.0, 0.87)])
def test_a_gain_at_its_tolerance_passes(just: Wheels) -> None:
    assert gain_fault(Leg((1.0, 1.0), (1.0, 1.0), just)) is None


def test_a_gain_is_measured_against_what_the_wheels_turned() -> None:
    """Commands that came late are no fault of the wheels."""
    late = (0.8 * FORTH[0], 0.8 * FORTH[1])
    assert gain_fault(Leg(FORTH, late, late)) is None


def test_forth_and_back_are_one_stroke_measured_twice() -> None:
    assert mean_of(Leg(FORTH, FORTH, (1.6, 1.0)), Leg(BACK, BACK, (-1.4, -0.8))) == (FORTH, FORTH, pytest.approx(FORTH))


def wiggled(rng: np.random.Generator, error: float, error_right: float) -> Leg:
    """Return both strokes of a robot as GTernal's, with the images' noise."""
    left, right = 1.0 + error + rng.uniform(-0.03, 0.03), 1.0 + error_right + rng.uniform(-0.03, 0.03)
    base = BASE * (1.0 + rng.uniform(-0.01, 0.01))
    slip = 1.0 - 0.02 * 0.37  # at 0.37 rad/s of turning
    noise = np.array([0.0003, 0.0003, 0.004]) / math.sqrt(3.0)
    poses = [(0.0, 0.0, 0.0)]
    for wheels in (FORTH, BACK):
        poses.append(after(poses[-1], (slip * left * wheels[0], slip * right * wheels[1]), base))
    a, b, c = (tuple(pose + noise * rng.standard_normal(3)) for pose in poses)
    return mean_of(
        Leg(FORTH, FORTH, rolled(a, b, RADIUS, BASE)),  # type: ignore[arg-type]
        Leg(BACK, BACK, rolled(b, c, RADIUS, BASE)),  # type: ignore[arg-type]
    )


def refused(error: float, error_right: float, seed: int) -> float:
    rng = np.random.default_rng(seed)
    return float(np.mean([gain_fault(wiggled(rng, error, error_right)) is not None for _ in range(3000)]))


@pytest.mark.slow
def test_no_healthy_robot_is_refused_and_none_that_is_a_fifth_off_passes() -> None:
    assert refused(0.0, 0.0, 1) == 0.0
    for error in (0.2, -0.2, 1 / 1.2 - 1):
        assert refused(error, error, 2) == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("scales", [(0.2, 0.0), (0.0, 0.2), (-0.2, 0.0), (0.0, -0.2)])
def test_one_wheel_that_is_a_fifth_off_is_found_nearly_always(scales: tuple[float, float]) -> None:
    assert refused(*scales, 3) > 0.97
