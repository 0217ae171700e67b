"""The examples of models run as they stand in the room's README."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

import robofleet

README = Path(robofleet.__file__).parent / "control" / "README.md"


EXAMPLES = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)


def executed(example: str) -> dict[str, object]:
    names: dict[str, object] = {"__name__": "example"}
    exec(example, names)
    return names


@pytest.mark.long
def test_the_example_of_ones_own_model_follows_its_reference() -> None:
    angle, _ = executed(EXAMPLES[0])["x"]  # type: ignore[misc]
    assert abs(angle - math.sin(10.0)) < 0.01


@pytest.mark.slow
def test_the_example_of_a_learned_model_finds_the_force() -> None:
    plant = executed(EXAMPLES[1])["fit"].plant  # type: ignore[attr-defined]
    assert plant.f(np.array([0.5, 0.0]), np.array([1.0])) == pytest.approx([0.0, 2.0], abs=0.01)
