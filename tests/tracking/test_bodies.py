"""From a motion capture's bodies to poses in the plane."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.config.mocap import MocapSettings
from robofleet.core.clock import MS, S
from robofleet.tracking.bodies import Body, FleetBodies, planar
from robofleet.tracking.events import TrackerEvent

MOCAP = SHIPPED / "mocap.yaml"
finite = st.floats(-3, 3)
angle = st.floats(-3.1, 3.1)


def turned(axis: str, by: float) -> tuple[float, float, float, float]:
    """Return the quaternion (x, y, z, w) of a rotation about an axis."""
    return (*(math.sin(by / 2) * (axis == name) for name in "xyz"), math.cos(by / 2))


def times(p: tuple[float, ...], q: tuple[float, ...]) -> tuple[float, ...]:
    """Return the product of two quaternions (x, y, z, w): first q, then p."""
    (a, b, c, d), (e, f, g, h) = p, q
    return (
        d * e + a * h + b * g - c * f,
        d * f - a * g + b * h + c * e,
        d * g + a * f - b * e + c * h,
        d * h - a * e - b * f - c * g,
    )


@given(x=finite, y=finite, height=finite, psi=angle, pitch=st.floats(-0.5, 0.5), roll=st.floats(-0.5, 0.5))
def test_a_body_heads_where_its_x_axis_points_seen_from_above(
    x: float, y: float, height: float, psi: float, pitch: float, roll: float
) -> None:
    """Whatever its height, pitch and roll; whichever axis of the system points up."""
    tilt = times(turned("y", pitch), turned("x", roll))
    z_up = Body(x, y, height, *times(turned("z", psi), tilt))
    assert planar(z_up, MocapSettings()) == pytest.approx((x, y, psi), abs=1e-9)
    tilt = times(turned("z", pitch), turned("x", roll))
    y_up = Body(x, height, -y, *times(turned("y", psi), tilt))
    assert planar(y_up, MocapSettings(up="y")) == pytest.approx((x, y, psi), abs=1e-9)


@given(x=finite, y=finite, psi=angle, at=st.tuples(finite, finite, st.floats(-170, 170)))
def test_the_systems_frame_lies_in_the_arena_where_it_is_said_to(
    x: float, y: float, psi: float, at: tuple[float, float, float]
) -> None:
    origin: Any = dict(zip(("x_m", "y_m", "heading_deg"), at, strict=True))
    body = planar(Body(1e3 * x, 1e3 * y, 0, *turned("z", psi)), MocapSettings(unit_m=1e-3, origin=origin))
    position = complex(at[0], at[1]) + complex(x, y) * complex(
        math.cos(math.radians(at[2])), math.sin(math.radians(at[2]))
    )
    assert body[:2] == pytest.approx((position.real, position.imag), abs=1e-9)
    assert math.remainder(body[2] - psi - math.radians(at[2]), math.tau) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize(
    "body",
    [
        Body(math.nan, 0, 0, 0, 0, 0, 1),
        Body(0, math.inf, 0, 0, 0, 0, 1),
        Body(0, 0, 0, 0, 0, 0, 0),  # what some systems send of a body that they do not track
        Body(0, 0, 0, *turned("y", -math.pi / 2)),  # on end: it has no heading
    ],
)
def test_what_is_no_pose_is_none(body: Body) -> None:
    assert planar(body, MocapSettings()) is None


class Bodies:
    """The shipped fleet's bodies: frames 10 ms apart."""

    def __init__(self, *keys: str) -> None:
        self.bodies = FleetBodies(load_config(MOCAP, keys))
        self.now_ns = S

    def frame(self, **places: float) -> list[int]:
        """Return the numbers of the robots that a frame places."""
        self.now_ns += 10 * MS
        self.found, self.strange = self.bodies.poses(
            {name: Body(x, 0.5, 0.1, 0, 0, 0, 1) for name, x in places.items()}, self.now_ns
        )
        return [pose.tag for pose in self.found]


def test_robots_without_tags_are_known_by_numbers_of_their_own() -> None:
    config = load_config(MOCAP, ["robots.2.tag=0"])
    assert [robot.tag for robot in config.robots] == [1, 2, 0, 3]
    bodies = Bodies("robots.2.tag=0", "robots.0.body=Rigid Body 7")
    assert bodies.frame(**{"r3": 1.0, "Rigid Body 7": 2.0, "r1": 3.0}) == [1, 0]
    assert [pose.x_m for pose in bodies.found] == [2.0, 1.0]
    assert bodies.strange == 1, "r1 is nobody's body here"


def test_a_body_that_is_not_tracked_is_named_and_the_others_go_on() -> None:
    bodies = Bodies()
    bodies.frame(r1=0.0, r2=1.0)
    notices = []
    for k in range(30):
        x = k / 1000
        tracked = {"r1": x} if k < 20 else {"r1": x, "r2": 1 + x}
        assert bodies.frame(**tracked) == list(range(len(tracked)))
        notices += [(k, *notice) for notice in bodies.bodies.news()]
    (lost_at, *lost), (found_at, *found) = notices
    assert (lost_at, found_at) == (9, 20)
    assert lost == [TrackerEvent.BODY_LOST, 1, pytest.approx(0.1)]
    assert found == [TrackerEvent.BODY_FOUND, 1, pytest.approx(0.21)]


def test_a_pose_that_is_repeated_bit_by_bit_is_of_a_body_that_is_not_tracked() -> None:
    """Measured poses have noise; a system that lost a body may repeat its last one, while the robot drives on."""
    bodies = Bodies()
    assert [len(bodies.frame(r1=1.0)) for _ in range(8)] == [1] * 5 + [0] * 3
    assert bodies.frame(r1=1.0001) == [0]
    unknown = Bodies("tracker.mocap.position_sigma_m=0")
    assert [len(unknown.frame(r1=1.0)) for _ in range(8)] == [1] * 8


def test_poses_carry_the_covariance_that_is_configured() -> None:
    bodies = Bodies("tracker.mocap.position_sigma_m=0.003", "tracker.mocap.heading_sigma_rad=0.02")
    bodies.frame(r1=1.0)
    (pose,) = bodies.found
    assert (pose.xx_m2, pose.yy_m2, pose.psipsi_rad2) == pytest.approx((9e-6, 9e-6, 4e-4))
    unknown = Bodies("tracker.mocap.position_sigma_m=0")
    unknown.frame(r1=1.0)
    assert unknown.found[0][6:] == (0, 0, 0, 0, 0, 0)
