"""The authority of an arena: it signs the certificate of everybody who may join from another host.

Zenoh reads no list of revoked certificates. Permissions are given to common names, and after a revocation a name's next
certificate has another common name: ``r1``, then ``r1#2``. So the router refuses the old one, and begins anew for that.
"""

import ipaddress
import re
from collections.abc import Sequence
from contextlib import suppress
from datetime import datetime, timedelta
from pathlib import Path
from typing import Self

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat, load_pem_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from robofleet.bus.credentials import (
    AUTHORITY,
    REGISTER,
    ROUTER,
    Credentials,
    KeysError,
    Passport,
    check_name,
    session_id,
)
from robofleet.bus.permissions import PAGE, UNIT, Identity
from robofleet.core.clock import utc_now
from robofleet.core.valid_json import dumps
from robofleet.hosts.bundle import APassport, make_private, write_private

AUTHORITY_DAYS, DAYS = 3650, 90
_KEY = "authority.key"
_HERE = "localhost", "127.0.0.1", "::1"
_CLOCK_TOLERANCE = timedelta(minutes=10)  # between two computers' clocks
_HOST_NAME = re.compile(r"[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?(\.[A-Za-z0-9]([A-Za-z0-9-]*[A-Za-z0-9])?)*")
_SERVER, _CLIENT = ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH
_SERVER_USAGES = {ROUTER: [_SERVER], PAGE: [_SERVER, _CLIENT]}  # all others are clients, and nobody's server
# What an authority signs for, whatever else it is told to: networks and names that nobody has on the Internet.
_NETWORKS = (
    "127.0.0.0/8", "10.0.0.0/8", "172.16.0.0/12", "192.168.0.0/16", "169.254.0.0/16", "100.64.0.0/10",
    "::1/128", "fe80::/10", "fc00::/7",
)  # fmt: skip
_DOMAINS = "localhost", "local", "internal", "lan", "home.arpa"


class Entry(BaseModel):
    """One name in the register."""

    model_config = ConfigDict(extra="forbid", strict=True)

    kind: str
    generation: int = 1  # counted on by every revocation
    revoked: bool = False  # and not issued again
    newest: APassport


