"""The keys of this computer: certificates by which other hosts know it. A robot needs nothing else to read them.

``NAME.pem`` and ``NAME.key`` are a certificate and its private key, ``NAME.json`` says what is in the certificate, and
``authority.pem`` is the certificate of the arena's authority. Only their owner may read the folder.
"""

import hashlib
import json
import os
import re
import stat
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple, Self

from robofleet.core import folders
from robofleet.core.clock import utc_now
from robofleet.core.errors import RobofleetError
from robofleet.core.patterns import NAME_PATTERN

AUTHORITY, JOINED, REGISTER = "authority.pem", "joined.json", "register.json"
ROUTER = "router"
# Of certificates: ``permissions.py`` says what each may do, and reads more than a robot needs.
KINDS = (
    "unit", ROUTER, "controller", "supervisor", "tracker", "recorder", "web", "operator", "viewer", "script",
)  # fmt: skip
_RESERVED = tuple(Path(file).stem for file in (AUTHORITY, JOINED, REGISTER))
_SERIAL, _ADDRESS = r"[1-9a-f][0-9a-f]{0,39}", r"[0-9A-Za-z.:%_-]{1,253}"
_RENEWAL_SHARE = 0.2  # of a certificate's life is left: it is to be renewed
_ZID = 16  # [bytes]


class KeysError(RobofleetError, ValueError):
    """Raised where a key is missing or cannot be used. The message says how to mend it."""


def check_name(name: str) -> None:
    """Raise KeysError where this cannot be the name of a certificate: files are called so."""
    if not re.fullmatch(NAME_PATTERN, name):
        raise KeysError(f"{name!r} is no name: small letters, digits, - and _, at most 32, a letter first")
    if name in _RESERVED:
        raise KeysError(f"{name} is what a file beside the keys is called: take another name")


@dataclass(frozen=True)
class Passport:
    """What a certificate says; KeysError where it says what none can. Instants are aware."""

    arena: str
    name: str
    kind: str  # one of KINDS
    common_name: str  # its name, or NAME#2 and so on after a revocation
    serial: str  # hexadecimal
    not_before: datetime
    not_after: datetime
    addresses: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Refuse what is no name: whoever made the file may be anybody, and paths are made of names."""
        check_name(self.name)
        if not re.fullmatch(NAME_PATTERN, self.arena):
            raise KeysError(f"{self.arena!r} is no name of an arena")
        if self.kind not in KINDS:
            raise KeysError(f"{self.kind!r} is no kind of certificate: one of {', '.join(KINDS)}")
        if not re.fullmatch(rf"{re.escape(self.name)}(#[1-9]\d{{0,8}})?", self.common_name):
            raise KeysError(f"{self.common_name!r} is not the common name of {self.name}")
        if not re.fullmatch(_SERIAL, self.serial):
            raise KeysError(f"{self.serial!r} is no serial number")
        if not all(re.fullmatch(_ADDRESS, address) for address in self.addresses):
            raise KeysError(f"{self.addresses!r}: these are no addresses")

    @classmethod
    def of(cls, source: Any) -> Self:
        """Return what JSON tells; ValueError where that is no passport."""
        if isinstance(source, cls):
            return source
        names = [field.name for field in fields(cls)]
        if not isinstance(source, dict) or source.keys() != {*names}:
            raise ValueError("no passport")
        texts = [source[name] for name in names[:-1]]
        addresses = source["addresses"]
        if not isinstance(addresses, list) or not all(isinstance(text, str) for text in (*texts, *addresses)):
            raise ValueError("no passport")
        starts, ends = map(datetime.fromisoformat, texts[-2:])
        if starts.tzinfo is None or ends.tzinfo is None:
            raise ValueError("no passport: a date without its zone")
        arena, name, kind, common_name, serial = texts[:5]
        return cls(arena, name, kind, common_name, serial, starts, ends, tuple(addresses))

    def plain(self) -> dict[str, Any]:
        """Return it as JSON tells it."""
        dates = {name: getattr(self, name).isoformat() for name in ("not_before", "not_after")}
        return asdict(self) | dates | {"addresses": list(self.addresses)}

    def check(self, now: datetime) -> None:
        """Raise KeysError where it is not valid now."""
        lasts = f"is valid from {self.not_before:%Y-%m-%d} to {self.not_after:%Y-%m-%d}"
        if now < self.not_before:
            raise KeysError(
                f"the certificate of {self.name} {lasts}, and this computer's clock says {now:%Y-%m-%d}: set the clock"
            )
        if now > self.not_after:
            raise KeysError(
                f"the certificate of {self.name} {lasts}, and this computer's clock says {now:%Y-%m-%d}: "
                f"set the clock, or run `robofleet keys renew {self.arena} {self.name}` at the laboratory"
            )

    def ends_soon(self, now: datetime) -> bool:
        """Return whether it is to be renewed."""
        return self.not_after - now < _RENEWAL_SHARE * (self.not_after - self.not_before)


class Joined(NamedTuple):
    """As whom this computer has joined an arena, and where its router is."""

    arena: str
    name: str
    kind: str
    router: tuple[str, ...]


class Credentials(NamedTuple):
    """Files that Zenoh reads."""

    name: str
    certificate: Path
    key: Path
    authority: Path

    @classmethod
    def at(cls, folder: Path, name: str) -> Self:
        """Return the files of a name in a folder, whether they are there or not."""
        return cls(name, folder / f"{name}.pem", folder / f"{name}.key", folder / AUTHORITY)


def keys_folder(arena: str) -> Path:
    """Return the folder of an arena's keys.

    That of the copies that systemd hands to this service, else the system's where it is there and can be read, else
    this user's.
    """
    if (handed := _handed()) is not None:
        return handed
    system = folders.SYSTEM / "keys" / arena
    return system if os.access(system, os.R_OK | os.X_OK) else folders.own_settings() / "keys" / arena


def _handed() -> Path | None:
    """Return the folder of systemd's LoadCredential=, which this service alone enters; None where it has no keys."""
    folder = os.environ.get("CREDENTIALS_DIRECTORY")
    return Path(folder) if folder and (Path(folder) / AUTHORITY).exists() else None


