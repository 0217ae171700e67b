"""The shipped platoon with keys changed."""

from collections.abc import Callable
from pathlib import Path

import pytest

from robofleet.config.load import load_config
from robofleet.config.tree import Config

PLATOON = Path(__file__).parents[2] / "configs" / "platoon.yaml"


@pytest.fixture(scope="session")
def platoon_of() -> Callable[..., Config]:
    return lambda *overrides: load_config(PLATOON, overrides)
