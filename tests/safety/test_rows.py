"""The robots of a view in an array: they are the robots that they were made of, and who is too close is found."""

import random
from itertools import combinations
from math import dist

import pytest

from robofleet.safety import monitor
from robofleet.safety.monitor import MonitorSettings, MonitorState
from robofleet.safety.supervisor import Event, Happening, Phase
from robofleet.safety.view import NEVER, FleetView, RobotView, Rows

NOW = 10**12
N = 40


def drawn(rng: random.Random) -> tuple[RobotView, ...]:
    """Return robots in a small room, some never seen, the last ones bystanders."""
    return tuple(
        RobotView(
            battery=rng.random(), lost=rng.random() < 0.5, blocked=rng.random() < 0.5, driven=row < N - 5,
            seen_ns=rng.choice((NOW, NOW, NEVER)), latch_id=2**63 + row,
            pose=(rng.uniform(-0.25, 0.25), rng.uniform(-0.25, 0.25), rng.uniform(-3.0, 3.0)),
        )
        for row in range(N)
    )  # fmt: skip


def test_rows_are_the_robots_that_they_were_made_of() -> None:
    robots = drawn(random.Random(1))
    rows = Rows.of(robots)
    assert tuple(rows) == robots
    assert [rows[row] for row in range(N)] == list(robots)
    assert tuple(rows[2:4]) == robots[2:4]
    assert Rows.of(rows) is rows


@pytest.mark.parametrize("seed", range(10))
def test_who_is_too_close_is_what_comparing_all_would_say(seed: int) -> None:
    rng = random.Random(seed)
    robots, radii = drawn(rng), tuple(rng.choice((0.02, 0.05, 0.09)) for _ in range(N))
    settings = MonitorSettings(
        build=0, body_radius=radii, wheel_radius=(0.016,) * N, wheel_base=(0.105,) * N, arena=(2.0, 2.0),
        max_speed=(0.3,) * N, attended=False, stale_ticks=8,
    )  # fmt: skip
    _, happenings = monitor.watch(MonitorState(), settings, Phase.RUNNING, FleetView(NOW, robots))
    close = [
        Happening(Event.TOO_CLOSE, a, b)
        for a, b in combinations(range(N), 2)
        if robots[a].driven and NEVER not in (robots[a].seen_ns, robots[b].seen_ns)
        and dist(robots[a].pose[:2], robots[b].pose[:2]) - (radii[a] + radii[b]) < 0.005
    ]  # fmt: skip
    assert len(close) > 20
    assert [happening for happening in happenings if happening.event is Event.TOO_CLOSE] == close
