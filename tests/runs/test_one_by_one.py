"""One process of a run, started by hand."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.command import robofleet
from tests.endpoints import own_endpoint
from tests.shipped import PLATOON


@pytest.mark.parametrize("command", [["router"], ["controller"], ["driver", "--robots", "r1,r2,r3,r4"]], ids=" ".join)
def test_a_port_that_nobody_else_can_know_is_refused(command: list[str], tmp_path: Path) -> None:
    config = tmp_path / "any.yaml"
    config.write_text(f"bus: {{endpoint: 'tcp/127.0.0.1:0', insecure: loopback}}\n{PLATOON.read_text()}")
    result = robofleet("node", *command, config)
    assert result.exit_code == 2
    assert "bus.endpoint" in result.stderr


@pytest.mark.slow
def test_a_lost_terminal_ends_a_process_well(tmp_path: Path) -> None:
    config = tmp_path / "fixed.yaml"
    endpoint = own_endpoint()
    config.write_text(f"bus: {{endpoint: '{endpoint}'}}\n{PLATOON.read_text()}")
    router = subprocess.Popen(
        [sys.executable, "-m", "robofleet", "node", "router", str(config)], stderr=subprocess.PIPE
    )
    assert router.stderr is not None
    with router.stderr:
        assert router.stderr.readline() == b"ready\n"
        router.send_signal(signal.SIGHUP)
        assert router.wait(10) == 0
