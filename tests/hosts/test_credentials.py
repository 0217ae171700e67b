"""The keys of a computer: which folder, what cannot be used and why, and when they are to be renewed."""

import re
import string
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from robofleet.bus import credentials as credentials_of
from robofleet.bus.credentials import KeysError, Passport, credentials, keys_folder, passport, session_id
from robofleet.core import folders
from robofleet.core.clock import utc_now
from robofleet.hosts.authority import Authority

START = datetime(2026, 1, 1, tzinfo=UTC)


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Authority:
    """Return the authority of this user's arena, with a robot."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setattr(folders, "SYSTEM", tmp_path / "etc")
    made = Authority.create("lab", keys_folder("lab"))
    made.issue("r1", "unit", days=90)
    return made


def told(arena: str = "lab", name: str = "r1", serial: str = "5a", days: float = 90) -> Passport:
    return Passport(
        arena=arena, name=name, kind="unit", common_name=name, serial=serial,
        not_before=START, not_after=START + timedelta(days=days),
    )  # fmt: skip


def test_the_keys_of_a_name_are_found(lab: Authority) -> None:
    found = credentials("lab", "r1")
    assert found.name == "r1"
    for file in found[1:]:
        assert file.parent == lab.folder
        assert file.read_text().startswith("-----BEGIN ")
    assert passport("lab", "r1") == lab.entries()["r1"].newest


def test_the_systems_folder_goes_first_where_it_is_there(lab: Authority, tmp_path: Path) -> None:
    assert keys_folder("lab") == tmp_path / "config" / "robofleet" / "keys" / "lab"
    system = tmp_path / "etc" / "keys" / "lab"
    system.mkdir(parents=True)
    assert keys_folder("lab") == system
    assert keys_folder("hall").parent == lab.folder.parent


@pytest.mark.parametrize("name", ["r1.pem", "r1.key", "r1.json", "authority.pem"])
def test_a_file_that_is_missing_is_named(lab: Authority, name: str) -> None:
    (lab.folder / name).unlink()
    with pytest.raises(KeysError, match=re.escape(str(lab.folder / name))) as error:
        credentials("lab", "r1")
    assert "join" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("content", ["", "{", "[]", "null", '{"arena": "lab"}', "\xff"])
def test_a_damaged_file_is_named(lab: Authority, content: str) -> None:
    (lab.folder / "r1.json").write_bytes(content.encode("latin-1"))
    with pytest.raises(KeysError, match=r"r1\.json: it is damaged: join again"):
        credentials("lab", "r1")


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o777])
def test_a_private_key_that_others_reach_is_refused(lab: Authority, mode: int) -> None:
    (lab.folder / "r1.key").chmod(mode)
    with pytest.raises(KeysError, match=r"r1\.key: others can read this private key: `chmod 600 "):
        credentials("lab", "r1")


@pytest.mark.parametrize("days", [-3650, -1, 91, 3650])
def test_a_clock_that_is_off_is_told_as_such(lab: Authority, monkeypatch: pytest.MonkeyPatch, days: int) -> None:
    now = utc_now() + timedelta(days=days)
    monkeypatch.setattr(credentials_of, "utc_now", lambda: now)
    with pytest.raises(KeysError) as error:
        credentials("lab", "r1")
    dates = lab.entries()["r1"].newest
    assert f"valid from {dates.not_before:%Y-%m-%d} to {dates.not_after:%Y-%m-%d}" in str(error.value)
    assert f"this computer's clock says {now:%Y-%m-%d}: set the clock" in str(error.value)
    assert ("keys renew lab r1" in str(error.value)) == (days > 0)


def test_a_fifth_of_a_life_before_its_end_a_certificate_is_to_be_renewed() -> None:
    certificate = told(days=100)
    assert [certificate.ends_soon(START + timedelta(days=day)) for day in (0, 79.9, 80.1, 101)] == [
        False,
        False,
        True,
        True,
    ]


def test_a_session_belongs_to_one_certificate_of_one_name_in_one_arena() -> None:
    each = [told(), told(arena="hall"), told(name="r2"), told(serial="5b")]
    drawn = [session_id(session) for session in each]
    assert len({*drawn}) == len(each)
    assert session_id(told()) == session_id(told())
    for session in drawn:
        assert len(session) == 32
        assert {*session} <= {*string.hexdigits.lower()}
        assert session[0] != "0"


def test_a_robot_reads_its_keys_without_the_library_that_makes_them(lab: Authority) -> None:
    script = """
import sys
sys.modules["cryptography"] = sys.modules["pydantic"] = None
from pathlib import Path
from robofleet.core import folders
from robofleet.bus import credentials
folders.SYSTEM = Path("nowhere")
print(credentials.credentials("lab", "r1").name)
"""
    assert lab.folder.is_dir()
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout == "r1\n"
