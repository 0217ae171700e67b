"""The comparison's controllers, its loop, and what it says in words."""

import importlib.util
import math
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from robofleet.experiments import comparison
from robofleet.experiments.baselines import geometric
from robofleet.experiments.baselines.choice import MissingLibraryError, build
from robofleet.experiments.baselines.problem import Conditions, RollForward, drive
from robofleet.experiments.curves import Reference
from robofleet.experiments.paper import parameters_of
from robofleet.vehicles.bicycle import FALCONE_2007


def installed(*modules):
    missing = [name for name in modules if importlib.util.find_spec(name) is None]
    return pytest.mark.skipif(bool(missing), reason=f"pip install -e '.[bench]': {missing}")


pytestmark = pytest.mark.long  # the peers' controllers, not ours


@pytest.fixture(scope="module")
def parameters():
    return parameters_of("comparison")


@pytest.fixture(scope="module")
def problem(parameters):
    return parameters.lane_change(19.0)


@pytest.fixture(scope="module")
def quick(parameters):
    trouble = parameters.trouble.model_copy(update={"delays_s": (0.1,)})
    controllers = ("flow", "flow-paper", "lqr", "pure-pursuit", "stanley")
    changes = {"controllers": controllers, "speeds_m_s": (19.0,), "trouble": trouble}
    return comparison.run(parameters.model_copy(update=changes))


def rows(table):
    return {row["controller"]: row for row in table.as_dict()["rows"]}


def test_the_prototypes_errors_are_found_again(quick):
    errors = rows(quick.tables[0])
    assert errors["NR flow T 0.5"]["lateral cm, 19 m/s"] == pytest.approx(25.4, abs=0.1)
    assert errors["NR flow T 0.15"]["lateral cm, 19 m/s"] <= 1.0
    assert errors["LQR feed-forward"]["lateral cm, 19 m/s"] == pytest.approx(0.25, abs=0.05)


def test_a_known_delay_rolled_forward_changes_nothing(quick):
    errors, trouble = rows(quick.tables[0]), rows(quick.tables[2])
    for name in ("NR flow T 0.15", "LQR feed-forward", "Stanley"):
        undelayed = errors[name]["lateral cm, 19 m/s"]
        assert trouble[name]["100 ms, rolled"] == pytest.approx(undelayed, abs=1e-3)
    assert trouble["NR flow T 0.15"]["100 ms"] == "lost"
    assert any(note.startswith("NR flow T 0.15: lost: 100 ms at ") for note in quick.tables[2].notes)


@pytest.mark.parametrize(
    ("number", "column", "what"),
    [
        (0, "lateral cm, 19 m/s", "peak error at 19 m/s: "),
        (1, "p50 µs", "time per update: "),
        (2, "soft tyres", "soft tyres: better"),
        (3, "lateral cm", "peak error: "),
    ],
)
def test_the_notes_name_the_baselines_that_are_better_and_no_others(quick, number, column, what):
    table = quick.tables[number]
    (note,) = (note for note in table.notes if note.startswith(what))
    values = {name: row[column] for name, row in rows(table).items()}
    ours = values["NR flow T 0.15"]
    for name in ("LQR feed-forward", "pure pursuit", "Stanley"):
        assert (name in note) == (values[name] < 0.98 * ours), note


def test_where_our_flow_is_lost_the_notes_say_who_is_not(quick):
    (note,) = (note for note in quick.tables[2].notes if note.startswith("100 ms: "))
    assert note.startswith("100 ms: our flow is lost, not so: Stanley (")
    assert "LQR" not in note


def test_a_controller_that_drives_off_is_lost(problem):
    class Left:
        name = "left"

        def update(self, t, x):
            return -9.0, 1.0

    found = drive(problem, Left(), Conditions(FALCONE_2007), 60.0)
    assert "from the reference's point" in found.failure
    assert math.isnan(found.peak_lateral_cm) and math.isnan(found.peak_steering_rate_deg_s)
    assert len(found.t) == len(found.states) == len(found.inputs)
    assert (found.inputs == (-problem.max_acceleration, problem.max_steering)).all()


def test_a_controller_that_fails_ends_its_drive(problem):
    class Fails:
        name = "fails"

        def update(self, t, x):
            if t > 0.1:
                raise ValueError("no solution")
            return 0.0, 0.0

    found = drive(problem, Fails(), Conditions(FALCONE_2007), 60.0)
    assert found.failure == "at 0.11 s: no solution"


def test_roll_forward_gives_the_state_at_which_the_input_acts(problem):
    seen = []

    class Watches:
        name = "watches"

        def update(self, t, x):
            seen.append((t, x))
            return 0.1, 0.01 * math.sin(3.0 * t)

    found = drive(problem, RollForward(Watches(), problem, 4), Conditions(FALCONE_2007, delay=4), 40.0)
    for k in range(len(found.t) - 4):
        assert seen[k][0] == pytest.approx(found.t[k + 4])
        np.testing.assert_allclose(seen[k][1], found.states[k + 4], rtol=0.0, atol=1e-6)


def test_the_riccati_iteration_finds_the_golden_ratio():
    identity = np.eye(1)
    assert geometric.lqr(identity, identity, identity)[0] == pytest.approx((math.sqrt(5.0) - 1.0) / 2.0)
    with pytest.raises(ValueError, match="does not settle"):
        geometric.lqr(2.0 * identity, 0.0 * identity, identity)


