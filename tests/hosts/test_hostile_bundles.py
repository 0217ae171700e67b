"""A bundle that somebody else made: whatever it calls itself, ``join`` writes where it was told, or nothing at all."""

import json
import os
import re
from datetime import timedelta
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from robofleet.bus.credentials import KINDS, KeysError, Passport, joined, passport
from robofleet.core import folders
from robofleet.core.clock import utc_now
from robofleet.core.patterns import NAME_PATTERN
from robofleet.hosts import join_command
from robofleet.hosts.authority import Authority, _private
from tests.command import robofleet

HOSTILE = (
    "..", ".", "", "../..", "../../victim", "../victim/authority", "/etc", "/", "lab/../../victim", "lab\0", "\0",
    "lab ", "lab\n",
    "-lab", "Lab", "l" * 33, "läb", "l\u200bab", "\u202eab", "authority", "joined", "register", "\ud83e\udd16",
    "~", "$HOME", "lab/r1", "r1.pem",
)  # fmt: skip
RESERVED = "authority", "joined", "register"


class Stranger(NamedTuple):
    """Who makes bundles with an authority of his own, and what of this computer must stay as it is."""

    desk: Path
    key: ec.EllipticCurvePrivateKey
    authority: str


@pytest.fixture(scope="module")
def stranger(tmp_path_factory: pytest.TempPathFactory) -> Stranger:
    desk = tmp_path_factory.mktemp("desk")
    made = Authority.create("lab", desk / "stranger")
    victim = desk / "victim"
    victim.mkdir(mode=0o755)
    for name in (*RESERVED, "r1"):
        for end in ("pem", "key", "json"):
            (victim / f"{name}.{end}").write_text("mine")
    (desk / "robot").mkdir(mode=0o755)
    (desk / "robot" / "keys").mkdir(mode=0o755)
    return Stranger(desk, made._key, (made.folder / "authority.pem").read_text())


@pytest.fixture(autouse=True)
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.setattr(folders, "SYSTEM", tmp_path / "etc")
    monkeypatch.setattr(join_command, "_SERVICE", tmp_path / "systemd" / "robofleet-unit.service")


def bundle(by: Stranger, passport: dict[str, str]) -> Path:
    """Write a bundle that is whole and signed, whatever it says."""
    key, now, serial = ec.generate_private_key(ec.SECP256R1()), utc_now().replace(microsecond=0), 0x5A
    starts, ends = now - timedelta(days=1), now + timedelta(days=1)
    issuer = x509.load_pem_x509_certificate(by.authority.encode()).subject
    called = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, passport["common_name"][:64] or "r1")])
    signed = x509.CertificateBuilder(issuer, called, key.public_key(), serial, starts, ends).sign(
        by.key, hashes.SHA256()
    )
    dates = {"not_before": starts.isoformat(), "not_after": ends.isoformat()}
    file = by.desk / "r1.bundle"
    file.write_text(json.dumps({
        "format": 1, "robofleet": version("robofleet"),
        "passport": {**passport, "serial": "5a", **dates, "addresses": []},
        "certificate": signed.public_bytes(Encoding.PEM).decode(), "key": _private(key).decode(),
        "authority": by.authority, "router": ["quic/10.0.0.1:7447"],
    }))  # fmt: skip
    return file


def tree(folder: Path) -> dict[Path, tuple[int, bytes]]:
    """Return every file and folder, with its mode and what is in it."""
    return {
        path: (path.lstat().st_mode, path.read_bytes() if path.is_file() else b"")
        for path in (folder, *sorted(folder.rglob("*")))
    }


def sound(passport: dict[str, str]) -> bool:
    """Return whether a laboratory may have made this."""
    names = re.fullmatch(NAME_PATTERN, passport["arena"]) and re.fullmatch(NAME_PATTERN, passport["name"])
    common = passport["common_name"] == passport["name"] or re.fullmatch(
        r"#[1-9]\d*", passport["common_name"].removeprefix(passport["name"])
    )
    return bool(names and common) and passport["name"] not in RESERVED and passport["kind"] in KINDS


hostile = st.sampled_from(HOSTILE) | st.text(max_size=8)


