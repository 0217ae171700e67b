"""No page beyond this computer without keys: what is missing is said in a line, with the commands that bring it."""

import asyncio
import hashlib
import re
import shutil
import socket
import ssl
import subprocess
import sys
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path

import httpx
import pytest

from robofleet.bus import credentials
from robofleet.bus.arena_file import claimed
from robofleet.bus.bus import MemoryBus
from robofleet.bus.credentials import keys_folder
from robofleet.bus.endpoint import settled
from robofleet.bus.permissions import PAGE
from robofleet.bus.zenoh_bus import open_router
from robofleet.config.load import resolved_yaml
from robofleet.config.tree import Config
from robofleet.core.clock import WallClock
from robofleet.core.refusal import RefusedError
from robofleet.hosts.authority import Authority
from robofleet.operator.page.certificate import page_keys
from robofleet.operator.page.server import Served, serve
from tests.command import robofleet
from tests.endpoints import short_folder
from tests.operator.page.secureweb import HOST, trusting
from tests.runs.realrun import ALONE, PLATOON, RealRun, own_folders, wait

ARENA = "hall"
INIT = f"`robofleet keys init {ARENA} --address {HOST}`"
ADD = f"`robofleet keys add {ARENA} web --address {HOST}`"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return where this user's keys of the arena are."""
    for name, folder in own_folders(tmp_path).items():
        monkeypatch.setenv(name, folder)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    return keys_folder(ARENA)


def refused(host: str = HOST) -> str:
    """Return why there is no page."""
    with pytest.raises(RefusedError) as error:
        page_keys(ARENA, host, "--host")
    message = str(error.value)
    assert message.startswith(f"--host {host}: ")
    assert "\n" not in message
    return message


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost"])
def test_on_this_computer_no_keys_are_asked_for(host: str) -> None:
    assert page_keys(ARENA, host, "--host") is None


def test_without_keys_two_commands_are_named() -> None:
    assert refused().endswith(f"needs a certificate of the arena {ARENA}: {INIT}, then {ADD}")


def test_where_the_arena_has_an_authority_one_command_is_enough(folder: Path) -> None:
    Authority.create(ARENA, folder)
    assert refused().endswith(f"needs a certificate of the arena {ARENA}: {ADD}")


def test_the_commands_that_are_named_bring_the_page(folder: Path) -> None:
    for command in refused().split("`")[1::2]:
        result = robofleet(*command.split()[1:])
        assert result.exit_code == 0, result.stderr
    assert page_keys(ARENA, HOST, "--host") is not None
    other = refused("192.168.7.7")
    assert f"web.pem is for 127.0.0.1, ::1, {HOST}, localhost only: `robofleet keys revoke {ARENA} web`, then" in other
    for command in other.split("`")[1::2]:
        result = robofleet(*command.split()[1:])
        assert result.exit_code == 0, result.stderr
    for host in (HOST, "192.168.7.7"):
        assert page_keys(ARENA, host, "--host") is not None


@pytest.mark.parametrize("host", ["lab.example", "LAB.example", "2001:db8::5", "2001:DB8:0::5"])
def test_a_name_and_an_address_of_ipv6_are_found_however_they_are_written(folder: Path, host: str) -> None:
    hosts = ["lab.example", "2001:db8::5"]
    Authority.create(ARENA, folder, hosts=hosts).issue(PAGE, PAGE, addresses=hosts)
    assert page_keys(ARENA, host, "--host") is not None


def damaged(folder: Path, how: str) -> str:
    """Damage the keys of a page; return a part of what is said then."""
    other = Authority.create(ARENA, folder.parent / "other")
    other.issue(PAGE, PAGE, addresses=[HOST])
    if how == "another authority":
        shutil.copy(other.folder / "authority.pem", folder)
        return "is not of the authority"
    if how == "another key":
        shutil.copy(other.folder / "web.key", folder)
        return "web.key are damaged, or not of one pair"
    if how == "no certificate":
        (folder / "web.pem").write_text("nothing")
        return "web.key are damaged, or not of one pair"
    if how == "no key":
        (folder / "web.key").unlink()
        return "web.key: No such file or directory: join again"
    (folder / "web.key").chmod(0o644)
    return "others can read this private key: `chmod 600"


@pytest.mark.parametrize("how", ["another authority", "another key", "no certificate", "no key", "a key for all"])
def test_keys_that_prove_nothing_are_refused(folder: Path, how: str) -> None:
    Authority.create(ARENA, folder).issue(PAGE, PAGE, addresses=[HOST])
    assert page_keys(ARENA, HOST, "--host") is not None
    assert damaged(folder, how) in refused()


