"""Formation: the shape stays a shape while it moves; places that cannot be are refused."""

from typing import Any

import numpy as np
import pytest

from robofleet.behaviours.formation import Formation
from robofleet.testing import drive, make, refusals, team
from tests.behaviours.test_track import OVAL

WIDE = {"knots": [{k: [v[0], 1.4 * v[1]] for k, v in knot.items()} for knot in OVAL["knots"]]}
SHAPE: dict[str, Any] = {"path": WIDE, "path_rate": 0.05, "offsets_m": [[0.25, 0.0], [0.0, 0.25], [0.0, -0.25]]}


@pytest.mark.slow_after_first
@pytest.mark.parametrize("heading", [{}, {"heading_deg": 30.0}])
def test_the_distances_between_the_points_stay_those_of_the_shape(heading: dict[str, float]) -> None:
    behaviour = make(Formation, SHAPE | heading, team(3))
    past = drive(behaviour, np.array(behaviour.places()), 40.0)
    offsets = np.array(SHAPE["offsets_m"])
    for i, j in ((0, 1), (0, 2), (1, 2)):
        apart = np.linalg.norm(past.points[past.settled, i] - past.points[past.settled, j], axis=-1)
        assert apart == pytest.approx(np.linalg.norm(offsets[i] - offsets[j]), abs=2e-3)
    assert past.figures["shape_error"][past.settled].max() < 2e-3
    assert behaviour.measures(past)[0].values[past.settled].max() < 4e-3


def test_the_shape_turns_with_the_path_or_keeps_its_heading() -> None:
    turning, fixed = (make(Formation, SHAPE | more, team(3)) for more in ({}, {"heading_deg": 0.0}))
    ahead = [np.array(behaviour.shapes()[1].points) - behaviour.shapes()[0].points for behaviour in (turning, fixed)]
    assert np.linalg.norm(ahead[0], axis=1) == pytest.approx(0.25)
    assert np.ptp(np.unwrap(np.arctan2(ahead[0][:, 1], ahead[0][:, 0]))) > 6.0
    assert ahead[1] == pytest.approx(np.tile([0.25, 0.0], (len(ahead[1]), 1)))


@pytest.mark.slow_after_first
@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"offsets_m": [[0.0, 0.0]]}, "settings.offsets_m: has 1 places for 3 robots"),
        ({"offsets_m": [[0.0, 0.0], [0.0, 0.1], [0.3, 0.0]]}, "settings.offsets_m: the distance of two robots"),
        ({"offsets_m": [[0.0, 0.0], [0.0, -0.7], [0.3, 0.0]]}, "settings.path: the path's reach in y"),
        ({"path_rate": 0.3}, "settings.path_rate: the fastest wheel along the path"),
        ({"path": {"knots": [{"at_m": [0, 0], "derivative_m": [0, 0]}, {"at_m": [1, 0], "derivative_m": [1, 1]}]}},
         "settings.path: the path's smallest derivative"),
    ],
)  # fmt: skip
def test_formations_that_cannot_be_are_refused(change: dict[str, Any], complaint: str) -> None:
    assert refusals(make(Formation, SHAPE, team(3))) == []
    found = refusals(make(Formation, SHAPE | change, team(3)))
    assert found
    assert found[0].startswith(complaint)
