"""Robots without a ``start`` stand on their path; the resolved configuration says where."""

import math
from pathlib import Path

import numpy as np
import pytest

from robofleet.behaviours.platoon import Platoon
from robofleet.config import groups, slices
from robofleet.config.load import load_config
from robofleet.config.tree import Config

CONFIGS = Path(__file__).parent.parent.parent / "configs"
UNPLACED = [f"robots.{i}.start=null" for i in range(4)]


def platoon(*overrides: str) -> Config:
    return load_config(CONFIGS / "platoon.yaml", overrides)


def behaviour(config: Config) -> Platoon:
    (made,) = groups.behaviours(config)
    assert isinstance(made, Platoon)
    return made


@pytest.mark.parametrize("track", ["point", "centre"])
def test_left_out_starts_are_places_on_the_path(track: str) -> None:
    config = platoon(*UNPLACED, f"groups.0.settings.track={track}")
    settings, ahead = behaviour(config).settings, config.controller.point_ahead_m if track == "point" else 0.0
    path, sigma = settings.path.path(), 0.0
    for robot in config.members:
        x, y, psi = slices.start_pose(robot)
        along = np.array([math.cos(psi), math.sin(psi)])
        assert np.array([x, y]) + ahead * along == pytest.approx(path.position(sigma), abs=2e-4)
        assert along == pytest.approx(path.tangent(sigma), abs=1e-3)
        sigma = float(path.back(np.array([sigma]), settings.spacing_m)[0])


def test_one_that_is_left_out_stands_behind_the_one_that_it_follows() -> None:
    config = platoon("robots.2.start=null", "groups.0.robots=[r3, r1, r2, r4]")
    x, y, psi = behaviour(config).places()[0]
    assert slices.start_pose(config.robots[2]) == pytest.approx((x, y, psi), abs=1e-12)
    assert config.robots[0].start == platoon().robots[0].start


def test_a_path_without_such_places_leaves_them_out() -> None:
    assert [robot.start is None for robot in platoon(*UNPLACED, "groups.0.settings.spacing_m=9").robots] == [
        False, True, True, True,
    ]  # fmt: skip


def test_what_judges_a_start_follows_the_path_and_its_spacing() -> None:
    config = platoon()
    found, path = behaviour(config).ways(), behaviour(config).settings.path.path()
    sigma = np.arange(len(found.points)) * found.sides / len(found.points)
    assert found.points == pytest.approx(path.position(sigma), abs=1e-12)
    exact = path.back(sigma, found.spacing)
    steps = found.behind - exact * len(found.points) / found.sides
    assert np.abs((steps + 200) % 400 - 200).max() <= 1.0
