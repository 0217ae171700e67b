"""Vehicles that are learned: how well, and what the paper's tables and the platoon become with them."""

import numpy as np
import pytest

from robofleet.behaviours.platoon import Platoon
from robofleet.config import slices
from robofleet.config.load import load_config
from robofleet.control.bicycle import bicycle_plant
from robofleet.control.learned import Polynomial, learned_plant
from robofleet.experiments.learned_platoon import LearnedPlatoon, exact_robots, robot_plant
from robofleet.experiments.model_free import DEFINITIONS, ModelFreeParameters, other_driving, run
from robofleet.experiments.paper import parameters_of
from robofleet.testing import drive, make, team
from robofleet.vehicles.bicycle import ZHOU_2017
from robofleet.vehicles.differential_drive import body_from_wheels, wheels_from_body
from tests.shipped import PLATOON

ROUND = {
    "path": {"knots": [
        {"at_m": [1.0, 0.0], "derivative_m": [0.0, 1.5]}, {"at_m": [0.0, 0.8], "derivative_m": [-1.5, 0.0]},
        {"at_m": [-1.0, 0.0], "derivative_m": [0.0, -1.5]}, {"at_m": [0.0, -0.8], "derivative_m": [1.5, 0.0]},
    ]},
    "spacing_m": 0.25, "path_rate": 0.05,
}  # fmt: skip
NOTHING = [[0.0, 0.0, 0.0]] * 3
FASTER = [[0.01, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]  # 1 cm/s beyond what is asked


@pytest.mark.slow
def test_a_minute_of_driving_tells_the_bicycles_rates() -> None:
    p: ModelFreeParameters = parameters_of("model-free")
    p = p.model_copy(update={"duration_s": 20.0})
    samples = other_driving(p, ZHOU_2017, p.speeds_m_s["closed-curve"])
    plant, unexplained = learned_plant(DEFINITIONS, samples, (2, 3, 5), (2, 3, 5), Polynomial(p.degree))
    assert (unexplained < [1e-3, 0.05, 0.05]).all()
    held_out = other_driving(p.model_copy(update={"seed": 2}), ZHOU_2017, p.speeds_m_s["closed-curve"])
    pairs, true = list(zip(held_out.x[::40], held_out.u[::40], strict=True)), bicycle_plant(ZHOU_2017)
    off = np.array([plant.f(x, u) - true.f(x, u) for x, u in pairs])
    size = np.array([true.f(x, u) for x, u in pairs])[:, [2, 3, 5]].std(axis=0)
    assert (np.median(np.abs(off[:, [2, 3, 5]]), axis=0) < 0.05 * size).all()


def test_the_exact_robots_move_as_they_were_built() -> None:
    config = load_config(PLATOON)
    v, omega, psi = 0.12, 0.7, 2.0
    for robot, beyond in zip(config.members, exact_robots(config), strict=True):
        drive, build = slices.drive(robot), slices._plant_robot(config, robot).build
        left, right = wheels_from_body(v, omega, drive.wheel_radius, drive.wheel_base)
        wheels = build.left_gain * left, build.right_gain * right
        ahead, turning = body_from_wheels(*wheels, build.wheel_radius, build.wheel_base)
        state = np.array([0.3, -0.2, psi, v, omega, *np.ravel(beyond)])
        rates = robot_plant(0.08, 0.1).f(state, np.array([v, omega + 0.08]))
        expected = [ahead * np.cos(psi), ahead * np.sin(psi), turning, 0.0, 1.0]
        assert rates[:5] == pytest.approx(expected, abs=1e-9)
        assert not rates[5:].any()


@pytest.mark.slow
def test_the_flow_drives_robots_on_the_path_and_asks_those_for_less_that_do_more() -> None:
    kinds = {"eq. 31": (Platoon, {}), "same": (LearnedPlatoon, {"beyond": [NOTHING] * 2}),
             "faster": (LearnedPlatoon, {"beyond": [FASTER] * 2})}  # fmt: skip
    last = {}
    for name, (behaviour, more) in kinds.items():
        made = make(behaviour, ROUND | more, team(2))
        last[name] = drive(made, np.array(made.places()), 10.0).points[-1]
    assert last["same"] == pytest.approx(last["eq. 31"], abs=2e-3)
    behind = np.linalg.norm(last["faster"] - last["same"], axis=1)
    assert behind[0] == pytest.approx(0.01 * 0.6, rel=0.3)  # T w, as these robots do as they are asked


@pytest.mark.long
def test_the_tables_and_the_platoon_with_learned_vehicles() -> None:
    data = run(parameters_of("model-free")).data
    assert data["worst_apart"] < 0.2
    errors = data["platoon_control_error_mm"]
    assert errors["learned"] < min(0.5, 1.2 * errors["exact"])
