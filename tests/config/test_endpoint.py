"""A bus that strangers can reach is refused to every process, not by ``run`` and ``check`` alone."""

from pathlib import Path

import pytest

from robofleet.config.load import ConfigError, load_config

PLATOON = Path(__file__).parent.parent.parent / "configs" / "platoon.yaml"


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:7447", "tcp/192.168.1.7:7447", "tcp/lab:7447", "tcp/[::]:7447"])
def test_an_address_beyond_loopback_is_refused(endpoint: str) -> None:
    with pytest.raises(ConfigError, match=r"bus\.endpoint: .* can be reached from outside"):
        load_config(PLATOON, [f"bus.endpoint={endpoint}"])


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:7447", "tcp/127.0.0.2:65535", "tcp/[::1]:7447", "tcp/localhost:0"])
def test_loopback_is_taken(endpoint: str) -> None:
    assert load_config(PLATOON, [f"bus.endpoint={endpoint}"]).bus.endpoint == endpoint


def test_a_port_is_at_most_65535() -> None:
    with pytest.raises(ConfigError, match="there is no port 65536"):
        load_config(PLATOON, ["bus.endpoint=tcp/127.0.0.1:65536"])
