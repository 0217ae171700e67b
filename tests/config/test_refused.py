"""What cannot be is refused in one line, at the key that is most probably wrong."""

import pytest

from robofleet.config.files.names import SHIPPED
from robofleet.config.load import ConfigError, load_config
from robofleet.runs.check import load_checked

KIND, SENSORS = "robots.1.vehicle", "robots.1.vehicle.sensors"
V4L2 = "cameras.0.source=v4l2", "cameras.1.source=v4l2"
BASLER = "cameras.0.source=basler", "cameras.1.source=basler", "cameras.0.basler.serial='1'"
FILES = "cameras.0.source=files", "cameras.1.source=files", "cameras.0.files={path: a}", "cameras.1.files={path: ./a}"
OUTLINE = "arena.obstacles.0.polygon_m"
CART = "arena.moving=[{name: %s, tag: %s, radius_m: 0.12}]"
CART_AT = "arena.moving=[{name: cart, tag: %s, radius_m: 0.12, start: {x_m: %s, y_m: %s, heading_deg: 0}}]"
FENCE = "arena.obstacles=[{name: fence, polygon_m: [[-0.02, -1.0], [0.02, -1.0], [0.02, 1.0], [-0.02, 1.0]]}]"
NEAREST = "groups.0.settings.assignment=nearest"