def joined() -> dict[str, Joined]:
    """Return the arenas of other computers that this one has joined, by name; what cannot be read is passed over."""
    found = {}
    for folder in (folders.own_settings() / "keys", folders.SYSTEM / "keys"):
        for file in sorted(folder.glob(f"*/{JOINED}")) if os.access(folder, os.R_OK | os.X_OK) else ():
            with suppress(OSError, ValueError, TypeError, KeyError):
                fields = json.loads(file.read_bytes())
                check_name(fields["name"])
                found[file.parent.name] = Joined(
                    fields["arena"], fields["name"], fields["kind"], tuple(fields["router"])
                )
    return found


def passport(arena: str, name: str) -> Passport:
    """Return what a name's certificate says; KeysError where there is none."""
    file = keys_folder(arena) / f"{name}.json"
    try:
        found = Passport.of(json.loads(file.read_bytes()))
        if (found.arena, found.name) != (arena, name):
            raise ValueError("somebody else's")
        return found
    except FileNotFoundError as error:
        raise KeysError(
            f"{file}: no keys of {name} for the arena {arena}: `robofleet keys add {arena} {name}` makes them "
            f"at the laboratory, `robofleet join FILE` puts them on a robot"
        ) from error
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is damaged"
        raise KeysError(f"{file}: {why}: join again, or add {name} again") from error


def credentials(arena: str, name: str) -> Credentials:
    """Return the files of a name; KeysError where they cannot be used now."""
    passport(arena, name).check(utc_now())
    found = Credentials.at(keys_folder(arena), name)
    for file in found[1:]:
        try:
            mode = file.stat().st_mode
        except OSError as error:
            raise KeysError(f"{file}: {error.strerror}: join again, or add {name} again") from error
        if file is found.key and stat.S_IMODE(mode) & 0o077 and file.parent != _handed():
            raise KeysError(f"{file}: others can read this private key: `chmod 600 {file}`, and renew it")
    return found


def session_id(passport: Passport) -> str:
    """Return the only Zenoh ID that a unit with this certificate may have: so a copied key finds its place taken."""
    drawn = hashlib.blake2b(
        f"{passport.arena}\n{passport.common_name}\n{passport.serial}".encode(), digest_size=_ZID
    ).hexdigest()
    return f"1{drawn[1:]}"  # Zenoh takes no leading zero
