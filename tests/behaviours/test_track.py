"""Track: robots follow paths, tables and way points, with both laws; what cannot be followed is refused."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from robofleet.behaviours.track import Track
from robofleet.testing import drive, make, refusals, situation, team
from robofleet.testing.behaviours import TICK

OVAL = {
    "knots": [
        {"at_m": [0.8, 0.0], "derivative_m": [0.0, 0.66]},
        {"at_m": [0.0, 0.4], "derivative_m": [-1.33, 0.0]},
        {"at_m": [-0.8, 0.0], "derivative_m": [0.0, -0.66]},
        {"at_m": [0.0, -0.4], "derivative_m": [1.33, 0.0]},
    ]
}
ON_THE_OVAL: dict[str, Any] = {"path": OVAL, "path_rate": 0.1}
TABLE: dict[str, Any] = {"csv": [[1.0, -0.5, 0.0], [3.0, -0.4, 0.1], [8.0, 0.1, 0.2], [12.0, 0.2, 0.0]]}
WAY: dict[str, Any] = {"waypoints_m": [[-1.0, -0.5], [0.8, -0.6], [1.0, 0.4], [-0.5, 0.6]], "speed_m_s": 0.12}
ALPHA, T = 45.0, 0.6


def track(*references: dict[str, Any], law: str = "point_ahead", **settings: Any) -> Track:
    group = team(len(references))
    given = {f"r{k + 1}": reference for k, reference in enumerate(references)}
    behaviour = make(Track, {"law": law, "references": given} | settings, group)
    assert isinstance(behaviour, Track)
    return behaviour


def told(
    behaviour: Track, seconds: float, *, wind: tuple[float, float] = (0.0, 0.0), settle: float = 5.0
) -> np.ndarray:
    """Return each robot's timed errors [m] once it has settled, from its place."""
    past = drive(behaviour, np.array(behaviour.places()), seconds, wind=wind)
    settled = past.t > settle
    error = behaviour.measures(replace(past, settled=settled, spaced=settled))[0]
    assert error.counts is settled
    return error.values[settled]


def test_the_point_ahead_keeps_the_papers_bounds() -> None:
    """|r - g| is at most eta / alpha, sampled here, with eta = sup |r'(t + T) - u|; |p - r| at most T^2 / 2 |r''|."""
    behaviour = track(ON_THE_OVAL)
    past = drive(behaviour, np.array(behaviour.places()), 45.0)
    settled = past.t > 5.0
    way = behaviour.settings.references["r1"].trajectory(behaviour.team.drives[0], 0.08)
    u = np.diff(past.points[:, 0], axis=0) / TICK
    eta = np.linalg.norm(way.velocity(past.t[1:] + T) - u, axis=1)[settled[1:]].max()
    control_error = past.figures["control_error"][settled].max()
    assert 0.3 * eta * TICK < control_error < eta * TICK / -math.expm1(-ALPHA * TICK)
    instants = np.arange(0.0, 40.0, 0.01)
    bend = np.linalg.norm(np.diff(way.velocity(instants), axis=0), axis=1).max() / 0.01
    off = np.linalg.norm(past.points[:, 0] - way.position(past.t), axis=1)[settled].max()
    assert 0.3 * T * T / 2 * bend < off < T * T / 2 * bend + control_error


@pytest.mark.slow
@pytest.mark.parametrize("law", ["point_ahead", "unicycle"])
def test_a_told_disturbance_leaves_no_offset(law: str) -> None:
    straight = {"waypoints_m": [[-1.0, 0.0], [1.0, 0.0]], "speed_m_s": 0.1, "acceleration_m_s2": 1.0}
    still, blown = (told(track(straight, law=law), 15.0, wind=wind)[-60:].max() for wind in ((0.0, 0.0), (-0.02, 0.0)))
    assert still < 1e-4
    assert blown < 1e-4


@pytest.mark.slow_after_first
@pytest.mark.parametrize("law", ["point_ahead", "unicycle"])
def test_all_kinds_of_references_are_followed_to_millimetres(law: str) -> None:
    error = told(track(ON_THE_OVAL, TABLE, WAY, WAY | {"closed": True}, law=law), 30.0)
    assert np.median(error, axis=0).max() < 0.008
    assert error.max() < 0.025  # in the sharpest bends, and where a way ends


@pytest.mark.slow
def test_the_unicycle_turns_round_from_any_pose() -> None:
    behaviour = track(*[ON_THE_OVAL] * 8, law="unicycle")
    rng = np.random.default_rng(7)
    poses = np.column_stack([rng.uniform(-1.2, 1.2, 8), rng.uniform(-0.7, 0.7, 8), np.arange(8) * math.tau / 8])
    past = drive(behaviour, poses, 40.0)
    assert behaviour.measures(past)[0].values[-1].max() < 0.005