class _Register(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    entries: dict[str, Entry] = Field(default={})


class Authority:
    """An arena's authority, in a folder that only its owner may read."""

    def __init__(self, arena: str, folder: Path) -> None:
        """Open it; KeysError where there is none."""
        self.arena, self.folder = arena, folder
        try:
            self._certificate = x509.load_pem_x509_certificate((folder / AUTHORITY).read_bytes())
            key = load_pem_private_key((folder / _KEY).read_bytes(), password=None)
            self._register = _Register.model_validate_json((folder / REGISTER).read_bytes())
        except FileNotFoundError as error:
            raise KeysError(
                f"{error.filename}: the arena {arena} has no authority here: `robofleet keys init {arena}`"
            ) from error
        except OSError as error:
            raise KeysError(f"{error.filename}: {error.strerror}") from error
        except (ValueError, ValidationError) as error:
            raise KeysError(f"{folder}: the authority of {arena} is damaged: take its folder from a backup") from error
        assert isinstance(key, ec.EllipticCurvePrivateKey)
        self._key = key

    @classmethod
    def create(cls, arena: str, folder: Path, days: int = AUTHORITY_DAYS, hosts: Sequence[str] = ()) -> Self:
        """Make an authority; KeysError where there is one: all robots would have to join again.

        ``hosts``: addresses and names, beside those of private networks, that its servers may have.
        """
        for host in hosts:
            _refuse_no_address(host)
        if (folder / AUTHORITY).exists():
            raise KeysError(f"{folder}: the arena {arena} has an authority: every certificate would end with it")
        make_private(folder)
        key, now = ec.generate_private_key(ec.SECP256R1()), utc_now()
        name = _name(f"robofleet {arena}")
        signed = (
            _builder(name, name, key, now, now + timedelta(days=days))
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(signs=True), critical=True)
            .add_extension(x509.ExtendedKeyUsage([_SERVER, _CLIENT]), critical=False)
            .add_extension(x509.NameConstraints(_permitted(hosts), None), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
            .sign(key, hashes.SHA256())
        )
        write_private(folder / _KEY, _private(key))
        write_private(folder / REGISTER, _Register().model_dump_json().encode())
        write_private(folder / AUTHORITY, signed.public_bytes(Encoding.PEM))
        return cls(arena, folder)

    def entries(self) -> dict[str, Entry]:
        """Return everybody who ever had a certificate, by name."""
        return dict(sorted(self._register.entries.items()))

    def issue(self, name: str, kind: str, *, addresses: Sequence[str] = (), days: int = DAYS) -> Credentials:
        """Make keys and a certificate; KeysError where the name has one that is not revoked."""
        known = self._register.entries.get(name)
        if known is not None and not known.revoked:
            raise KeysError(f"{name} has a certificate: `robofleet keys renew {self.arena} {name}`, or revoke it first")
        if kind in _SERVER_USAGES and not addresses:
            raise KeysError(f"{name}: others reach it by its address: add `--address 192.168.1.10`")
        check_name(name)
        for address in addresses:
            _refuse_no_address(address)
            self._refuse_not_permitted(address)
        generation = 1 if known is None else known.generation
        return self._issued(name, kind, generation, tuple(addresses), days)

    def renew(self, name: str, days: int | None = None) -> Credentials:
        """Make new keys and a certificate of the same name, for as long as the one before."""
        entry = self._known(name)
        if entry.revoked:
            raise KeysError(f"{name} is revoked: `robofleet keys add {self.arena} {name}` lets it in again")
        before = entry.newest
        lasted = round((before.not_after - before.not_before - _CLOCK_TOLERANCE) / timedelta(days=1))
        return self._issued(name, entry.kind, entry.generation, before.addresses, days or max(1, lasted))

    def revoke(self, name: str) -> None:
        """Let nobody in by this name's certificate any more: a router of this computer hears of it at once."""
        entry = self._known(name)
        if entry.revoked:
            raise KeysError(f"{name} is revoked already")
        entry.revoked, entry.generation = True, entry.generation + 1
        self._save()
        for file in (*Credentials.at(self.folder, name)[1:3], self.folder / f"{name}.json"):
            file.unlink(missing_ok=True)

    def _known(self, name: str) -> Entry:
        if name not in self._register.entries:
            known = ", ".join(self.entries()) or "nobody"
            raise KeysError(f"{name} has no certificate for the arena {self.arena} (known: {known})")
        return self._register.entries[name]

    def _refuse_not_permitted(self, address: str) -> None:
        """Raise KeysError where nobody would believe a certificate for this address."""
        try:
            permitted = self._certificate.extensions.get_extension_for_class(x509.NameConstraints).value
        except x509.ExtensionNotFound:  # an authority of before
            return
        if not any(_within(_general_name(address), subtree) for subtree in permitted.permitted_subtrees or ()):
            raise KeysError(
                f"{address}: the authority of {self.arena} signs for private networks alone, and for what it was made "
                f"for: move {self.folder} away, and begin anew: `robofleet keys init {self.arena} --address {address}`"
            )

    def _issued(self, name: str, kind: str, generation: int, addresses: tuple[str, ...], days: int) -> Credentials:
        common_name = name if generation == 1 else f"{name}#{generation}"
        key, now, serial = (
            ec.generate_private_key(ec.SECP256R1()),
            utc_now().replace(microsecond=0),
            x509.random_serial_number(),
        )
        last = self._certificate.not_valid_after_utc
        if now >= last:
            raise KeysError(
                f"this computer's clock says {now:%Y-%m-%d}, and the authority of {self.arena} ended on "
                f"{last:%Y-%m-%d}: set the clock, or move {self.folder} away and begin anew: "
                f"`robofleet keys init {self.arena}`"
            )
        ends = min(now + timedelta(days=days), last)
        builder = (
            _builder(_name(common_name), self._certificate.subject, key, now - _CLOCK_TOLERANCE, ends, serial)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(signs=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(_SERVER_USAGES.get(kind, [_CLIENT])), critical=False)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
            .add_extension(
                x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), critical=False
            )
        )  # fmt: skip
        if kind in _SERVER_USAGES:  # who is called has an address, and nobody else
            called = [_general_name(address) for address in (*_HERE, *addresses)]
            builder = builder.add_extension(x509.SubjectAlternativeName(called), critical=False)
        signed = builder.sign(self._key, hashes.SHA256())
        passport = Passport(
            arena=self.arena, name=name, kind=kind, common_name=common_name, serial=f"{serial:x}",
            not_before=now - _CLOCK_TOLERANCE, not_after=ends, addresses=addresses,
        )  # fmt: skip
        made = Credentials.at(self.folder, name)
        write_private(made.key, _private(key))
        write_private(made.certificate, signed.public_bytes(Encoding.PEM))
        write_private(self.folder / f"{name}.json", dumps(passport.plain()).encode())
        self._register.entries[name] = Entry(kind=kind, generation=generation, newest=passport)
        self._save()
        return made

    def _save(self) -> None:
        write_private(self.folder / REGISTER, self._register.model_dump_json(indent=1).encode())


