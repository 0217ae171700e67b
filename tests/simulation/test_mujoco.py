"""MuJoCo's robots against their kinematics and their forces, and its pixels through the tracker."""

import math
import sys

import numpy as np
import pytest

from robofleet import cli
from robofleet.config import slices
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.runs.check import refusals
from robofleet.simulation.mujoco import extra
from robofleet.vehicles.plants import FleetPlant, PlantState
from tests.shipped import PLATOON

pytest.importorskip("mujoco")

RADIUS, WEIGHT = 0.055, 40.0 * math.pi * 0.055**2 * 9.81  # of a GTernal [m], [N]
ALONE = [f"robots.{row}.start={{x_m: {row - 1.5}, y_m: 0.8, heading_deg: 0}}" for row in range(4)]
LOW = (
    "{width: 320, height: 240, focal_px: [300, 300], centre_px: [161, 118],"
    " distortion: [-0.1, 0.015, 0.0004, -0.0003, 0], T_world_camera: {position_m: [0, 0, 0.9],"
    " rotation_rad: [3.1411141738120056, 0.0, 0.0548283518508331]}}"
)
SLOPE = "{friction: 0.05, tilt_deg: [5, 0]}"


def config(*changes: str, settings: str = "{}") -> Config:
    return load_config(PLATOON, [*ALONE, "plant.model=mujoco", f"plant.settings={settings}", *changes])


def plant(*changes: str, settings: str = "{}") -> FleetPlant:
    shared = slices.shared_plant(config(*changes, settings=settings), ["r1", "r2", "r3", "r4"], 0)
    assert shared is not None
    shared._plant.step(np.zeros((4, 2)), 0.3)  # the robots settle on the floor
    return shared._plant


def driven(made: FleetPlant, left: float, right: float, duration: float = 1.0) -> list[PlantState]:
    """Return the states every 10 ms while all robots are commanded alike."""
    states = [made.state()]
    for _ in range(round(duration * 100)):
        made.step(np.tile([left, right], (4, 1)), 0.01)
        states.append(made.state())
    return states


@pytest.mark.slow_after_first
@pytest.mark.parametrize("wheels", [(8.0, 8.0), (6.0, 10.0), (8.0, -8.0)])
def test_wheels_roll_as_the_robots_were_built(wheels: tuple[float, float]) -> None:
    states = driven(plant(), *wheels)
    builds = [slices._plant_robot(config(), robot).build for robot in config().robots]
    first, last = states[40], states[100]
    turned = np.remainder(last.poses[:, 2] - first.poses[:, 2] + math.pi, math.tau) - math.pi
    for row, build in enumerate(builds):
        left, right = (last.angles - first.angles)[row] * [build.left_gain, build.right_gain]
        angle = (right - left) * build.wheel_radius / build.wheel_base
        way = (left + right) / 2 * build.wheel_radius * np.sinc(angle / 2 / math.pi)
        assert turned[row] == pytest.approx(angle, abs=0.01)
        assert np.hypot(*(last.poses - first.poses)[row, :2]) == pytest.approx(abs(way), abs=3e-4)
    assert np.array([state.speeds for state in states[60:]]).mean(0) == pytest.approx(np.tile(wheels, (4, 1)), abs=0.1)


def test_wheels_follow_with_the_lag_of_their_kind() -> None:
    speeds = np.array([state.speeds[0, 0] for state in driven(plant(), 10.0, 10.0, 0.3)])
    assert np.interp(10.0 * (1 - 1 / math.e), speeds, np.arange(31) * 0.01) == pytest.approx(0.08 + 0.01, abs=0.02)


def test_what_friction_and_slope_do() -> None:
    still = driven(plant(settings="{tilt_deg: [2, 0]}"), 0.0, 0.0, 0.5)  # gears hold what is below their friction
    assert np.abs(still[-1].poses - still[0].poses)[:, :2].max() < 1e-3
    sliding = driven(plant(settings=SLOPE), 0.0, 0.0, 0.5)
    v, then = (np.array([state.velocities[0, 0] for state in sliding])[[k]] for k in (10, 50))
    steepest = 9.81 * math.sin(math.radians(5.0))
    assert (then - v) / 0.4 == pytest.approx(-(steepest - 0.05 * 9.81), rel=0.05)  # downhill is backwards


def test_patches_have_a_friction_of_their_own() -> None:
    even, uneven = (
        driven(plant(settings=f"{{friction: 0.06, friction_spread: {s}}}"), 12.5, 12.5, 0.5) for s in (0, 1)
    )
    reached = [np.ptp(states[-1].velocities[:, 0]) for states in (even, uneven)]
    assert reached[0] < 0.01 < reached[1]


