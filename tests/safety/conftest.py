"""What the tests of the gate are run against."""

import pytest

from robofleet.safety import gate
from tests.safety.gated import Step, compiled, plain


@pytest.fixture(scope="session", params=["plain", "compiled"])
def step(request: pytest.FixtureRequest) -> Step:
    return plain(gate.step) if request.param == "plain" else compiled
