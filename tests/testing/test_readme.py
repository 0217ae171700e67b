"""What the room's README shows does what it says."""

import re
import sys
from pathlib import Path
from typing import Any

import pytest

import robofleet.testing
from robofleet import ConfigError, load_config
from robofleet.config.files.names import SHIPPED
from robofleet.testing import FakeDriver, run_lockstep

GUIDE = Path(robofleet.testing.__file__).with_name("README.md")
EXAMPLES = re.findall(r"^```python\n(.*?)^```$", GUIDE.read_text(), re.MULTILINE | re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("code", [code for code in EXAMPLES if "def test_" in code], ids=["alone", "in lockstep"])
def test_the_example_of_a_behaviour_passes(code: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(SHIPPED)
    monkeypatch.setattr(sys, "path", [*sys.path, str(SHIPPED)])
    names: dict[str, Any] = {}
    exec(compile(code, str(GUIDE), "exec"), names)
    (check,) = (value for name, value in names.items() if name.startswith("test_"))
    check()


def test_every_name_is_in_the_guide() -> None:
    assert set(robofleet.testing.__all__) <= set(re.findall(r"`(\w+)`", GUIDE.read_text()))
    with pytest.raises(AttributeError, match="nothing"):
        robofleet.testing.nothing  # noqa: B018


@pytest.mark.slow
def test_a_run_in_lockstep_is_the_same_again() -> None:
    config = load_config(SHIPPED / "platoon.yaml", ["tracker.source=truth", "run.duration_s=1"])
    first, second = run_lockstep(config), run_lockstep(config)
    assert first.trace_hash == second.trace_hash != ""
    assert first.groups["platoon"].poses.shape == (len(first.groups["platoon"].t), 4, 3)
    assert first.summary["groups"].keys() == first.groups.keys()


def test_a_robot_that_is_not_simulated_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"robots\.0\.driver: .* keeps real time"):
        run_lockstep(load_config(SHIPPED / "platoon.yaml", ["robots.0.driver='robofleet.testing:FakeDriver'"]))
    assert not FakeDriver.instances
