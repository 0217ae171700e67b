"""What is said with valid sizes and hostile content ends no process and no listener, and a fleet says how it is."""

import pytest

from robofleet.config.load import load_config
from tools.measure.runs.hostile_messages import CONFIGS, TRUTH, attack

BOTH = "groups=[{name: a, behaviour: script, robots: [r1, r2]}, {name: b, behaviour: teleop, robots: [r3, r4]}]"


def _hold(name: str, messages: int, *more: str, whole: bool = True) -> None:
    figures = attack(load_config(CONFIGS / f"{name}.yaml", [TRUTH, *more]), messages, 1, whole=whole)
    assert min(figures.messages.values()) >= messages
    assert figures.starts >= figures.fleets, "each was attacked while it drove"
    assert figures.endings.total() == figures.fleets


@pytest.mark.slow
def test_messages_with_hostile_content_end_no_process_and_no_listener() -> None:
    _hold("teleop", 60, BOTH, "robots.0.sensors=true", whole=False)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::Warning:rerun", "ignore::Warning:robofleet.gateways.viewers.rerun")  # too large
@pytest.mark.parametrize("name", ["platoon", "two-cameras", "script", "teleop", "go-to"])
def test_ten_thousand_messages_on_every_topic_end_no_process(name: str) -> None:
    _hold(name, 10_000)
