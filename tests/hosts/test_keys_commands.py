"""``robofleet keys`` and ``robofleet join``: from an authority to a robot; what is refused writes nothing."""

import json
import os
import re
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import yaml

from robofleet.bus import credentials as credentials_of
from robofleet.config.files.robot_file import RobotFile, load_robot_file, robot_file
from robofleet.core import folders
from robofleet.core.clock import utc_now
from robofleet.hosts import authority as authorities
from robofleet.hosts import bundle as bundles
from robofleet.hosts import join_command
from robofleet.nodes import node
from robofleet.runs import daemon
from tests.command import robofleet

CONFIGS = Path(__file__).parents[2] / "configs"
DEPLOY = Path(__file__).parents[2] / "tools" / "deploy"
NOBODY = 65534
ROUTER = "quic/192.168.1.10:7447"
BEGIN, END = "-----BEGIN ", "-----END "


@pytest.fixture(autouse=True)
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the laboratory's folder; nothing of this computer's own is read or written."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setattr(folders, "SYSTEM", tmp_path / "etc")
    monkeypatch.setattr(join_command, "_SERVICE", tmp_path / "systemd" / "robofleet-unit.service")
    monkeypatch.setattr(join_command, "_is_root", lambda: False)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def said(*words: object) -> list[str]:
    """Return the lines of a command that works."""
    done = robofleet(*words)
    assert done.exit_code == 0, done.output
    assert done.stderr == ""
    return done.stdout.splitlines()


def refused(*words: object) -> str:
    """Return the one line of a command that is refused."""
    done = robofleet(*words)
    assert done.exit_code == 2, done.output
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    return line


@pytest.fixture
def lab(desk: Path) -> Path:
    """Return the folder of lab's authority, which knows a router, r1 and an operator."""
    said("keys", "init", "lab")
    said("keys", "add", "lab", "router", "--address", "192.168.1.10")
    said("keys", "add", "lab", "r1")
    said("keys", "add", "lab", "alice", "--kind", "operator")
    return desk / "config" / "robofleet" / "keys" / "lab"


@pytest.fixture
def bundle(lab: Path) -> Path:
    """Return the bundle of r1."""
    said("keys", "bundle", "lab", "r1", "--router", ROUTER)
    return Path("r1.bundle").absolute()


def clock_says(monkeypatch: pytest.MonkeyPatch, at: Callable[[], datetime]) -> None:
    for module in (authorities, bundles, credentials_of):
        monkeypatch.setattr(module, "utc_now", at)
    monkeypatch.setattr("robofleet.hosts.keys_commands.utc_now", at)


def later(monkeypatch: pytest.MonkeyPatch, days: float) -> None:
    """Set this computer's clock ahead."""
    now = utc_now() + timedelta(days=days)
    clock_says(monkeypatch, lambda: now)


def names(arena: str = "lab") -> dict[str, dict[str, Any]]:
    listed = json.loads("\n".join(said("keys", "list", arena, "--json")))
    assert listed["arena"] == arena
    return {row["name"]: row for row in listed["names"]}


