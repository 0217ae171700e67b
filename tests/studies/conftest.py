"""The shipped platoon with keys changed."""

from collections.abc import Callable

import pytest

from robofleet.config.load import load_config
from robofleet.config.tree import Config
from tests.shipped import PLATOON


@pytest.fixture(scope="session")
def platoon_of() -> Callable[..., Config]:
    return lambda *overrides: load_config(PLATOON, overrides)
