"""The example of one's own model runs as it stands in the room's README."""

import math
import re
from pathlib import Path

import pytest

import robofleet

README = Path(robofleet.__file__).parent / "control" / "README.md"


@pytest.mark.long
def test_the_example_of_ones_own_model_follows_its_reference() -> None:
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    names: dict[str, object] = {"__name__": "example"}
    exec(example, names)
    angle, _ = names["x"]  # type: ignore[misc]
    assert abs(angle - math.sin(10.0)) < 0.01
