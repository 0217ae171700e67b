"""By what the page is known beyond this computer: a certificate that the arena's authority has signed.

There is no page beyond this computer without it: its requests drive robots.
"""

import ipaddress
import ssl
from typing import TYPE_CHECKING, NamedTuple

from robofleet.bus.credentials import AUTHORITY, Credentials, KeysError, credentials, keys_folder
from robofleet.bus.permissions import PAGE
from robofleet.core.errors import RobofleetError
from robofleet.core.refusal import RefusedError, need_extra
from robofleet.operator.page.page_address import is_local

if TYPE_CHECKING:
    from cryptography.x509 import Certificate


class PageKeys(NamedTuple):
    """What a server needs to prove that it is the arena's page."""

    context: ssl.SSLContext
    fingerprint: str  # SHA-256 of the certificate, as browsers show it


def page_keys(arena: str, host: str, option: str) -> PageKeys | None:
    """Return the keys for a page at an address; None on this computer. RefusedError names the commands that mend."""
    if is_local(host):
        return None
    need_extra("lab", "cryptography")
    try:
        return opened(credentials(arena, PAGE), host)
    except KeysError as error:
        at = Credentials.at(keys_folder(arena), PAGE)
        add = f"`robofleet keys add {arena} {PAGE} --address {host}`"
        if at.certificate.exists():
            raise RefusedError(f"{option} {host}: {error}") from error
        first = (
            ""
            if (at.certificate.parent / AUTHORITY).exists()
            else f"`robofleet keys init {arena} --address {host}`, then "
        )
        raise RefusedError(
            f"{option} {host}: beyond this computer the page needs a certificate of the arena {arena}: {first}{add}"
        ) from error
    except _UnfitError as error:
        named = " ".join(f"--address {address}" for address in dict.fromkeys((host, *error.addresses)))
        raise RefusedError(
            f"{option} {host}: {error}: `robofleet keys revoke {arena} {PAGE}`, "
            f"then `robofleet keys add {arena} {PAGE} {named}`"
        ) from error


def opened(own: Credentials, host: str) -> PageKeys:
    """Return keys, tried; raises an error where they prove nothing of an address."""
    from cryptography import x509  # noqa: PLC0415
    from cryptography.exceptions import InvalidSignature  # noqa: PLC0415
    from cryptography.hazmat.primitives.hashes import SHA256  # noqa: PLC0415

    try:
        certificate = x509.load_pem_x509_certificate(own.certificate.read_bytes())
        names = _names(certificate)
        if _canonical(host) not in names:
            raise _UnfitError(f"{own.certificate} is for {', '.join(names) or 'nobody'} only", names)
        certificate.verify_directly_issued_by(x509.load_pem_x509_certificate(own.authority.read_bytes()))
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.options |= ssl.OP_NO_RENEGOTIATION | ssl.OP_NO_TICKET
        context.num_tickets = 0  # clients that read and write in two threads lose their first request over such a one
        context.set_alpn_protocols(["http/1.1"])
        context.load_cert_chain(own.certificate, own.key)
    except InvalidSignature as error:
        raise _UnfitError(f"{own.certificate} is not of the authority {own.authority}", names) from error
    except (ValueError, TypeError, ssl.SSLError) as error:  # an SSLError is an OSError, too
        raise _UnfitError(f"{own.certificate} and {own.key.name} are damaged, or not of one pair", ()) from error
    except OSError as error:
        raise KeysError(f"{error.filename}: {error.strerror}") from error
    return PageKeys(context, certificate.fingerprint(SHA256()).hex(":").upper())


class _UnfitError(RobofleetError):
    """Raised where a certificate cannot be used. It carries the addresses that the certificate is for."""

    def __init__(self, why: str, addresses: tuple[str, ...]) -> None:
        super().__init__(why)
        self.addresses = tuple(address for address in addresses if not is_local(address))


def _names(certificate: "Certificate") -> tuple[str, ...]:
    """Return what a certificate is for: addresses and names of hosts."""
    from cryptography import x509  # noqa: PLC0415

    try:
        found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return ()
    addresses = map(str, found.get_values_for_type(x509.IPAddress))
    return *addresses, *(name.lower() for name in found.get_values_for_type(x509.DNSName))


def _canonical(host: str) -> str:
    """Return an address as it stands in a certificate: without the interface, which only this computer knows."""
    try:
        return str(ipaddress.ip_address(host.partition("%")[0]))
    except ValueError:
        return host.lower()