def test_a_table_stays_at_its_first_row_and_at_its_last() -> None:
    behaviour = track(TABLE)
    way = behaviour.shapes()[0]
    assert not way.closed
    assert way.points[-1] == pytest.approx([0.2, 0.0])
    past = drive(behaviour, np.array(behaviour.places()), 25.0)
    assert past.references[:5, 0] == pytest.approx(np.tile([-0.5, 0.0], (5, 1)))
    assert past.points[-1, 0] == pytest.approx([0.2, 0.0], abs=1e-3)


def test_it_goes_on_from_what_its_robots_were_really_asked_for() -> None:
    behaviour = track(ON_THE_OVAL)
    past = drive(behaviour, np.array(behaviour.places()), 5.0)
    now = situation(past.poses[-1], float(past.t[-1]))
    behaviour.changed(np.zeros((1, 2)))
    way = behaviour.settings.references["r1"].trajectory(behaviour.team.drives[0], 0.08)
    missing = np.linalg.norm(way.position(np.array([now.t + T])) - past.points[-1], axis=1)
    assert behaviour.decide(now).figures["control_error"] == pytest.approx(missing)  # the prediction of a robot at rest


@pytest.mark.parametrize("law", ["point_ahead", "unicycle"])
def test_good_settings_are_not_refused_and_their_dump_is_read_back(law: str) -> None:
    behaviour = track(ON_THE_OVAL, TABLE, WAY, WAY | {"closed": True}, law=law)
    again = make(Track, behaviour.settings.model_dump(mode="json"), team(4))
    assert refusals(behaviour) == refusals(again) == []
    assert again.settings == behaviour.settings


@pytest.mark.parametrize(
    ("reference", "complaint"),
    [
        ({}, "settings.references.r1: has none of path, csv and waypoints_m"),
        (ON_THE_OVAL | TABLE, "settings.references.r1: has path and csv: write one of them"),
        ({"path": OVAL}, "settings.references.r1: has path without path_rate"),
        ({"waypoints_m": [[0, 0], [1, 0]]}, "settings.references.r1: has waypoints_m without speed_m_s"),
        (TABLE | {"closed": True}, "settings.references.r1.closed: belongs to waypoints_m"),
        ({"csv": [[0, 0, 0], [2, 0.1, 0], [1, 0.2, 0]]}, "settings.references.r1.csv.2.0: 1 s does not come after 2 s"),
        (WAY | {"waypoints_m": [[0, 0], [0, 0], [1, 0]]}, "settings.references.r1.waypoints_m.1: is where"),
        (WAY | {"waypoints_m": [[0, 0], [1, 0]], "closed": True}, "settings.references.r1.waypoints_m: a closed way"),
        (ON_THE_OVAL | {"path_rate": 0.3}, "settings.references.r1.path_rate: the fastest wheel along the path"),
        ({"csv": [[0, 0, 0], [1, 0.5, 0]]}, "settings.references.r1.csv: the fastest wheel along the path"),
        (WAY | {"speed_m_s": 0.5}, "settings.references.r1.speed_m_s: speed_m_s"),
        (WAY | {"waypoints_m": [[0, 0], [1, 0], [0.2, 0]]}, "settings.references.r1.waypoints_m: the radius"),
        (WAY | {"waypoints_m": [[0, 0], [1.58, 0]]}, "settings.references.r1.waypoints_m: the path's reach in x"),
    ],
)
def test_what_cannot_be_followed_is_refused(reference: dict[str, Any], complaint: str) -> None:
    found = refusals(track(reference))
    assert found
    assert found[0].startswith(complaint)


def test_the_speed_that_a_refusal_names_is_accepted() -> None:
    found = refusals(track(ON_THE_OVAL | {"path_rate": 0.3}))
    fits = min(float(line.split("path_rate ")[1].split(" fits")[0]) for line in found)
    assert refusals(track(ON_THE_OVAL | {"path_rate": fits})) == []
    assert refusals(track(ON_THE_OVAL | {"path_rate": 1.02 * fits}))


def test_robots_and_references_belong_together() -> None:
    behaviour = make(Track, {"references": {"r1": ON_THE_OVAL, "r3": ON_THE_OVAL}}, team(2))
    found = refusals(behaviour)
    assert [line.partition(":")[0] for line in found] == ["robots.1", "settings.references.r3"]