def test_a_certificate_that_has_ended_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = Authority.create(ARENA, folder)
    made.issue(PAGE, PAGE, addresses=[HOST])
    ends = made.entries()[PAGE].newest.not_after
    monkeypatch.setattr(credentials, "utc_now", lambda: ends + timedelta(days=1))
    assert f"`robofleet keys renew {ARENA} web`" in refused()


@pytest.mark.parametrize(
    "command", [["run", "--web-host", HOST, "--set", f"arena.name={ARENA}"], ["web", "--host", HOST]], ids=str
)
def test_both_commands_refuse_a_page_without_keys_and_leave_nothing(
    command: list[str], tmp_path: Path, platoon_of: Callable[..., Config]
) -> None:
    name, option, *more = command
    file = PLATOON
    if name == "web":
        file = tmp_path / "config.yaml"
        file.write_text(resolved_yaml(platoon_of(f"arena.name={ARENA}")))
    else:
        more += ["--out", str(tmp_path / "run")]
    result = robofleet(name, file, option, *more)
    line = f"{option} {HOST}: beyond this computer the page needs a certificate of the arena {ARENA}: "
    assert (result.exit_code, result.stderr) == (2, f"{line}{INIT}, then {ADD}\n")
    assert not (tmp_path / "run").exists()


class Elsewhere(socket.socket):
    """A socket that others reach."""

    def getsockname(self) -> tuple[str, int]:
        return "192.168.7.7", 8080


def test_a_name_of_this_computer_that_others_reach_is_not_served_without_keys(
    tmp_path: Path, platoon_of: Callable[..., Config]
) -> None:
    clock = WallClock()
    bus = MemoryBus("platoon", clock, 0)
    served = Served(config=platoon_of(), folder=tmp_path, bus=bus, clock=clock, name="localhost", over=lambda: False)
    with (
        Elsewhere() as listening,
        pytest.raises(RefusedError, match=r"localhost is 192\.168\.7\.7, which others reach"),
    ):
        asyncio.run(serve(served, listening, lambda _: None, lambda: True))


@pytest.mark.slow
def test_the_command_prints_an_address_for_each_role(
    folder: Path, tmp_path: Path, platoon_of: Callable[..., Config], monkeypatch: pytest.MonkeyPatch
) -> None:
    Authority.create(ARENA, folder).issue(PAGE, PAGE, addresses=[HOST])
    for name, user_folder in own_folders(short_folder()).items():
        monkeypatch.setenv(name, user_folder)
    config = settled(platoon_of(f"arena.name={ARENA}"), listen=True)
    (tmp_path / "config.yaml").write_text(resolved_yaml(config))
    words = tmp_path / "said"
    with claimed(config, tmp_path), words.open("wb") as output:
        router = open_router(config.bus.endpoint)
        command = [sys.executable, "-W", "error", "-m", "robofleet", "web", ARENA, "--host", HOST]
        page = subprocess.Popen(command, stderr=output, stdout=output)
        try:
            assert wait(lambda: words.read_text().count("\n") >= 3, 60), words.read_text()
            operator, viewer, certificate = words.read_text().splitlines()
            for line, role in (operator, "operator"), (viewer, "viewer"):
                with httpx.Client(verify=trusting(folder)) as browser:
                    address = line.rpartition(" ")[2]
                    assert browser.get(address).status_code == 200
                    root = address.partition("open?")[0]
                    assert f'<body data-role="{role}">' in browser.get(root).text
            pem = ssl.PEM_cert_to_DER_cert((folder / "web.pem").read_text())
            assert certificate.rpartition(" ")[2] == hashlib.sha256(pem).digest().hex(":").upper()
        finally:
            page.kill()
            page.wait()
            router.close()  # type: ignore[no-untyped-call]


@pytest.mark.long
def test_a_run_brings_its_page_to_the_network(real_run: Callable[..., RealRun]) -> None:
    own = Authority.create("platoon", keys_folder("platoon")).issue(PAGE, PAGE, addresses=[HOST])
    run = real_run(*ALONE, "--web-host", HOST, "--duration", "1")
    run.wait_for(lambda: "SHA-256" in run.said)
    operator, viewer = re.findall(rf"https://{re.escape(HOST)}:\S+", run.said)
    with httpx.Client(verify=trusting(own.authority.parent)) as browser:
        for address in (operator, viewer):
            assert browser.get(address).status_code == 200
        assert browser.get(operator).status_code == 200, "it is in"
    assert httpx.get(viewer, verify=trusting(own.authority.parent)).status_code == 403
    assert run.ended() == 0
    assert run.summary["outcome"] == "completed"
    assert run.nothing_is_left()
