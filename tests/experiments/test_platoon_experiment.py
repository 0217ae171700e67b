"""Row 8 in simulation, and how errors travel along a platoon."""

import pytest

from robofleet.config.files.parameters import load_parameters
from robofleet.config.load import load_config
from robofleet.experiments.paper import SHIPPED
from robofleet.experiments.platoon import PlatoonParameters, run, scaled
from robofleet.experiments.platoon_gain import robot_gains
from robofleet.runs.check import refusals

PARAMETERS = load_parameters(PlatoonParameters, SHIPPED / "platoon.yaml")
BASE = load_config(SHIPPED.parent / "platoon.yaml")


@pytest.mark.parametrize("robots", PARAMETERS.sizes)
def test_a_scaled_platoon_can_run(robots: int) -> None:
    config = scaled(PARAMETERS, BASE, robots, "exact")
    assert refusals(config, lockstep=True) == []
    assert len(config.members) == robots


def test_the_exact_integrator_does_not_amplify() -> None:
    slow = PARAMETERS.gain.model_copy(update={"robots": 8, "periods": (1, 4, 10, 20)})
    gains = robot_gains(slow.model_copy(update={"period_s": 20.0}), BASE, "exact")
    gains_used = [gain for gain in gains if gain is not None]
    assert len(gains_used) == 4
    assert max(gains_used) <= 1.02  # for the newest u, robot by robot
    assert min(gains_used) > 0.9  # nothing was lost either: the sines came through


def test_euler_amplifies_what_is_fast() -> None:
    fast = PARAMETERS.gain.model_copy(update={"robots": 6, "periods": (100, 280), "period_s": 20.0})
    exact, euler = (robot_gains(fast, BASE, integrator) for integrator in ("exact", "euler"))
    assert euler[1] is not None
    assert exact[1] is not None
    assert euler[1] > 1.2 > exact[1]


@pytest.mark.long
def test_noise_stays_small_along_sixteen_robots_with_exact_and_not_with_euler() -> None:
    small = PARAMETERS.model_copy(
        update={
            "sizes": (16,),
            "duration_s": 10.0,
            "settle_s": 4.0,
            "gain": PARAMETERS.gain.model_copy(update={"robots": 3, "periods": (4,), "period_s": 8.0}),
        }
    )
    result = run(small)
    errors = result.data["control_error_mm"]
    assert errors["exact 16"][-1] < 1.3 * errors["exact 16"][0]
    assert errors["euler 16"][-1] > 3 * errors["euler 16"][0]
