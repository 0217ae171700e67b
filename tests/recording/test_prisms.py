"""Obstacles in viewers: the triangles of a top fill its outline, and nothing else."""

import math

import numpy as np
import pytest
from foxglove_schemas_protobuf.Color_pb2 import Color

from robofleet.config.load import load_config
from robofleet.recording.scenes.shapes import arena, prism, triangles
from robofleet.vehicles.solids import Solid, area, distances
from tests.config.test_obstacles import OURS


@pytest.mark.parametrize("seed", range(20))
def test_triangles_fill_a_star(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle, reach = np.sort(rng.uniform(0.0, math.tau, 11)), rng.uniform(0.1, 1.0, 11)
    star = Solid("star", tuple(zip((reach * np.cos(angle)).tolist(), (reach * np.sin(angle)).tolist(), strict=True)))
    outline = star.outline.tolist()
    found = triangles(outline)
    assert len(found) == len(outline) - 2
    assert sum(area(triangle) for triangle in found) == pytest.approx(area(outline))
    assert min(area(triangle) for triangle in found) > -1e-12
    middles = np.array([np.mean(triangle, axis=0) for triangle in found])
    assert distances((star,), middles).max() < 1e-9


def test_every_obstacle_of_a_configuration_is_in_the_viewers_scene() -> None:
    config = load_config(OURS)
    entities = {entity.id: entity for entity in arena(config, (), None)}  # type: ignore[arg-type]
    assert {"arena", "obstacles/box", "obstacles/pillar", "obstacles/wall"} == set(entities)
    assert len(entities["arena"].lines) == 2, "the arena, and its floor"
    tops = {point.z for point in entities["obstacles/box"].triangles[0].points}
    assert tops == {0.0, 0.15}
    assert len(prism([(0, 0), (1, 0), (0, 1)], 1.0, Color()).points) == 3 + 3 * 6
