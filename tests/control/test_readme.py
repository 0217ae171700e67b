"""The example of one's own model runs as it stands in the README."""

import re
from pathlib import Path

import robofleet.control

README = Path(robofleet.control.__file__).parent / "README.md"


def test_the_example_of_ones_own_model_follows_its_reference(capsys) -> None:
    (example,) = re.findall(r"```python\n(.*?)```", README.read_text(), re.DOTALL)
    exec(example, {"__name__": "example"})
    said = re.fullmatch(r"off by (\S+) rad after 10 s\n", capsys.readouterr().out)
    assert said is not None
    assert float(said[1]) < 0.01
