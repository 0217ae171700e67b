"""A few seeds of ``tools.measure.behaviours.obstacle_trials``, whose command drives 200."""

import pytest

from tools.measure.behaviours import obstacle_trials as obstacles


@pytest.mark.slow
@pytest.mark.parametrize(("behaviour", "seed"), [("go_to", 2), ("cyclic_pursuit", 1), ("cyclic_pursuit", 14)])
def test_robots_among_obstacles_arrive_and_keep_their_gap(behaviour: str, seed: int) -> None:
    """In seed 14 a robot must come out of an obstacle's notch, to the left."""
    trial = obstacles.drive(behaviour, seed)
    assert obstacles.arrived(behaviour, trial)
    assert trial.gap_mm >= obstacles.LEAST_GAP_MM