@pytest.mark.slow
def test_a_cable_pulls_backwards() -> None:
    free, held = (
        driven(plant(settings=f"{{cables_n: {{r1: {force}}}}}"), 8.0, 8.0)[-1] for force in (0.0, 1.2 * WEIGHT)
    )
    assert free.velocities[0, 0] == pytest.approx(8.0 * 0.016, rel=0.05)
    assert abs(held.velocities[0, 0]) < 0.02
    assert held.velocities[1, 0] == pytest.approx(free.velocities[1, 0], abs=1e-6)


def test_bodies_and_obstacles_are_solid() -> None:
    starts = [
        "robots.0.start={x_m: -0.15, y_m: 0, heading_deg: 0}", "robots.1.start={x_m: 0.05, y_m: 0, heading_deg: 180}",
        "robots.2.start={x_m: 0.6, y_m: 0, heading_deg: 0}",
        "arena.obstacles=[{name: box, polygon_m: [[0.8, -0.2], [1.0, -0.2], [1.0, 0.2], [0.8, 0.2]], height_m: 0.1}]",
    ]  # fmt: skip
    poses = np.array([state.poses for state in driven(plant(*starts), 8.0, 8.0, 1.5)])
    apart = np.linalg.norm(poses[:, 1, :2] - poses[:, 0, :2], axis=1)
    assert apart.min() == pytest.approx(2 * RADIUS, abs=5e-4)
    assert poses[:, 2, 0].max() == pytest.approx(0.8 - RADIUS, abs=0.003)


@pytest.mark.slow
def test_the_same_seed_is_the_same_world() -> None:
    settings = "{friction_spread: 0.5, cables_n: {r2: 0.2}}"
    first, again = (driven(plant(settings=settings), 9.0, 7.0, 0.3)[-1] for _ in range(2))
    for before, after in zip(first, again, strict=True):
        assert np.array_equal(before, after)


@pytest.mark.parametrize(("change", "path", "words"), [
    ("plant.settings={frictoin: 1}", "plant.settings.frictoin", "did you mean 'friction'?"),
    ("plant.settings={friction: -1}", "plant.settings.friction", "0.01"),
    ("plant.settings={cables_n: {r9: 1}}", "plant.settings.cables_n.r9", "there is no robot 'r9'"),
    ("plant.model=mujocko", "plant.model", "did you mean 'mujoco'?"),
    ("faults=[{kind: slip, robot: r1, at_s: 1}]", "faults.0.kind", "remove it"),
])  # fmt: skip
def test_what_cannot_work_is_refused(change: str, path: str, words: str) -> None:
    found = dict(refusals(config(change)))
    assert words in found[path]


@pytest.mark.parametrize(("key", "packages"), [("plant.model", "mujoco"), ("camera.source", "mujoco, OpenGL")])
def test_without_mujoco_a_line_says_what_to_install(
    key: str, packages: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(extra, "find_spec", lambda _: None)
    line = checked(f"{key}=mujoco", monkeypatch, capfd)
    assert line.startswith(f"--set {key}=mujoco: {key}: {packages} is not installed: ") and "pip install" in line


def test_without_a_display_a_line_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("OpenGL")
    monkeypatch.setattr("ctypes.util.find_library", lambda _: None)  # neither OSMesa nor EGL
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    line = checked("camera.source=mujoco", monkeypatch, capfd)
    assert line.startswith("--set camera.source=mujoco: camera.source: OpenGL cannot draw without a display here (")
    assert line.endswith("apt-get install libosmesa6")


def checked(change: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> str:
    """Return the line with which ``robofleet check`` refuses a change."""
    monkeypatch.setattr(sys, "argv", ["robofleet", "check", str(PLATOON), "--set", change])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    written = capfd.readouterr()
    (line,) = written.err.splitlines()
    assert (ended.value.code, written.out) == (2, "")
    return line


def test_the_tracker_places_what_it_draws() -> None:
    pytest.importorskip("OpenGL")
    from robofleet.simulation.mujoco.camera import MujocoCamera
    from robofleet.simulation.mujoco.renderer import no_display
    from robofleet.tracking.sight import FleetSight

    if no_display():
        pytest.skip(no_display())
    near = ["camera.width=320", "camera.height=240", f"camera.model={LOW}", "camera.source=mujoco"]
    small = config(*near)
    poses = np.array([[-0.25, 0.1, 0.5], [0.0, -0.2, 2.0], [0.25, 0.15, -2.5], [np.nan, 0.0, 0.0]])
    camera, sight = MujocoCamera.renderer(small, np.random.default_rng(1)), FleetSight(small)
    try:
        for k in range(4):
            seen = {pose.tag: pose for pose in sight.see(camera.render(poses).copy(), (k + 1) * S // 30).poses}
    finally:
        camera.close()
    assert sorted(seen) == [1, 2, 3]
    off = np.array([(seen[row + 1].x, seen[row + 1].y, seen[row + 1].psi) - poses[row] for row in range(3)])
    assert np.abs(off[:, :2]).max() < 5e-5
    assert np.degrees(np.abs(off[:, 2])).max() < 0.05
