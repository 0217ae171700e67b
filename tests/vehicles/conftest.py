"""Robots to test with: GTernal's geometry, without errors and with all of them."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import Imperfections
from robofleet.vehicles.plant import Plant
from tests.robots import GTERNAL, IDEAL, WORN


@pytest.fixture(scope="session")
def drive() -> DifferentialDrive:
    return GTERNAL


@pytest.fixture(scope="session")
def worn() -> Imperfections:
    return WORN


@pytest.fixture(scope="session")
def ideal_but(drive: DifferentialDrive) -> Callable[..., Plant]:
    """Return a plant at the origin with only the imperfections named."""

    def make(seed: int = 1, pose: tuple[float, float, float] = (0.0, 0.0, 0.0), **imperfections: Any) -> Plant:
        return Plant(drive, replace(IDEAL, **imperfections), pose, np.random.default_rng(seed))

    return make
