"""What is refused before a wheel turns, and what is proved."""

import math
import re
from pathlib import Path as FilePath

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.behaviours.laps import drive_lap
from robofleet.behaviours.platoon import Platoon
from robofleet.config.load import ConfigError, load_config
from robofleet.config.tree import Config
from robofleet.control.path import Path
from robofleet.runs.check import load_checked, proofs, refusals, start_warnings
from robofleet.runs.margins import margin_warnings
from tests.shipped import PLATOON


def platoon(*overrides: str) -> Config:
    return load_config(PLATOON, overrides)


def settings_of(*overrides: str) -> Platoon.Settings:
    return Platoon.Settings.model_validate(platoon(*overrides).groups[0].settings)


def test_the_shipped_platoon_can_work() -> None:
    assert refusals(platoon()) == []


def test_no_wheel_passes_its_limit_along_the_whole_path() -> None:
    config = platoon()
    own, l = settings_of(), config.controller.point_ahead_m
    path, vehicle = own.path.path(), config.robots[0].vehicle
    step = 0.005  # Runge-Kutta over two laps; the second one counts
    grid = np.arange(0.0, 2 * path.sides / own.path_rate + step, step / 2)
    rates: list[list[float]] = (path.derivative(own.path_rate * grid % path.sides) * own.path_rate).tolist()

    def turn(psi: float, k: int) -> float:
        return (-math.sin(psi) * rates[k][0] + math.cos(psi) * rates[k][1]) / l

    psi, v, omega = math.atan2(rates[0][1], rates[0][0]), [], []
    for k in range(0, len(grid) - 2, 2):
        v.append(math.cos(psi) * rates[k][0] + math.sin(psi) * rates[k][1])
        omega.append(turn(psi, k))
        k1 = omega[-1]
        k2 = turn(psi + step / 2 * k1, k + 1)
        k3 = turn(psi + step / 2 * k2, k + 1)
        psi += step / 6 * (k1 + 2 * k2 + 2 * k3 + turn(psi + step * k3, k + 2))
    lap = slice(len(v) // 2, None)
    body, turning = np.array(v[lap]), np.array(omega[lap])
    wheels = np.stack([body - turning * vehicle.wheel_base_m / 2, body + turning * vehicle.wheel_base_m / 2])
    wheels /= vehicle.wheel_radius_m
    assert np.abs(wheels).max() < vehicle.max_wheel_speed_rad_s
    assert np.abs(body).max() < vehicle.max_speed_m_s

    proved = {what: float(value.split()[0]) for what, value, *_ in proofs(config)}
    assert proved["the fastest wheel along the path"] == pytest.approx(np.abs(wheels).max(), rel=1e-3)
    assert proved["the highest speed along the path"] == pytest.approx(np.abs(body).max(), rel=1e-3)


@pytest.mark.slow_after_first
@pytest.mark.parametrize("l", [0.01, 0.08, 0.3])
@pytest.mark.parametrize("clockwise", [True, False])
def test_on_a_circle_the_point_drives_its_robot_on_a_smaller_one(l: float, clockwise: bool) -> None:
    radius, sides, sign = 0.5, 24, -1 if clockwise else 1
    angle = sign * np.arange(sides) * math.tau / sides
    derivative = sign * radius * math.tau / sides * np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    path = Path.hermite(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1), derivative)
    lap = drive_lap(path, 0.5, l, centre_tracked=False)
    turn = sign * math.tau / sides * 0.5
    assert lap.omega == pytest.approx(turn, rel=5e-3)
    assert lap.v == pytest.approx(abs(turn) * math.sqrt(radius**2 - l**2), rel=5e-3)


def test_a_tracked_centre_turns_with_the_paths_curvature() -> None:
    own = settings_of("groups.0.settings.track=centre")
    path = own.path.path()
    lap = drive_lap(path, own.path_rate, 0.08, centre_tracked=True)
    ahead, behind = path.derivative(lap.sigma + 1e-5), path.derivative(lap.sigma - 1e-5)
    angle = np.arctan2(ahead[:, 1], ahead[:, 0]) - np.arctan2(behind[:, 1], behind[:, 0])
    turn = (angle + math.pi) % math.tau - math.pi
    inside = np.abs(lap.sigma - np.round(lap.sigma)) > 1e-4
    assert lap.omega[inside] == pytest.approx(turn[inside] / 2e-5 * own.path_rate, abs=1e-5)
    assert lap.v == pytest.approx(lap.speed * own.path_rate)