PLATOON: list[tuple[str | tuple[str, ...], str, str]] = [
    # robots
    (f"{KIND}.wheel_radius_m=16", f"{KIND}.wheel_radius_m", "(is 16 in mm?)"),
    (f"{KIND}.wheel_radius_m=0.06", f"{KIND}.wheel_radius_m", "larger than a body of body_radius_m 0.055: mend one"),
    (f"{KIND}.wheel_base_m=105", f"{KIND}.wheel_base_m", "(is 105 in mm?)"),
    (f"{KIND}.wheel_base_m=0.16", f"{KIND}.wheel_base_m", "outside a body of body_radius_m 0.055: mend one"),
    (f"{KIND}.body_radius_m=0.0055", f"{KIND}.body_radius_m", "less than a wheel's radius"),
    (f"{KIND}.body_radius_m=0.0535", f"{KIND}.body_radius_m", "no room for the wheels: 0.0549 at least"),
    (f"{KIND}.wheel_radius_m=0.0016", "gternal.yaml:6:16: max_speed_m_s", "0.02 m/s: lower it, or mend"),
    (f"{KIND}.max_speed_m_s=200", f"{KIND}.max_speed_m_s", "200 m/s is far more than these wheels give, 0.2 m/s"),
    ("robots.1.calibration={robot: r2, wheel_radius_m: 15.7}", "robots.1.calibration.wheel_radius_m", "15.7 in mm?"),
    ("robots.1.calibration={robot: r2, wheel_base_m: 0.05}", "robots.1.calibration.wheel_base_m", "vehicle has 0.105"),
    # sensors
    (("robots.1.sensors=true", f"{KIND}=create2"), "robots.1.sensors", "its vehicle has no sensors: describe"),
    (("robots.1.sensors=true", f"{SENSORS}={{period_s: 0.1}}"), "robots.1.sensors", "its vehicle has no sensors"),
    ("robots.1.sensors=1", "robots.1.sensors", "must be true or false, not 1"),
    (f"{SENSORS}.period_s=0.001", f"{SENSORS}.period_s", "must be at least 0.01, not 0.001"),
    (f"{SENSORS}.gyro.noise_rad_s=[0.1,0.1]", f"{SENSORS}.gyro.noise_rad_s.2", "has too few values: add one"),
    (f"{SENSORS}.gyro.noise_rad_s=[0.1,0.1,-0.1]", f"{SENSORS}.gyro.noise_rad_s.2", "must be at least 0, not -0.1"),
    (f"{SENSORS}.gyro.bias_deg_s=1", f"{SENSORS}.gyro.bias_deg_s", "unknown key"),
    (f"{SENSORS}.distances.dropout=1.5", f"{SENSORS}.distances.dropout", "must be at most 1, not 1.5"),
    (f"{SENSORS}.distances.places=[]", f"{SENSORS}.distances.places", "needs 1 or more, has 0"),
    (f"{SENSORS}.distances.range_m=1200", f"{SENSORS}.distances.range_m", "must be at most 1000, not 1200"),
    ("arena.walls=[[0,0,1]]", "arena.walls.0.3", "has too few values: add one"),
    # units and tags
    ("robots.2.unit=r1", "robots.2.unit", "r1 is the unit of the robot r1 already: give it another name"),
    ("robots.2.tag=587", "robots.2.tag", "587: the family 36h11 has the ids 0 to 586: give it one of these"),
    ("robots.2.tag=2000", "robots.2.tag", "2000: the family 36h11 has the ids 0 to 586: give it one of these"),
    # the bus
    *((f"bus.endpoint={at}", "bus.endpoint", "can be reached from outside") for at in (
        "tcp/0.0.0.0:7447", "tcp/192.168.1.7:7447", "tcp/lab:7447", "tcp/[::]:7447")),
    (("bus.endpoint=tcp/lab:1", "bus.insecure=loopback"), "bus.endpoint", "can be reached from outside"),
    (("bus.endpoint=tcp/127.0.0.1:65536", "bus.insecure=loopback"), "bus.endpoint", "there is no port 65536"),
    *((f"bus.endpoint={at}", "bus.endpoint", "must be private, or look like") for at in (
        "udp/1.2.3.4:0", "unixsock-stream/x.sock", "unixsock-stream//a b", "Private")),
    ("bus.endpoint=unixsock-stream/" + "/run/".ljust(108, "x"), "bus.endpoint",
     "the path has 108 bytes, a socket's at most 107"),
]  # fmt: skip
TWO_CAMERAS: list[tuple[str | tuple[str, ...], str, str]] = [
    ("camera={model: left}", "cameras", "write one of the two"),
    ("cameras=[]", "cameras", "name one or more"),
    ("cameras.1.name=left", "cameras.1.name", "left is cameras.0's already"),
    (V4L2, "cameras.1.v4l2.device", "name another device"),
    (BASLER, "cameras.1.basler.serial", "each names its own"),
    (FILES, "cameras.1.files.path", "name another device"),
    ("cameras.1.width=1280", "cameras.1.width", "calibrated for 1920"),
    ("cameras.1.exposures=1", "cameras.1.exposures", "unknown key"),
    ("cameras.0.exposure_s=fast", "cameras.0.exposure_s", "must be a number"),
]
OBSTACLES: list[tuple[str | tuple[str, ...], str, str]] = [
    ("arena.obstacles.1={circle: {x_m: -1.3, y_m: 0.55, radius_m: 0.1}}", "robots.0.start", "move r1 or obstacle2"),
    ("arena.obstacles.1.circle={x_m: 1.25, y_m: -0.2, radius_m: 0.35}", "groups.0.settings.goals.r2", "pillar"),
    ("arena.floor_m=[[-1.6,-1],[1.6,-1],[1.6,0.5],[-1.6,0.5]]", "robots.0.start", "move r1"),
    ("arena.floor_m.0=[-1.7, -1.0]", "arena.floor_m.0", "outside the arena"),
    ("arena.obstacles.1.circle.x_m=100", "arena.obstacles.1", "outside the arena"),
    ("arena.obstacles.1={name: p}", "arena.obstacles.1", "circle or a polygon"),
    ("arena.obstacles.0.name=wall", "arena.obstacles.2.name", "obstacles.0's already"),
    (f"{OUTLINE}=[[0,0],[0.2,0.2],[0.2,0],[0,0.2]]", OUTLINE, "crosses"),
    (f"{OUTLINE}=[[0,0],[0.1,0.1],[0.2,0.2]]", OUTLINE, "on one line"),
    (f"{OUTLINE}=[[0,0],[0,0],[0.2,0.2]]", OUTLINE, "the same"),
    (f"{OUTLINE}=[[0,0],[0,0.1]]", OUTLINE, "needs 3"),
    ("arena.obstacles.1.circle.radius=0.2", "arena.obstacles.1.circle.radius", "did you mean 'radius_m'?"),
    *((FENCE, f"groups.0.settings.goals.r{k}", "past fence") for k in range(1, 5)),
    ((NEAREST, FENCE, "groups.0.settings.goals.r1={x_m: -0.9, y_m: 0.2, heading_deg: 0}"), "groups.0.settings.goals",
     "to a goal that is left for it past fence"),
]  # fmt: skip
ON_THE_PATH: list[tuple[str | tuple[str, ...], str, str]] = [
    ("arena.obstacles=[{name: box, circle: {x_m: 0.9, y_m: 0.62, radius_m: 0.1}}]", "paths/platoon.yaml:4:1",
     "parameter 0.85, so move box or the path"),
    (CART_AT % (1, 0, 0), "arena.moving.0.tag", "1 is robots.0's already"),
    (CART % ("r1", 40), "arena.moving.0.name", "r1 is robots.0's already"),
    (CART % ("r1", 1), "arena.moving.0.name", "r1 is robots.0's already"),
    (CART % ("cart", 40), "arena.moving.0.start", "missing"),
    (CART_AT % (40, 0.9, 0.62), "arena.moving.0.start", "park cart further away"),
]  # fmt: skip


