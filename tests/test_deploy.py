"""``tools/deploy``: what systemd and udev would refuse or, worse, ignore."""

import configparser
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from robofleet.config.load import load_config
from robofleet.nodes import node
from robofleet.runs import table

ROOT = Path(__file__).parent.parent
DEPLOY = ROOT / "tools" / "deploy"
UNIT = DEPLOY / "robofleet-driver@.service"
PAIR = re.compile(r'\s*[A-Z]+(\{[\w/.]+\})?\s*(==|!=|\+=|:=|=)\s*"[^"]*"\s*(,|$)')


def rules() -> list[str]:
    lines = (DEPLOY / "70-robofleet.rules").read_text().splitlines()
    return [line for line in lines if line and not line.startswith("#")]


def unit() -> configparser.ConfigParser:
    parser = configparser.ConfigParser(strict=False, interpolation=None)  # a key may stand there twice
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read(UNIT)
    return parser


@pytest.mark.parametrize("line", rules())
def test_a_rule_is_pairs_and_nothing_else(line: str) -> None:
    assert not PAIR.sub("", line), "udev ignores a line with anything else in it, also a comment behind the rule"


def test_no_rule_asks_a_parent_what_it_is_not() -> None:
    assert not any(re.match(r"[A-Z]+S(\{\w+\})?!=", line) for line in rules()), "some parent always is not that"


def test_the_laboratorys_ports_are_the_names_that_the_rules_give() -> None:
    named = {f"/dev/{name}" for line in rules() for name in re.findall(r'SYMLINK\+="([^"]+)"', line)}
    config = load_config(ROOT / "configs" / "lab.yaml")
    assert named == {robot.settings["port"] for robot in config.robots}


def test_the_service_lets_a_driver_do_what_it_does() -> None:
    service = unit()["Service"]
    assert re.fullmatch(r"\S+/robofleet node driver \S+ --robots %i", service["ExecStart"])
    assert service["Type"] == "notify"
    assert service["RestartPreventExitStatus"] == "2"
    assert int(service["LimitNICE"]) <= node.NICE
    assert int(service["LimitRTPRIO"]) >= table.DRIVER.priority
    assert service["StateDirectory"] == "robofleet"
    assert "XDG_STATE_HOME=/var/lib" in service["Environment"].split()
    assert (service["RuntimeDirectory"], service["RuntimeDirectoryMode"]) == ("robofleet", "0700")
    assert service["RuntimeDirectoryPreserve"] == "yes", "the socket must outlive a driver"
    endpoint = re.search(r"^    bus: \{endpoint: (\S+)\}$", (DEPLOY / "README.md").read_text(), re.MULTILINE)
    assert endpoint is not None
    assert endpoint[1].startswith("unixsock-stream//run/robofleet/")
    load_config(ROOT / "configs" / "lab.yaml", [f"bus.endpoint={endpoint[1]}"])
    assert service["KillMode"] == "process", "the dead man's process must outlive its driver"
    assert service["SupplementaryGroups"] == "dialout"
    assert 'GROUP="dialout"' in (DEPLOY / "70-robofleet.rules").read_text()


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd here")
def test_systemd_has_nothing_to_complain_of(tmp_path: Path) -> None:
    program = tmp_path / "robofleet"  # where it is installed differs
    program.symlink_to("/bin/true")
    text = re.sub(r"ExecStart=\S+", f"ExecStart={program}", UNIT.read_text())
    (tmp_path / "robofleet-driver@r1.service").write_text(text)
    command = ["systemd-analyze", "verify", str(tmp_path / "robofleet-driver@r1.service")]
    found = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert (found.returncode, found.stderr) == (0, "")