@given(
    arena=st.just("lab") | hostile, name=st.just("r1") | hostile,
    kind=st.sampled_from(("unit", "viewer")) | hostile, common_name=st.none() | hostile,
)  # fmt: skip
@example(arena="../../victim", name="r1", kind="unit", common_name=None)
@example(arena="../../victim", name="r1", kind="viewer", common_name=None)
@example(arena="lab", name="../../../victim/r1", kind="viewer", common_name=None)
@example(arena="lab", name="authority", kind="viewer", common_name=None)
@example(arena="..", name="r1", kind="viewer", common_name=None)
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_bundle_that_names_a_path_changes_nothing(
    stranger: Stranger, arena: str, name: str, kind: str, common_name: str | None
) -> None:
    passport = {"arena": arena, "name": name, "kind": kind, "common_name": name if common_name is None else common_name}
    if sound(passport):
        return
    try:
        file = bundle(stranger, passport)
    except ValueError:  # no certificate can say that
        return
    before = tree(stranger.desk)
    done = robofleet("join", file, "--into", stranger.desk / "robot")
    assert (done.exit_code, done.stdout) == (2, ""), done.output
    assert len(done.stderr.splitlines()) == 1
    assert tree(stranger.desk) == before


def test_such_a_bundle_is_joined_where_it_names_no_path(stranger: Stranger, tmp_path: Path) -> None:
    """What is refused above is refused for its names."""
    passport = {"arena": "lab", "name": "r1", "kind": "viewer", "common_name": "r1#2"}
    done = robofleet("join", bundle(stranger, passport), "--into", tmp_path / "robot")
    assert done.exit_code == 0, done.output


@pytest.mark.parametrize("what", ["open", "link", "foreign"])
def test_a_folder_that_is_not_the_keys_alone_is_left_as_it_is(stranger: Stranger, tmp_path: Path, what: str) -> None:
    passport = {"arena": "lab", "name": "r1", "kind": "viewer", "common_name": "r1"}
    keys = tmp_path / "robot" / "keys"
    other = tmp_path / "other"
    for folder in (keys, other):
        folder.mkdir(parents=True)
    (other / "mine").write_text("mine")
    other.chmod(0o755)
    if what == "foreign" and os.geteuid() != 0:
        pytest.skip("ROOT ALONE gives files away")
    if what == "link":
        (keys / "lab").symlink_to(other)
    else:
        other.rename(keys / "lab")
    if what == "foreign":
        os.chown(keys / "lab", 65534, 65534)
    before = tree(tmp_path)
    done = robofleet("join", bundle(stranger, passport), "--into", tmp_path / "robot")
    assert (done.exit_code, done.stdout) == (2, "")
    assert {"open": "chmod 700", "link": "is not a folder but a link", "foreign": "belongs to somebody else"}[
        what
    ] in done.stderr
    assert tree(tmp_path) == before


@given(name=hostile, arena=hostile)
@settings(max_examples=60, deadline=None)
def test_no_passport_says_such_names_wherever_it_is_read(name: str, arena: str) -> None:
    now = utc_now()
    passport: dict[str, Any] = {
        "arena": arena, "name": name, "kind": "unit", "common_name": name, "serial": "5a",
        "not_before": now.isoformat(), "not_after": now.isoformat(), "addresses": [],
    }  # fmt: skip
    for changed in ({"arena": "lab"}, {"name": "r1", "common_name": "r1"}, {}):
        changed_passport = passport | changed
        if sound(changed_passport):
            continue
        with pytest.raises(KeysError):
            Passport.of(changed_passport)


def test_what_lies_among_the_keys_is_not_believed_either(tmp_path: Path) -> None:
    made = Authority.create("lab", tmp_path / "config" / "robofleet" / "keys" / "lab")
    made.issue("alice", "operator")
    file = made.folder / "alice.json"
    for change in ({"name": "../x"}, {"arena": "hall"}, {"name": "bob", "common_name": "bob"}, {"kind": "king"}):
        file.write_text(json.dumps(made.entries()["alice"].newest.plain() | change))
        with pytest.raises(KeysError, match=r"alice\.json: it is damaged"):
            passport("lab", "alice")
    bundle_passport = {"arena": "lab", "name": "../alice", "kind": "operator", "router": ["quic/10.0.0.1:7447"]}
    (made.folder / "joined.json").write_text(json.dumps(bundle_passport))
    assert joined() == {}


@pytest.mark.parametrize("name", RESERVED)
def test_no_name_of_a_file_among_the_keys_is_given_to_anybody(tmp_path: Path, name: str) -> None:
    made = Authority.create("lab", tmp_path / "lab")
    before = tree(tmp_path)
    with pytest.raises(KeysError, match=f"{name} is what a file beside the keys is called"):
        made.issue(name, "unit")
    assert tree(tmp_path) == before