def refused(name: str, overrides: str | tuple[str, ...], key: str, words: str, *, checked: bool) -> tuple[str, ...]:
    """Return the lines; one of them is about a key and has these words."""
    changes = [overrides] if isinstance(overrides, str) else [*overrides]
    with pytest.raises(ConfigError) as caught:
        if checked:
            load_checked(SHIPPED / f"{name}.yaml", ["tracker.source=truth", *changes], lockstep=True)
        else:
            load_config(SHIPPED / f"{name}.yaml", changes)
    assert [line for line in caught.value.faults if f"{key}: " in line and words in line], caught.value.faults
    return caught.value.faults


@pytest.mark.parametrize(
    ("name", "fault"),
    [*(("platoon", fault) for fault in PLATOON), *(("two-cameras", fault) for fault in TWO_CAMERAS)],
    ids=lambda value: str(value)[-60:],
)
def test_a_single_fault_is_one_line(name: str, fault: tuple[str | tuple[str, ...], str, str]) -> None:
    assert len(refused(name, *fault, checked=False)) == 1


@pytest.mark.parametrize(
    ("name", "fault"),
    [*(("obstacles", fault) for fault in OBSTACLES), *(("platoon", fault) for fault in ON_THE_PATH)],
    ids=lambda value: str(value)[-60:],
)
def test_what_stands_in_the_way_is_refused_where_it_is_written(
    name: str, fault: tuple[str | tuple[str, ...], str, str]
) -> None:
    refused(name, *fault, checked=True)


@pytest.mark.parametrize(
    "change",
    [
        *(f"{KIND}={kind}" for kind in ("gternal", "ideal", "arduino", "arduino_uno", "create2", "rfp")),
        "robots.1.calibration={robot: r2, wheel_radius_m: 0.0125, wheel_base_m: 0.12}",  # a worn robot
        "robots.2.tag=586",
    ],
)
def test_what_can_be_is_not_refused(change: str) -> None:
    load_config(SHIPPED / "platoon.yaml", [change])


@pytest.mark.parametrize("unseen", ["tracker.source=truth", "robots.2.reality=simulated"])
def test_a_tag_that_no_camera_must_see_may_have_any_number(unseen: str) -> None:
    assert load_config(SHIPPED / "platoon.yaml", ["robots.2.tag=2000", unseen]).robots[2].tag == 2000


def test_goals_are_shared_out_to_which_ways_lead() -> None:
    """Two robots stand on either side of the fence, and so do two goals: who has which is left to them."""
    load_checked(SHIPPED / "obstacles.yaml", ["tracker.source=truth", NEAREST, FENCE], lockstep=True)
