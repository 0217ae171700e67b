"""The driver that the README shows keeps the contract, as it stands there."""

import re
import sys
from pathlib import Path
from types import ModuleType

from tests.drivers.contract import Contract, Subject

README = Path(__file__).parents[2] / "drivers" / "README.md"
(CODE,) = re.findall(r"^```python\n(.*?)^```$", README.read_text(), re.MULTILINE | re.DOTALL)

sparrow = sys.modules["sparrow"] = ModuleType("sparrow")
exec(compile(CODE, str(README), "exec"), sparrow.__dict__)


class TestExample(Contract):
    subject = Subject("sparrow:Sparrow", twin="tests.drivers.line_robot:LineFirmware")


def test_it_is_forty_lines() -> None:
    assert len([line for line in CODE.splitlines() if line]) <= 40
