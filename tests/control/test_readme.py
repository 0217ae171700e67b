"""The examples of one's own model run as they stand: in the room's README, and in the project's."""

import math
import re
from pathlib import Path

import pytest

import robofleet

PACKAGE = Path(robofleet.__file__).parent


@pytest.mark.parametrize(
    "readme", [PACKAGE / "control" / "README.md", PACKAGE.parent / "README.md"], ids=["room", "project"]
)
def test_the_example_of_ones_own_model_follows_its_reference(readme: Path) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", readme.read_text(), re.DOTALL)
    names: dict[str, object] = {"__name__": "example"}
    exec(example, names)
    angle, _ = names["x"]  # type: ignore[misc]
    assert abs(angle - math.sin(10.0)) < 0.01
