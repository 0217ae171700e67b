"""Serial ports as the doctor sees them: whose they are, who may open them, who has them open, and rules to paste."""

import os
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from serial.tools import list_ports

from robofleet.config.load import load_config
from robofleet.doctor import permission, serial_ports
from robofleet.doctor.findings import Finding, Mark
from robofleet.doctor.needs import Needs

LAB = Path(__file__).parents[2] / "configs" / "lab.yaml"
PAIR = re.compile(r'\s*[A-Z]+(\{[\w/.]+\})?\s*(==|!=|\+=|:=|=)\s*"[^"]*"\s*(,|$)')
Ports = list[str]


@pytest.fixture
def ports(tmp_path: Path) -> Iterator[Ports]:
    """Return the paths of three ports that are there, and that nobody has open but this process."""
    pairs = [os.openpty() for _ in range(3)]
    yield [os.ttyname(host) for _, host in pairs]
    for pair in pairs:
        for end in pair:
            os.close(end)


def plugged(monkeypatch: pytest.MonkeyPatch, *adapters: dict[str, Any]) -> None:
    known = {"manufacturer": None, "product": None, "vid": None, "pid": None, "serial_number": None, "location": None}
    monkeypatch.setattr(list_ports, "comports", lambda: [SimpleNamespace(**known | device) for device in adapters])


def adapter(path: str, number: str | None, location: str, **more: Any) -> dict[str, Any]:
    return {"device": path, "vid": 0x0403, "pid": 0x6001, "serial_number": number, "location": location, **more}


def looked_at(needs: Needs) -> dict[str, Finding]:
    return {finding.name: finding for finding in serial_ports.serial_ports(needs)}


def lab(*ports: str) -> Needs:
    """Return the laboratory with these ports, in the order of its robots."""
    changes = [f"robots.{i}.settings.port={port}" for i, port in enumerate(ports)]
    return Needs(load_config(LAB, changes))


def test_a_port_says_what_is_plugged_in_and_who_has_it_open(ports: Ports, monkeypatch: pytest.MonkeyPatch) -> None:
    plugged(monkeypatch, adapter(ports[0], "A10K", "1-2", manufacturer="FTDI", product="FT232R"))
    found = looked_at(Needs())[ports[0]]
    assert found.mark is Mark.OK
    for words in ("FTDI FT232R", "0403:6001", "serial number A10K", f"open in process {os.getpid()}"):
        assert words in found.says


def test_a_port_of_the_configuration_that_somebody_has_open_or_that_is_not_there_is_missing(
    ports: Ports, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugged(monkeypatch)
    found = looked_at(lab(ports[0]))
    assert found["r1's port"].mark is Mark.MISSING
    assert f"open in process {os.getpid()} (" in found["r1's port"].says
    assert found["r1's port"].cure == "end that program before a run"
    assert "/dev/robofleet/r2: there is no such port" in found["r2's port"].says
    assert found["r2's port"].mark is Mark.MISSING
    monkeypatch.setattr(serial_ports, "holders", lambda _: [])
    assert looked_at(lab(ports[0]))["r1's port"].mark is Mark.OK


def test_a_port_that_this_user_may_not_open_names_its_group(ports: Ports, monkeypatch: pytest.MonkeyPatch) -> None:
    plugged(monkeypatch, adapter(ports[0], "A10K", "1-2"))
    monkeypatch.setattr(os, "access", lambda *_: False)
    group = SimpleNamespace(gr_name="dialout", gr_mem=["somebody"])
    monkeypatch.setattr(permission.grp, "getgrgid", lambda _: group)
    alone, named = looked_at(Needs())[ports[0]], looked_at(lab(ports[0]))["r1's port"]
    assert (alone.mark, named.mark) == (Mark.WARN, Mark.MISSING)
    assert re.fullmatch(r"`sudo usermod --append --groups dialout \S+`, then log in again", named.cure)
    group.gr_mem.append(permission.user_name())
    assert looked_at(Needs())[ports[0]].cure.startswith("log out and in again")


def test_no_port_is_opened(ports: Ports, monkeypatch: pytest.MonkeyPatch) -> None:
    plugged(monkeypatch, *(adapter(port, "A10K", "1-2") for port in ports))
    opened: list[object] = []
    needs = lab(*ports)
    monkeypatch.setattr(os, "open", lambda *a, **k: opened.append(a))
    looked_at(needs)
    assert opened == []


def test_rules_are_lines_of_pairs_that_name_each_robots_port(ports: Ports, monkeypatch: pytest.MonkeyPatch) -> None:
    plugged(monkeypatch, *(adapter(port, f"A{k}", f"1-{k}") for k, port in enumerate(ports)))
    rules = [paste.line for found in looked_at(lab(ports[2], ports[0])).values() for paste in found.pastes]
    assert len(rules) == 3
    assert [PAIR.sub("", rule) for rule in rules] == ["", "", ""]
    names = dict(re.findall(r'SHORT\}=="(\w+)".*SYMLINK\+="robofleet/(\w+)"', rule)[0] for rule in rules)
    assert names == {"A2": "r1", "A0": "r2", "A1": "r3"}  # r3's port is not there: it is the one that is left


def test_a_chip_whose_number_is_not_its_own_is_named_by_its_socket(
    ports: Ports, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugged(
        monkeypatch,
        adapter(ports[0], None, "1-1"),
        adapter(ports[1], "0001", "1-2"),
        adapter(ports[2], "0001", "1-3.4"),
    )
    rules = [paste.line for found in looked_at(Needs()).values() for paste in found.pastes]
    assert [re.findall(r'KERNELS=="([^"]+)"', rule) for rule in rules] == [["1-1"], ["1-2"], ["1-3.4"]]
    assert not any("SHORT" in rule for rule in rules)


def test_a_chip_with_several_ports_gets_a_rule_for_each(ports: Ports, monkeypatch: pytest.MonkeyPatch) -> None:
    plugged(monkeypatch, adapter(ports[0], "FT4", "1-1:1.0"), adapter(ports[1], "FT4", "1-1:1.1"))
    rules = [paste.line for found in looked_at(Needs()).values() for paste in found.pastes]
    assert [re.findall(r'INTERFACE_NUM\}=="(\w+)"', rule) for rule in rules] == [["00"], ["01"]]
    assert all('SHORT}=="FT4"' in rule for rule in rules)