CUSP = (
    "groups.0.settings.path={knots: [{at_m: [-1, 0], derivative_m: [0, 0]}, {at_m: [1, 0.5], derivative_m: [1, -1]}]}"
)
EULER = ["controller.integrator=euler"]
KNOTS = [((0.5, 0), (0, 0.8)), ((0, 0.5), (-0.8, 0)), ((-0.5, 0), (0, -0.8)), ((0, -0.5), (0.8, 0))]
CIRCLE = [
    f"groups.0.settings.path={{knots: {[{'at_m': [*at], 'derivative_m': [*slope]} for at, slope in KNOTS]}}}",
    "groups.0.robots=[r1, r2]",
]
REFUSED = [
    (["controller.tick_s=0.095"], "controller.tick_s", "a command is valid for 120 ms"),
    ([*CIRCLE, "groups.0.settings.spacing_m=1.05"], "groups.0.settings.spacing_m", "a spacing of 0.985 fits"),
    ([*EULER, "controller.alpha=61"], "controller.alpha", "below 60.6"),
    ([*EULER, "controller.alpha=50", "controller.tick_s=0.04"], "controller.alpha", "is 2, must be less"),
    (["controller.point_ahead_m=0.126"], "controller.point_ahead_m", "must be at most 0.125 m"),
    (["groups.0.settings.path_rate=0.08"], "groups.0.settings.path_rate", "fastest wheel along the path is 14.39 rad"),
    ([CUSP], "groups.0.settings.path", "stands still at parameter 0.00"),
    (["arena.size_m=[3, 2]"], "groups.0.settings.path", "reach in x with a body's radius is 1.527 m"),
    (["arena.size_m=[3.2, 1.8]"], "groups.0.settings.path", "leaves the arena at parameter"),
    (["robots.2.start.x_m=1.55"], "robots.2.start", "move r3 into the arena"),
    (["robots.1.start.y_m=-0.95"], "robots.1.start", "move r2 into the arena"),
    (["robots.3.start={x_m: -1.2, y_m: 0.6, heading_deg: 0}"], "robots.3.start", "move r1 and r4 apart"),
    (["groups.0.settings.spacing_m=1.9"], "groups.0.settings.spacing_m", "a spacing of 1.83 fits"),
    (["groups.0.settings.spacing_m=0.2"], "groups.0.settings.spacing_m", "the barrier would hold r2 back from r1"),
    (["controller.barrier.rate_per_s=31"], "controller.barrier.rate_per_s", "below 30.3"),
    (["camera.trigger_lead_s=0.0059"], "camera.trigger_lead_s", "must be at least 0.006 s"),
    (["camera.exposure_control=auto", "camera.exposure_s=0.02"], "camera.exposure_s", "1 px of motion blur"),
    (["camera.exposure_control=auto", "camera.exposure.gain=[30, 40]"], "camera.exposure.gain", "has 0 to 24"),
    (["camera.exposure_s=0.03"], "camera.exposure_s", "is 0.034 s, must be at most 0.033 s"),
    (["camera.trigger=free", "camera.rate_hz=200"], "camera.exposure_s", "must be at most 0.005 s"),
]  # fmt: skip


@pytest.mark.parametrize(("overrides", "path", "message"), REFUSED, ids=lambda value: str(value)[:50])
def test_what_cannot_work_is_refused(overrides: list[str], path: str, message: str) -> None:
    assert any(at == path and message in text for at, text in refusals(platoon(*overrides)))


@pytest.mark.parametrize(
    "overrides",
    [
        [*EULER, "controller.alpha=60"],
        ["controller.alpha=90"],
        ["controller.tick_s=0.05"],
        [*CIRCLE, "groups.0.settings.spacing_m=0.95"],
        ["controller.point_ahead_m=0.125"],
        ["groups.0.settings.spacing_m=0.9", *(f"robots.{k}.start=null" for k in range(4))],
        ["camera.trigger_lead_s=0.006"],
        ["camera.trigger_lead_s=0.001", "camera.trigger=free"],
        ["camera.trigger_lead_s=0.001", "tracker.source=truth"],
        ["groups.0.settings.track=centre"],
    ],
    ids=str,
)
def test_what_just_works_is_not_refused(overrides: list[str]) -> None:
    assert refusals(platoon(*overrides)) == []


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.floats(0.08, 10.0))
def test_the_path_rate_that_a_refusal_proposes_fits(rate: float) -> None:
    complaints = refusals(platoon(f"groups.0.settings.path_rate={rate}"))
    proposed = min(float(found[1]) for _, text in complaints if (found := re.search(r"path_rate (\S+) fits", text)))
    assert refusals(platoon(f"groups.0.settings.path_rate={proposed}")) == []
    assert refusals(platoon(f"groups.0.settings.path_rate={proposed * 1.02}"))


def test_each_kind_of_robot_is_held_to_its_own_limits() -> None:
    weak = "robots.2.vehicle.max_wheel_speed_rad_s=8"
    ((path, text),) = refusals(platoon(weak))
    assert path == "groups.0.settings.path_rate"
    assert "must be at most 8 rad/s: r3 at path parameter" in text


