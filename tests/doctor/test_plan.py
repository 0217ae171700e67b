"""`robofleet doctor --plan`: its arithmetic against the project's own camera model, and the command."""

import json
import math
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.config.calibrated import CameraModel, PoseSettings
from robofleet.config.files.names import guide
from robofleet.doctor.plan import ANGLES_DEG, NEEDED_PX, RIM_M, TILT_DEG, Wanted, cameras, lowest_m, side_px
from robofleet.tracking.camera import CameraGeometry
from tests.command import robofleet

SIZES = (1280, 720), (1920, 1080), (2448, 2048)
LABORATORIES = st.builds(
    Wanted,
    arena_m=st.tuples(st.floats(1.5, 6.0), st.floats(0.8, 1.5)),
    robots=st.integers(1, 200),
    tag_side_m=st.floats(0.04, 0.15),
    tag_height_m=st.floats(0.02, 0.3),
    body_radius_m=st.just(0.06),
    speed_m_s=st.floats(0.1, 1.0),
    image_px=st.sampled_from(SIZES),
    ceiling_m=st.none() | st.floats(2.0, 6.0),
)


def camera(angle_deg: float, height_m: float, size: tuple[int, int], tilt_deg: tuple[float, float]) -> CameraGeometry:
    """Return a camera of the tracker's that looks down from over the middle, tilted about its own axes."""
    focal = size[0] / 2 / math.tan(math.radians(angle_deg) / 2)
    model = CameraModel(
        width=size[0], height=size[1], focal_px=(focal, focal), distortion=(),
        centre_px=((size[0] - 1) / 2, (size[1] - 1) / 2),
        T_world_camera=PoseSettings(position_m=(0.0, 0.0, height_m), rotation_rad=(math.pi, 0.0, 0.0)),
    )  # fmt: skip
    T = CameraGeometry.from_model(model).T_world_camera.copy()
    a, b = np.radians(tilt_deg)
    about_x = np.array([[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]])
    about_y = np.array([[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]])
    T[:3, :3] = T[:3, :3] @ about_x @ about_y
    return CameraGeometry.from_model(model).moved(T)


@settings(deadline=None, max_examples=40)
@given(wanted=LABORATORIES, angle=st.sampled_from(ANGLES_DEG))
def test_the_lowest_camera_sees_the_arena_however_it_is_tilted_and_a_lower_one_does_not(
    wanted: Wanted, angle: int
) -> None:
    half = np.array(wanted.arena_m) / 2 + RIM_M
    corners = np.array([(x * half[0], y * half[1], wanted.tag_height_m) for x, y in product((-1, 1), repeat=2)])

    def seen(height: float) -> bool:
        views = (camera(angle, height, wanted.image_px, tilt) for tilt in product((-TILT_DEG, TILT_DEG), repeat=2))
        pixels = np.vstack([view.project(corners) for view in views])
        return bool((np.abs(pixels + 0.5 - np.array(wanted.image_px) / 2) <= np.array(wanted.image_px) / 2).all())

    lowest = lowest_m(angle, wanted.arena_m, wanted)
    assert seen(lowest + 1e-3)
    assert not seen(lowest - 1e-3)


@settings(deadline=None, max_examples=40)
@given(wanted=LABORATORIES, angle=st.sampled_from(ANGLES_DEG), height=st.floats(1.0, 6.0))
def test_a_tag_is_as_many_pixels_as_the_camera_model_projects(wanted: Wanted, angle: int, height: float) -> None:
    ends = np.array([(s * wanted.tag_side_m / 2, 0.0, wanted.tag_height_m) for s in (-1, 1)])
    pixels = camera(angle, height, wanted.image_px, (0.0, 0.0)).project(ends)
    assert side_px(angle, height, wanted) == pytest.approx(math.dist(*pixels))


@settings(deadline=None)
@given(wanted=LABORATORIES)
def test_the_cameras_see_tags_well_enough_from_below_the_ceiling_or_there_are_none(wanted: Wanted) -> None:
    view = cameras(wanted)
    if view is None:
        assert wanted.ceiling_m is not None or wanted.tag_side_m < 0.1
        return
    assert view.tag_px >= NEEDED_PX
    assert wanted.ceiling_m is None or view.height_m <= wanted.ceiling_m
    several = view.columns * view.rows > 1
    assert view.overlap_m == (wanted.speed_m_s + wanted.tag_side_m if several else 0.0)


def test_a_plan_is_a_line_for_each_thing_to_buy() -> None:
    arguments = ["doctor", "--plan", "--arena", "3.2x2.0", "--robots", "8", "--tag-side-mm", "70"]
    done = robofleet(*arguments)
    assert done.exit_code == 0
    assert "1 of 1920 x 1080 pixels" in done.output
    assert "the lens 3.11 m above the floor" in done.output
    assert "800 packets a second" in done.output
    report = json.loads(robofleet(*arguments, "--json").output)
    assert {"cameras", "lens", "computer", "radio"} < {line["name"] for line in report["plan"]}


def test_a_plan_names_its_guide_where_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert guide("BUY.md").is_file()
    monkeypatch.chdir(Path(__file__).parents[2])
    assert guide("BUY.md") == Path("configs/BUY.md")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--plan", "--arena", "3.2"], "--arena 3.2: write it as 3.2x2.0"),
        (["--plan", "--arena", "nanx2"], "write it as"),
        (["--plan", "--image", "-1x5"], "write it as 1920x1080"),
        (["--plan", "--image", "0.1x0.1"], "each 100 to 16384"),
        (["--plan", "--robots", "r1"], "--robots r1: with --plan write how many"),
        (["--plan", "--robots", "0"], "write how many"),
        (["--plan", "--tag-side-mm", "5"], "larger tags"),
        (["--plan", "--ceiling-m", "0.5"], "ceiling"),
        (["--arena", "3x2"], "they belong to --plan"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(options: list[str], says: str) -> None:
    done = robofleet("doctor", *options)
    assert (done.exit_code, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert says in line