def tree(folder: Path) -> dict[Path, bytes]:
    return {file: file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


def test_from_nothing_to_a_robot_that_has_joined(lab: Path, bundle: Path, desk: Path) -> None:
    assert stat.S_IMODE(bundle.stat().st_mode) == 0o600
    robot = desk / "robot"
    lines = said("join", bundle, "--into", robot)
    assert len(lines) <= 5
    assert "robofleet node driver --unit r1" in "\n".join(lines)
    assert load_robot_file(robot / "robot.yaml") == RobotFile(arena="lab", unit="r1", router=(ROUTER,))
    keys = robot / "keys" / "lab"
    assert stat.S_IMODE(keys.stat().st_mode) == 0o700
    for name in ("r1.key", "r1.pem", "authority.pem"):
        assert (keys / name).read_bytes() == (lab / name).read_bytes()
        assert stat.S_IMODE((keys / name).stat().st_mode) == 0o600
    assert not (keys / "authority.key").exists()


def test_the_authoritys_key_is_in_no_bundle(lab: Path, bundle: Path) -> None:
    secret = (lab / "authority.key").read_text().splitlines()[1]
    assert secret not in bundle.read_text()
    own = (lab / "r1.key").read_text().splitlines()[1]
    assert own in bundle.read_text()


@pytest.mark.slow_after_first
@pytest.mark.parametrize("name", ["no", "null", "on", "e1", "true"])
@pytest.mark.parametrize("router", ["quic/[fe80::1]:7447", "tls/lab,x:1", ROUTER])
def test_what_yaml_reads_otherwise_is_joined_as_it_is(lab: Path, desk: Path, name: str, router: str) -> None:
    said("keys", "add", "lab", name, "--kind", "unit")
    said("keys", "bundle", "lab", name, "--router", router, "--router", ROUTER)
    said("join", f"{name}.bundle", "--into", desk / "robot")
    assert load_robot_file(desk / "robot" / "robot.yaml") == RobotFile(arena="lab", unit=name, router=(router, ROUTER))


@pytest.mark.slow
def test_a_robot_takes_no_library_that_signs(bundle: Path, desk: Path) -> None:
    script = (
        "import sys; sys.modules['cryptography'] = None; from robofleet.cli import app\n"
        f"app(['join', {str(bundle)!r}, '--into', {str(desk / 'robot')!r}])"
    )
    subprocess.run([sys.executable, "-c", script], capture_output=True, check=True)
    assert (desk / "robot" / "robot.yaml").exists()
    script = (
        "import sys; sys.modules['cryptography'] = None; from robofleet.cli import app; app(['keys', 'list', 'lab'])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "this needs cryptography" in line


def test_a_list_says_who_may_join_and_until_when(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said("keys", "add", "lab", "short", "--days", "20")
    said("keys", "add", "lab", "lost")
    said("keys", "revoke", "lab", "lost")
    said("keys", "add", "lab", "long", "--days", "400")
    later(monkeypatch, 80)
    assert {name: (row["kind"], row["state"]) for name, row in names().items()} == {
        "alice": ("operator", "ends soon"), "long": ("unit", "valid"), "lost": ("unit", "revoked"),
        "r1": ("unit", "ends soon"), "router": ("router", "ends soon"), "short": ("unit", "expired"),
    }  # fmt: skip
    head, *rows = said("keys", "list", "lab")
    assert head.split() == ["name", "kind", "valid", "until", "state"]
    assert [re.split(r"\s{2,}", row.strip())[::3] for row in rows] == [
        [name, row["state"]] for name, row in names().items()
    ]


def test_a_kind_is_known_by_its_name_or_said(lab: Path) -> None:
    for name in ("controller", "supervisor", "tracker", "recorder", "viewer", "operator"):
        said("keys", "add", "lab", name)
        assert names()[name]["kind"] == name
    assert names()["alice"]["kind"] == "operator"
    assert names()["r1"]["kind"] == "unit"


def test_a_roster_is_added_and_only_what_it_lacks(desk: Path) -> None:
    said("keys", "init", "lab")
    words = ("keys", "add", "lab", "--from", CONFIGS / "lab.yaml", "--address", "192.168.1.10")
    first = said(*words)
    kinds = {name: row["kind"] for name, row in names().items()}
    assert kinds == {
        "r1": "unit", "r2": "unit", "r3": "unit", "router": "router", "operator": "operator", "viewer": "viewer",
    }  # fmt: skip
    assert names()["router"]["addresses"] == ["192.168.1.10"]
    assert len(first) == len(kinds) + 1
    assert first[-1].startswith("Next: robofleet keys bundle lab r1 ")
    said("keys", "revoke", "lab", "r2")
    before = tree(desk)
    assert said(*words)[0] == "r2: revoked, and stays so: `robofleet keys add lab r2` lets it in again"
    assert tree(desk) == before


def test_simulated_robots_get_no_keys(desk: Path) -> None:
    said("keys", "init", "platoon")
    said("keys", "add", "platoon", "--from", CONFIGS / "platoon.yaml", "--address", "lab.local")
    assert {*names("platoon")} == {"router", "operator", "viewer"}


def changed_configuration(desk: Path, name: str, change: Callable[[dict[str, Any]], object]) -> Path:
    """Write a shipped configuration, changed, beside links to all that it names."""
    tree = yaml.safe_load((CONFIGS / name).read_text())
    change(tree)
    for path in CONFIGS.iterdir():
        if path.name != name:
            (desk / path.name).symlink_to(path)
    (desk / name).write_text(yaml.safe_dump(tree))
    return desk / name


@pytest.mark.parametrize(("started_by", "units"), [("run", set()), ("daemon", {"r1"})])
def test_a_twin_gets_keys_where_a_daemon_drives_it(desk: Path, started_by: str, units: set[str]) -> None:
    def change(tree: dict[str, Any]) -> None:
        tree |= {"drivers": {"started_by": started_by}, "bus": {"listen": [ROUTER]}}
        tree["robots"][0] |= {"driver": "gternal", "twin": "gternal", "unit": "r1"}

    said("keys", "init", "platoon")
    said("keys", "add", "platoon", "--from", changed_configuration(desk, "platoon.yaml", change))
    assert {*names("platoon")} == {"router", "operator", "viewer", *units}


def test_the_routers_address_is_where_the_configuration_listens(desk: Path) -> None:
    listen = {"listen": ["quic/192.168.7.1:7447", "tls/[fd00::1]:7448", "tls/0.0.0.0:7449"]}
    file = changed_configuration(desk, "lab.yaml", lambda tree: tree.update(bus=listen))
    said("keys", "init", "lab")
    said("keys", "add", "lab", "--from", file)
    assert names()["router"]["addresses"] == ["192.168.7.1", "fd00::1"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["keys", "init", "Lab"], "'Lab' is no name"),
        (["keys", "init", "lab"], "the arena lab has an authority"),
        (["keys", "add", "hall", "r1"], "the arena hall has no authority here: `robofleet keys init hall`"),
        (["keys", "add", "lab"], "name one, or a configuration with --from"),
        (["keys", "add", "lab", "r2", "--from", "x.yaml"], "name one, or a configuration with --from"),
        (["keys", "add", "lab", "r1"], "`robofleet keys renew lab r1`"),
        (["keys", "add", "lab", "R2"], "'R2' is no name"),
        (["keys", "add", "lab", "../r2"], "is no name"),
        (["keys", "add", "lab", "r2\n"], "is no name"),
        (["keys", "add", "lab", "r2", "--kind", "robot"], "--kind robot: one of unit, router"),
        (["keys", "add", "lab", "supervisor", "--kind", "unit"], "is what a process is called"),
        (["keys", "add", "lab", "web"], "add `--address"),
        (["keys", "add", "lab", "web", "--address", "quic/10.0.0.1:7447"], "write a host's IP address or name alone"),
        (["keys", "add", "lab", "--from", CONFIGS / "platoon.yaml"], "its arena is platoon, not lab"),
        (["keys", "add", "lab", "--from", CONFIGS / "lab.yaml", "--kind", "unit"], "--kind: it belongs to a name"),
        (["keys", "add", "lab", "--from", "no.yaml"], "no.yaml"),
        (["keys", "renew", "lab"], "name one, or say --all"),
        (["keys", "renew", "lab", "r1", "--all"], "name one, or say --all"),
        (["keys", "renew", "lab", "r9"], "r9 has no certificate for the arena lab (known: alice, r1, router)"),
        (["keys", "revoke", "lab", "r9"], "r9 has no certificate"),
        (["keys", "bundle", "lab", "r9", "--router", ROUTER], "r9 has no certificate: `robofleet keys add lab r9`"),
        (["keys", "bundle", "lab", "r1", "--router", "10.0.0.1:7447"], "write quic/HOST:PORT or tls/HOST:PORT"),
        (["keys", "bundle", "lab", "r1", "--router", "tcp/10.0.0.1:7447"], "write quic/HOST:PORT or tls/HOST:PORT"),
        (["keys", "bundle", "lab", "r1", "--router", "quic/10.0.0.1"], "write quic/HOST:PORT or tls/HOST:PORT"),
        (["keys", "bundle", "lab", "r1", "--router", "quic/10.0.0.1:0"], "write quic/HOST:PORT or tls/HOST:PORT"),
        (["keys", "bundle", "lab", "r1", "--router", "quic/10.0.0.1:65536"], "write quic/HOST:PORT or tls/HOST:PORT"),
        (["keys", "bundle", "lab", "r1", "--router", f"{ROUTER}\n"], "write quic/HOST:PORT or tls/HOST:PORT"),
        (["keys", "bundle", "lab", "r1", "--router", ROUTER, "--out", "no/r1"], "no/r1: No such file"),
    ],
)
def test_a_mistake_is_one_line_and_changes_nothing(lab: Path, desk: Path, words: list[object], says: str) -> None:
    before = tree(desk)
    assert says in refused(*words)
    assert tree(desk) == before


def test_a_router_without_an_address_adds_nobody_of_a_roster(desk: Path) -> None:
    said("keys", "init", "lab")
    assert "add `--address 192.168.1.10`" in refused("keys", "add", "lab", "--from", CONFIGS / "lab.yaml")
    assert names() == {}


def test_who_is_revoked_is_cut_off_but_not_a_router_that_is_on(lab: Path) -> None:
    assert said("keys", "revoke", "lab", "r1")[0].startswith("r1 is revoked, and cut off")
    assert said("keys", "revoke", "lab", "router")[0].startswith("router is revoked; a router that is on keeps it")


def test_all_are_renewed_but_who_is_revoked(lab: Path) -> None:
    said("keys", "revoke", "lab", "alice")
    before = names()
    said("keys", "renew", "lab", "--all")
    after = names()
    assert {name for name in after if after[name]["serial"] != before[name]["serial"]} == {"r1", "router"}


def test_a_revoked_or_expired_name_gets_no_bundle(lab: Path, desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said("keys", "revoke", "lab", "r1")
    assert "r1 is revoked already" in refused("keys", "revoke", "lab", "r1")
    for words in (["renew", "lab", "r1"], ["bundle", "lab", "r1", "--router", ROUTER]):
        assert "`robofleet keys add lab r1`" in refused("keys", *words)
    said("keys", "add", "lab", "r1")
    assert names()["r1"]["common_name"] == "r1#2"
    later(monkeypatch, 200)
    assert "`robofleet keys renew lab r1`" in refused("keys", "bundle", "lab", "r1", "--router", ROUTER)
    assert not (desk / "r1.bundle").exists()


def changed(file: Path, fields: dict[str, Any], **passport: Any) -> Path:
    """Return another bundle: what somebody, or a bad copy, made of its fields and of those of its passport."""
    content = json.loads(file.read_text()) | fields
    content["passport"] |= passport
    other = file.with_name("changed.bundle")
    other.write_text(json.dumps(content))
    return other


def test_a_bundle_that_is_damaged_is_refused_wherever_it_is(bundle: Path, desk: Path) -> None:
    text = bundle.read_text()
    for part in ("certificate", "key", "authority"):
        pem = json.loads(text)[part]
        half = len(pem) // 2
        other = "A" if pem[half] != "A" else "B"
        for wrong in (pem[:half] + other + pem[half + 1 :], pem[:half], BEGIN + END, ""):
            file = changed(bundle, {part: wrong})
            assert "copy again what `robofleet keys bundle` made" in refused("join", file, "--into", desk / "robot")
    for short in (text[: len(text) // 2], "", "\0" * 100, "x" * 70000, "[]", "{}"):
        (desk / "short.bundle").write_text(short)
        assert "short.bundle" in refused("join", "short.bundle", "--into", desk / "robot")
    assert not (desk / "robot").exists()


def test_a_bundle_whose_parts_are_not_each_others_is_refused(lab: Path, bundle: Path, desk: Path) -> None:
    said("keys", "add", "lab", "r2")
    said("keys", "init", "hall")
    for change in (
        {"key": (lab / "r2.key").read_text()},
        {"certificate": (lab / "r2.pem").read_text(), "key": (lab / "r2.key").read_text()},
        {"authority": (lab.parent / "hall" / "authority.pem").read_text()},
    ):
        assert "copy again" in refused("join", changed(bundle, change), "--into", desk / "robot")
    for key, value in (("serial", "5a"), ("common_name", "r1#2")):
        file = changed(bundle, {}, **{key: value})
        assert "its certificate is of r1" in refused("join", file, "--into", desk / "robot")
    assert not (desk / "robot").exists()


def test_a_bundle_of_a_newer_robofleet_names_both_versions(bundle: Path, desk: Path) -> None:
    file = changed(bundle, {"format": 2, "robofleet": "9.8.7", "more": 1})
    line = refused("join", file, "--into", desk / "robot")
    assert "robofleet 9.8.7 made it" in line
    assert f"{json.loads(bundle.read_text())['robofleet']} is installed here" in line


@pytest.mark.parametrize("days", [-3000, 3000])
def test_a_clock_that_is_years_off_is_told_as_such(
    bundle: Path, desk: Path, monkeypatch: pytest.MonkeyPatch, days: int
) -> None:
    later(monkeypatch, days)
    line = refused("join", bundle, "--into", desk / "robot")
    assert f"this computer's clock says {utc_now() + timedelta(days=days):%Y-%m}" in line
    assert "set the clock" in line
    assert not (desk / "robot").exists()


def test_a_robot_stays_who_it_is(lab: Path, bundle: Path, desk: Path) -> None:
    robot = desk / "robot"
    said("join", bundle, "--into", robot)
    before = tree(robot)
    said("keys", "add", "lab", "r2")
    said("keys", "bundle", "lab", "r2", "--router", ROUTER)
    assert "this computer is r1 of lab, and the bundle is for r2 of lab" in refused(
        "join", "r2.bundle", "--into", robot
    )
    said("keys", "init", "hall")
    said("keys", "add", "hall", "r1")
    said("keys", "bundle", "hall", "r1", "--router", ROUTER, "--out", "hall.bundle")
    assert "the bundle is for r1 of hall" in refused("join", "hall.bundle", "--into", robot)
    assert tree(robot) == before


def test_a_robot_file_that_cannot_be_read_is_left_alone(bundle: Path, desk: Path) -> None:
    robot = desk / "robot"
    robot.mkdir()
    (robot / "robot.yaml").write_text("arena: [\n")
    done = robofleet("join", bundle, "--into", robot)
    assert done.exit_code == 2
    assert "mend it or remove it" in done.stderr
    assert [*tree(robot)] == [robot / "robot.yaml"]


def test_joining_again_brings_new_keys_and_keeps_what_the_robot_allows(lab: Path, bundle: Path, desk: Path) -> None:
    robot = desk / "robot"
    said("join", bundle, "--into", robot, "--driver", "gternal", "--port", "/dev/ttyUSB0", "--max-wheel-speed", "12.5")
    said("keys", "renew", "lab", "r1")
    said("keys", "bundle", "lab", "r1", "--router", "tls/lab.example:7447")
    said("join", bundle, "--into", robot, "--max-wheel-speed", "9")
    assert (robot / "keys" / "lab" / "r1.key").read_bytes() == (lab / "r1.key").read_bytes()
    robot_file = load_robot_file(robot / "robot.yaml")
    assert robot_file.router == ("tls/lab.example:7447",)
    assert robot_file.refusal("gternal", "/dev/ttyUSB0", 9.0) is None
    assert robot_file.refusal("create2", "/dev/ttyUSB0", 9.0) == "the driver create2 (allowed: gternal)"
    assert robot_file.refusal("gternal", "/dev/ttyUSB1", 9.0) == "the port /dev/ttyUSB1 (allowed: /dev/ttyUSB0)"
    assert robot_file.refusal("gternal", "/dev/ttyUSB0", 9.1) == "wheels of 9.1 rad/s (allowed: 9)"


def test_a_users_own_robot_file_is_not_written_anew_for_nothing(bundle: Path, desk: Path) -> None:
    robot = desk / "robot"
    said("join", bundle, "--into", robot)
    file = robot / "robot.yaml"
    mine = file.read_text().replace("allows: {}", "# mine\nallows: {ports: [/dev/ttyUSB3]}")
    assert mine != file.read_text()
    file.write_text(mine)
    said("join", bundle, "--into", robot)
    assert file.read_text() == mine


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--driver", "gternl"], "--driver gternl: known: arduino_bridge, create2, gternal, rfp, simulated"),
        (["--port", " "], "--port: name a port"),
        (["--max-wheel-speed", "0"], "--max-wheel-speed 0: write a speed above 0"),
        (["--max-wheel-speed", "nan"], "--max-wheel-speed nan"),
        (["--max-wheel-speed", "inf"], "--max-wheel-speed inf"),
        (["--service"], "leave --service or --into out"),
    ],
)
def test_what_a_robot_cannot_be_told_is_refused(bundle: Path, desk: Path, words: list[str], says: str) -> None:
    assert says in refused("join", bundle, "--into", desk / "robot", *words)
    assert not (desk / "robot").exists()


def test_a_person_joins_without_a_robot_file(lab: Path, desk: Path) -> None:
    said("keys", "bundle", "lab", "alice", "--router", ROUTER)
    assert "alice is no unit" in refused("join", "alice.bundle", "--into", desk / "host", "--driver", "gternal")
    assert "robofleet stop lab" in said("join", "alice.bundle", "--into", desk / "host")[-1]
    assert not (desk / "host" / "robot.yaml").exists()
    assert (desk / "host" / "keys" / "lab" / "alice.key").exists()


def test_a_folder_that_cannot_be_made_is_named(bundle: Path, desk: Path) -> None:
    (desk / "robot").write_text("no folder")
    assert "keys are to be kept there" in refused("join", bundle, "--into", desk / "robot")


def test_another_authoritys_folder_is_not_overwritten(lab: Path, bundle: Path, desk: Path) -> None:
    lab.rename(desk / "away")
    said("keys", "init", "lab")
    before = tree(lab)
    assert "the folder of another authority of lab" in refused("join", bundle)
    assert tree(lab) == before


def test_root_joins_for_the_whole_computer_and_a_user_alone(
    lab: Path, bundle: Path, desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(desk / "home"))
    monkeypatch.delenv("XDG_CONFIG_HOME")
    said("join", bundle)
    assert (desk / "home" / ".config" / "robofleet" / "robot.yaml").exists()
    monkeypatch.setattr(join_command, "_is_root", lambda: True)
    said("join", bundle)
    assert (desk / "etc" / "robot.yaml").exists()
    assert credentials_of.keys_folder("lab") == desk / "etc" / "keys" / "lab"


def test_root_joins_in_a_folder_that_it_names(bundle: Path, desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(join_command, "_is_root", lambda: True)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(desk / "host"))
    said("join", bundle)
    assert (desk / "host" / "robofleet" / "robot.yaml").exists()
    assert not (desk / "etc").exists()


def test_keys_of_the_whole_computer_do_not_hide_an_authority(
    lab: Path, bundle: Path, desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(join_command, "_is_root", lambda: True)
    (desk / "home").mkdir()
    (desk / "config").rename(desk / "home" / ".config")
    monkeypatch.setenv("HOME", str(desk / "home"))
    monkeypatch.delenv("XDG_CONFIG_HOME")
    assert "would hide it" in refused("join", bundle)
    assert not (desk / "etc").exists()
    assert names()["r1"]["state"] == "valid"


def test_a_service_starts_the_units_driver(bundle: Path, desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(desk / "robot"))
    assert "as root" in refused("join", bundle, "--service")
    monkeypatch.setattr(join_command, "_is_root", lambda: True)
    assert "this computer has no systemd" in refused("join", bundle, "--service")
    assert not (desk / "etc").exists()
    (desk / "systemd").mkdir()
    lines = said("join", bundle, "--service")
    assert len(lines) <= 5
    assert "Next: systemctl enable --now robofleet-unit" in lines
    service = (desk / "systemd" / "robofleet-unit.service").read_text()
    assert re.search(r"^ExecStart=/\S.* node driver --unit r1$", service, re.MULTILINE)
    assert load_robot_file(desk / "etc" / "robot.yaml").unit == "r1"


@pytest.fixture
def service(bundle: Path, desk: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the service of r1's driver, installed under a umask that lets nobody read anything."""
    monkeypatch.delenv("XDG_CONFIG_HOME")
    monkeypatch.setenv("HOME", str(desk / "home"))
    monkeypatch.setattr(join_command, "_is_root", lambda: True)
    (desk / "systemd").mkdir()
    umask = os.umask(0o077)
    try:
        said("join", bundle, "--service")
        assert os.umask(0o077) == 0o077
    finally:
        os.umask(umask)
    return desk / "systemd" / "robofleet-unit.service"


def test_a_service_is_nobody_but_its_robots_driver(service: Path) -> None:
    text = service.read_text()
    for line in ("DynamicUser=yes", "CapabilityBoundingSet=", "NoNewPrivileges=yes", "DevicePolicy=closed",
                 "SupplementaryGroups=dialout"):  # fmt: skip
        assert f"\n{line}\n" in text
    assert not re.search(r"^User=", text, re.MULTILINE)
    assert int(re.findall(r"^LimitRTPRIO=(\d+)$", text, re.MULTILINE)[0]) >= daemon._DRIVER_PRIORITY
    assert int(re.findall(r"^LimitNICE=(-\d+)$", text, re.MULTILINE)[0]) <= node.NICE
    driver = (DEPLOY / "robofleet-driver@.service").read_text()
    allowed = re.findall(r"^DeviceAllow=.*$", driver, re.MULTILINE)
    assert {*allowed} <= {*re.findall(r"^DeviceAllow=.*$", text, re.MULTILINE)}


@pytest.mark.skipif(os.geteuid() != 0, reason="ROOT ALONE becomes another user")
def test_a_service_reads_what_systemd_hands_it_though_the_keys_are_roots_alone(
    service: Path, desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    handed = desk / "handed"
    handed.mkdir()
    for name, file in re.findall(r"^LoadCredential=(.+?):(.+)$", service.read_text(), re.MULTILINE):
        shutil.copy(file, handed / name)
        (handed / name).chmod(0o440)  # as it looks where the file system has access control lists
    keys = desk / "etc" / "keys" / "lab"
    assert stat.S_IMODE(keys.stat().st_mode) == 0o700
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(handed))
    monkeypatch.setenv("HOME", "/nonexistent")
    for path in (handed, *handed.iterdir()):
        os.chown(path, NOBODY, NOBODY)
    for folder in (desk, *list(desk.parents)[:-2]):  # pytest's own, which are this user's alone, below /tmp
        folder.chmod(folder.stat().st_mode | 0o011)

    def read() -> str:
        robot = load_robot_file(robot_file())
        found = credentials_of.credentials(robot.arena, robot.unit)
        sizes = [len(file.read_bytes()) > 100 for file in found[1:]]
        return f"{os.geteuid()} {robot.unit} {found.name} {sizes} {os.access(keys, os.R_OK)}"

    assert as_nobody(read) == f"{NOBODY} r1 r1 {[True] * 3} False"


def as_nobody(act: Callable[[], str]) -> str:
    """Return what a function says as another user: in a fork, since that user may not reach this Python."""
    ours, theirs = os.pipe()
    if (child := os.fork()) == 0:
        try:
            os.setgroups([])
            os.setgid(NOBODY)
            os.setuid(NOBODY)
            os.write(theirs, act().encode())
        except BaseException as error:  # noqa: BLE001 - the other process tells of it
            os.write(theirs, repr(error).encode())
        os._exit(0)
    os.close(theirs)
    with os.fdopen(ours) as pipe:
        text = pipe.read()
    os.waitpid(child, 0)
    return text


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd here")
def test_systemd_has_nothing_to_complain_of_in_it(service: Path) -> None:
    for words in (["verify"], ["security", "--offline=true", "--threshold=20", "--no-pager"]):
        found = subprocess.run(
            ["systemd-analyze", *words, str(service)], capture_output=True, text=True, timeout=30, check=False
        )
        assert (found.returncode, found.stderr) == (0, ""), found.stdout