def test_the_proofs_show_the_tightest_value_beside_its_limit() -> None:
    table = {what: (value, limit, used) for what, value, limit, used in proofs(platoon("controller.integrator=euler"))}
    assert table["Euler's gain, alpha * tick_s,"] == ("1.485", "< 2", "74%")
    assert table["point_ahead_m"] == ("0.08 m", "≤ 0.125 m", "64%")
    assert table["the fastest wheel along the path"][1] == "≤ 12.5 rad/s"
    assert table["the distance between two robots at the start"] == ("0.1892 m", "≥ 0.1197 m", "63%")


def test_a_refusal_is_reported_at_its_line_and_column(tmp_path: FilePath) -> None:
    file = tmp_path / "platoon.yaml"
    lines = PLATOON.read_text().replace("path_rate: 0.0455", "path_rate: 0.455").splitlines()
    file.write_text("\n".join(lines))
    with pytest.raises(ConfigError) as caught:
        load_checked(file, ["controller.point_ahead_m=0.2"])
    line = next(i for i, text in enumerate(lines, 1) if "path_rate" in text)
    wheel, ahead = caught.value.faults
    assert wheel.startswith(f"{file}:{line}:18: groups.0.settings.path_rate: the fastest wheel")
    assert ahead.startswith("--set controller.point_ahead_m=0.2: controller.point_ahead_m: ")
    assert load_checked(PLATOON) == platoon()


class RealRobot:
    """A driver that is not a simulation: it has no truth."""

    write = read = close = None


def test_lockstep_refuses_a_real_robot_and_a_real_camera() -> None:
    real = f"{__name__}:RealRobot"
    others = [f"robots.{k}.reality=simulated" for k in (0, 2, 3)]
    config = platoon(f"robots.1.driver={real}", f"camera.source={real}", *others)
    assert refusals(config) == []
    assert [path for path, _ in refusals(config, lockstep=True)] == ["robots.1.driver", "camera.source"]


def exchanged(first: int, second: int) -> list[str]:
    """Return overrides that exchange the starts of two robots."""
    starts = [platoon().robots[k].start for k in (first, second)]
    return [
        f"robots.{k}.start={start.model_dump_json()}".replace('"', "").replace(":", ": ")
        for k, start in zip((second, first), starts, strict=True)
        if start is not None
    ]


def test_a_group_in_the_wrong_order_is_named_with_the_order_that_works() -> None:
    ((path, text),) = refusals(platoon("groups.0.robots=[r4, r3, r2, r1]"))
    assert path == "groups.0.robots"
    assert "write `robots: [r1, r2, r3, r4]`" in text
    assert refusals(platoon("groups.0.robots=[r1, r2, r3, r4]")) == []


def test_exchanged_starts_are_named() -> None:
    ((path, text),) = refusals(platoon(*exchanged(0, 2)))
    assert path == "groups.0.robots"
    assert "r3 stands ahead of r2" in text


def test_the_table_says_how_far_each_is_and_what_takes_long_is_said() -> None:
    near, far = platoon(), platoon("robots.3.start={x_m: 0.2, y_m: -0.6, heading_deg: 180}")
    assert list(start_warnings(near)) == []
    assert refusals(far) == []
    (line,) = start_warnings(far)
    assert re.match(r"r4 starts 1\.\d\d m from its place and needs about \d+ s to it", line)
    table = {what: row for what, *row in proofs(far)}
    assert table["the time until every robot is in its place"][2] == "slow"


@pytest.mark.slow
def test_check_says_what_the_loop_bears_that_nobody_knows_of() -> None:
    def delay_ms(*overrides: str) -> float:
        table = {what: value for what, value, *_ in proofs(platoon(*overrides))}
        return float(table["the unknown delay that the loop tolerates at top speed"].removesuffix(" ms"))

    plain_ms = delay_ms()
    assert 200.0 < plain_ms < 260.0
    assert delay_ms("controller.horizon_s=0.3") < 0.7 * plain_ms
    assert list(margin_warnings(platoon())) == []
    (line,) = margin_warnings(platoon("controller.horizon_s=0.02"))
    assert line.startswith("the loop of r1 is unstable at its top speed, 0.2 m/s: raise controller.horizon_s")
    by_no_flow = load_config(PLATOON.with_name("consensus.yaml"))
    assert not any("unknown" in what for what, *_ in proofs(by_no_flow))


def test_every_robot_has_room_for_its_wheels_to_be_tried() -> None:
    """Arming would refuse it."""
    config = platoon("robots.1.start={x_m: -1.295, y_m: 0.42, heading_deg: 40}")
    assert any(path == "robots.1.start" and "move r1 and r2 apart" in text for path, text in refusals(config))
