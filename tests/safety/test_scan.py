"""The scan names every robot of which the monitor tells something: with it and without, the same is told."""

import random

import pytest

from robofleet.safety import monitor
from robofleet.safety.monitor import MonitorSettings, MonitorState
from robofleet.safety.rows import Rows
from robofleet.safety.scan import Scan
from robofleet.safety.supervisor import Phase
from robofleet.safety.view import NEVER, FleetView, RobotView
from robofleet.vehicles.solids import Solid

MS = 1_000_000
BUILD, SESSION = 7, 5
N = 6
FLOOR = Solid("floor", ((-1.0, -0.5), (1.0, -0.5), (1.0, 0.3), (0.8, 0.5), (-1.0, 0.5)), floor=True)
SETTINGS = MonitorSettings(BUILD, (0.05,) * N, (2.0, 1.0), (0.3,) * N, attended=False, floors=(FLOOR,))
_WHEELS = "left_speed", "right_speed", "left_output", "right_output"
AT_THE_CORNER = 0.9 - 0.05 / 2**0.5  # of x; of y 0.5 less


def robot(rng: random.Random, row: int, now_ns: int) -> RobotView:
    """Return a robot that is well, or of which something is wrong, or nearly so."""
    place = (-0.75 + 0.3 * row, 0.0, 0.0)
    well = RobotView(
        now_ns, BUILD, SESSION, 10 + row, battery=0.9, left_angle=1.0, seen_ns=now_ns, image=3, pose=place,
        driven=row < N - 1,
    )  # fmt: skip
    changes = (
        {}, {"heard_ns": now_ns - rng.choice((499, 500, 501)) * MS}, {"heard_ns": NEVER}, {"build": 8}, {"session": 6},
        {"boot_id": 99}, {"latch": rng.randrange(8), "latch_id": 3}, {"faults": rng.choice((1, 2, 64, 1 << 17))},
        {"battery": rng.choice((0.0, 0.099999, 0.1, -1.0))}, {"seen_ns": NEVER, "pose": (0.0, 0.0, 0.0)},
        {"unseen_ns": rng.choice((99, 100, 1999, 2000)) * MS}, {"lost": True}, {"filtered": rng.choice((1, 2))},
        {"blocked": True}, {"failed": rng.choice((60, 61))},
        {"pose": (rng.choice((0.949999, 0.95, 0.950001)), 0.0, 0.0)}, {"pose": (0.0, rng.choice((-0.45, -0.46)), 0.0)},
        {"pose": (place[0] + rng.choice((0.05, 0.062, 0.2, 0.195)), 0.0, 0.0)},
        {"pose": (AT_THE_CORNER + rng.choice((-1e-6, 0.0, 1e-10, 1e-6)), AT_THE_CORNER - 0.5, 0.0)},
        {"left_angle": 0.0, "pose": (place[0] + 0.02, 0.0, 0.0)}, {"left_speed": 1.0, "latch": 7},
    )  # fmt: skip
    return well._replace(**rng.choice(changes)) if rng.random() < 0.3 else well


@pytest.mark.parametrize("seed", range(40))
def test_of_wheels_that_stand_the_same_is_told_with_the_scan_and_without(seed: int) -> None:
    """Each robot is told and turns the same way for a while, long enough to be named or not."""
    rng, told = random.Random(seed), 0
    alone, guided, scan = MonitorState(), MonitorState(), Scan(SETTINGS)
    now_ns, wheels, left = 1_000_000 * MS, [(0.0,) * 4] * N, [0] * N
    for _ in range(120):
        now_ns += 40 * MS
        for row in range(N - 1):
            left[row] -= 1
            if left[row] <= 0:
                left[row] = rng.choice((5, 24, 25, 26, 40))
                wheels[row] = (
                    *rng.choices((0.0, 0.5, -0.5, 0.51), k=2), *rng.choices((0.0, 1.99, 2.0, -2.0, 12.5), k=2),
                )  # fmt: skip
        robots = tuple(
            robot(random.Random(99), row, now_ns)._replace(
                left_angle=float(row > 0), **dict(zip(_WHEELS, wheels[row], strict=True))
            )
            for row in range(N)
        )
        view = FleetView(
            now_ns, robots, controller_ns=now_ns, controller_build=BUILD, tracker_ns=now_ns, tracker_build=BUILD
        )
        rows = view._replace(robots=Rows.of(robots))
        alone, expected = monitor.watch(alone, SETTINGS, Phase.RUNNING, view)
        suspects = scan.suspects(guided, Phase.RUNNING, rows)
        guided, happenings = monitor.watch(guided, SETTINGS, Phase.RUNNING, rows, suspects=suspects)
        assert happenings == expected
        told += len(expected)
    assert told > 5


@pytest.mark.parametrize("seed", range(40))
def test_the_same_is_told_with_the_scan_and_without(seed: int) -> None:
    rng, told = random.Random(seed), 0
    alone, guided, scan = MonitorState(), MonitorState(), Scan(SETTINGS)
    phase, now_ns = Phase.IDLE, 1_000_000 * MS
    for step in range(30):
        now_ns += 40 * MS
        if rng.random() < 0.2:
            phase = rng.choice(list(Phase))
        robots = tuple(robot(rng, row, now_ns) for row in range(N))
        if step and rng.random() < 0.3:  # what is wrong lasts
            assert alone.view is not None
            robots = tuple(alone.view.robots)
        view = FleetView(
            now_ns, robots, controller_ns=now_ns, controller_build=BUILD, tracker_ns=now_ns, tracker_build=BUILD
        )
        rows = view._replace(robots=Rows.of(robots))
        alone, expected = monitor.watch(alone, SETTINGS, phase, view)
        guided, happenings = monitor.watch(guided, SETTINGS, phase, rows, suspects=scan.suspects(guided, phase, rows))
        assert happenings == expected
        told += len(expected)
    assert told > 10


def test_a_healthy_fleet_is_not_looked_at() -> None:
    now_ns = 1_000_000 * MS
    well = (
        RobotView(
            now_ns, BUILD, SESSION, 10 + row, battery=0.9, left_angle=1.0, seen_ns=now_ns, pose=(0.3 * row, 0.0, 0.0)
        )
        for row in range(3)
    )
    view = FleetView(now_ns, Rows.of(tuple(well)))
    suspects = Scan(SETTINGS._replace(body_radius=(0.05,) * 3, max_speed=(0.3,) * 3)).suspects(
        MonitorState(), Phase.RUNNING, view
    )
    assert suspects == ((), (), False, False, False)


def test_rows_are_the_robots_that_they_were_made_of() -> None:
    rng = random.Random(1)
    robots = tuple(robot(rng, row, 1_000_000 * MS) for row in range(N))
    rows = Rows.of(robots)
    assert tuple(rows) == robots
    assert [rows[row] for row in range(N)] == list(robots)
    assert tuple(rows[2:4]) == robots[2:4]
    assert Rows.of(rows) is rows
