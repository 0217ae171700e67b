"""What is said with valid sizes and hostile content ends no process, and keeps no fleet from saying how it is."""

import pytest

from robofleet.config.load import load_config
from tests.processes.hostile_messages import CONFIGS, TRUTH, attack


def _hold(name: str, messages: int) -> None:
    figures = attack(load_config(CONFIGS / f"{name}.yaml", [TRUTH]), messages, 1)
    assert min(figures.messages.values()) >= messages
    assert figures.starts >= figures.fleets, "each was attacked while it drove"
    assert figures.endings.total() == figures.fleets


def test_messages_with_hostile_content_end_no_process() -> None:
    _hold("teleop", 200)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["two-cameras", "script"])
def test_ten_thousand_messages_on_every_topic_end_no_process(name: str) -> None:
    _hold(name, 10_000)
