"""What the tests of the gate are run against."""

import pytest

from robofleet.safety import gate
from tests.safety.gated import Step


@pytest.fixture(scope="session")
def step() -> Step:
    return gate.step