def test_the_curvature_feed_forward_leaves_no_error_on_a_circle(problem):
    radius, samples = 200.0, 20_000
    angle = np.linspace(0.0, math.tau, samples + 1)
    positions = radius * np.column_stack([np.sin(angle), 1.0 - np.cos(angle)])
    circle = Reference(positions, angle, math.tau * radius / samples, closed=True)
    around = replace(problem, reference=circle, speed=15.0)
    law = geometric.CurvatureLqr(around, 2.0, (10.0, 0.0, 1.0, 0.0))
    found = drive(around, law, Conditions(FALCONE_2007), 200.0)
    assert np.abs(found.lateral[-200:]).max() < 1e-3
    slip = found.states[-1, 3] / found.states[-1, 2]
    assert found.heading[-1] == pytest.approx(-slip, abs=1e-4)


def states_of(problem, parameters):
    found = drive(problem, build("lqr", parameters.laws, problem, 0), Conditions(FALCONE_2007), 60.0)
    return found.t[150:300:10], found.states[150:300:10]


@installed("osqp", "scipy")
def test_the_linearisation_is_the_derivative_of_the_rollout(problem):
    from robofleet.experiments.baselines.mpc_osqp import linearised

    rng = np.random.default_rng(1)
    x, p, h = problem.start() + 0.1 * rng.normal(size=6), FALCONE_2007.numbers(), 0.05
    U = rng.normal(0.0, (0.5, 0.02), (20, 2))
    z, G = linearised(x, U, p, h)
    for column in (0, 1, 7, 38, 39):
        step = np.zeros(40)
        step[column] = 1e-5
        above, below = (linearised(x, U + sign * step.reshape(-1, 2), p, h)[0] for sign in (1.0, -1.0))
        np.testing.assert_allclose(G[:, column], (above - below) / 2e-5, rtol=1e-6, atol=1e-7)
    steps = np.array([z[2 * k : 2 * k + 2] for k in range(20)])
    assert np.all(np.diff(steps[:, 0]) > 0.5)


@installed("osqp", "scipy", "casadi", "do_mpc")
def test_the_four_predictive_controllers_solve_one_problem(problem, parameters):
    times, states = states_of(problem, parameters)
    inputs = {}
    for key in ("ipopt", "fatrop", "do-mpc", "osqp"):
        controller = build(key, parameters.laws, problem, 0)
        inputs[key] = np.array([controller.update(t, x) for t, x in zip(times.tolist(), states, strict=True)])
        assert controller.failures == 0
    scale = np.abs(inputs["ipopt"]).max(axis=0)
    for key, bound in (("fatrop", 1e-4), ("do-mpc", 0.02), ("osqp", 0.1)):
        assert (np.abs(inputs[key] - inputs["ipopt"]) / scale).max() < bound, key


@installed("osqp", "scipy")
def test_predictive_control_reaches_the_prototypes_error(problem, parameters):
    found = drive(problem, build("osqp", parameters.laws, problem, 0), Conditions(FALCONE_2007), parameters.drive_m)
    assert found.peak_lateral_cm == pytest.approx(1.0, abs=0.1)
    assert found.failure == ""


def test_a_missing_library_is_named_with_the_command_that_installs_it(parameters, problem, monkeypatch):
    monkeypatch.setitem(sys.modules, "osqp", None)
    monkeypatch.delitem(sys.modules, "robofleet.experiments.baselines.mpc_osqp", raising=False)
    with pytest.raises(MissingLibraryError, match=r"^osqp is not installed: pip install -e '\.\[bench\]'$"):
        build("osqp", parameters.laws, problem, 0)


def test_without_a_library_its_rows_are_left_out_and_the_table_says_so(parameters, monkeypatch):
    def absent(key, laws, problem, delay):
        if key == "osqp":
            raise MissingLibraryError("osqp is not installed: pip install -e '.[bench]'")
        return build(key, laws, problem, delay)

    monkeypatch.setattr(comparison, "build", absent)
    trouble = parameters.trouble.model_copy(update={"delays_s": ()})
    changes = {"controllers": ("flow", "osqp"), "speeds_m_s": (19.0,), "trouble": trouble}
    found = comparison.run(parameters.model_copy(update=changes))
    assert list(rows(found.tables[0])) == ["NR flow T 0.15"]
    assert "osqp is left out: osqp is not installed: pip install -e '.[bench]'" in found.tables[0].notes


def test_the_product_imports_none_of_the_libraries():
    code = (
        "import sys, robofleet.cli, robofleet.experiments.comparison\n"
        "print([name for name in ('osqp', 'casadi', 'do_mpc', 'pyapriltags') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_updates_are_timed_in_turns_and_the_first_turn_is_left_out(problem):
    calls = []

    class Counts:
        def __init__(self, name):
            self.name = name

        def update(self, t, x):
            calls.append(self.name)
            return 0.0, 0.0

    found = comparison.in_turns([Counts("a"), Counts("b")], 0.01 * np.arange(13), np.zeros((13, 6)), 3)
    assert "".join(calls) == "aaabbb" * 4
    assert [(len(timing.warm), len(timing.first)) for timing in found] == [(6, 3)] * 2