def identities(authority: Authority) -> list[Identity]:
    """Return everybody whose certificate is not revoked, as permissions are given to them."""
    return [
        Identity(name, entry.kind, entry.newest.common_name, session_id(entry.newest) if entry.kind == UNIT else None)
        for name, entry in authority.entries().items()
        if not entry.revoked and entry.kind != ROUTER
    ]


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, starts: datetime, ends: datetime,
    serial: int | None = None,
) -> x509.CertificateBuilder:  # fmt: skip
    return x509.CertificateBuilder(
        issuer, subject, key.public_key(), serial or x509.random_serial_number(), starts, ends
    )


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _usage(*, signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=True, content_commitment=False, key_encipherment=False, data_encipherment=False,
        key_agreement=False, key_cert_sign=signs, crl_sign=signs, encipher_only=False, decipher_only=False,
    )  # fmt: skip


def _general_name(address: str) -> x509.GeneralName:
    """Return an IP address or a host's name, as it stands in certificates."""
    with suppress(ValueError):
        return x509.IPAddress(ipaddress.ip_address(address))
    return x509.DNSName(address)


def _within(name: x509.GeneralName, subtree: x509.GeneralName) -> bool:
    """Return whether an address or a host's name is one that a subtree of name constraints permits."""
    if isinstance(name, x509.IPAddress) and isinstance(subtree, x509.IPAddress):
        networks = ipaddress.IPv4Network, ipaddress.IPv6Network
        return (
            isinstance(subtree.value, networks) and not isinstance(name.value, networks) and name.value in subtree.value
        )
    if isinstance(name, x509.DNSName) and isinstance(subtree, x509.DNSName):
        return f".{name.value.lower()}".endswith(f".{subtree.value.lower()}")
    return False


def _permitted(hosts: Sequence[str]) -> list[x509.GeneralName]:
    """Return what an authority may sign for: private networks, and these hosts."""
    found: list[x509.GeneralName] = [x509.IPAddress(ipaddress.ip_network(network)) for network in _NETWORKS]
    for host in (*_DOMAINS, *hosts):
        with suppress(ValueError):
            found.append(x509.IPAddress(ipaddress.ip_network(host.partition("%")[0])))
            continue
        found.append(x509.DNSName(host))
    return found


def _refuse_no_address(address: str) -> None:
    """Raise KeysError where this is neither an IP address nor a host's name."""
    with suppress(ValueError):
        ipaddress.ip_address(address)
        return
    looks_like_ip = re.fullmatch(r"[\d.]+", address)
    if len(address) > 253 or looks_like_ip or not _HOST_NAME.fullmatch(address):
        raise KeysError(
            f"--address {address!r}: write a host's IP address or name alone, as 192.168.1.10 or lab.example"
        )


def _private(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
