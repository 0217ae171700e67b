"""A supervisor alone, with a fleet that is played for it."""

from collections.abc import Callable
from typing import Any

import pytest

from robofleet.safety import arming
from tests.nodes.stand import Stand

Make = Callable[..., Any]


@pytest.fixture
def stand_of(bench_of: Make, platoon_of: Make, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Stand]:
    monkeypatch.setattr(arming, "step", arming.step)  # put back at the end
    return lambda *overrides, **keys: Stand(bench_of(platoon_of(*overrides)), **keys)


@pytest.fixture
def stand(stand_of: Callable[..., Stand]) -> Stand:
    return stand_of()
