"""A bundle: the one file by which a computer joins an arena, made where the authority is and unpacked on the robot."""

import os
import ssl
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainSerializer, PlainValidator, ValidationError

from robofleet.bus.credentials import AUTHORITY, JOINED, ROUTER, Credentials, Joined, KeysError, Passport
from robofleet.bus.private_folder import PlaceError, check_private
from robofleet.config.files.robot_file import Routers
from robofleet.core.clock import utc_now
from robofleet.core.files import read_named, write_bytes
from robofleet.core.valid_json import dumps

FORMAT: Final = 1
_LARGEST_BUNDLE_BYTES = 65536
_CHECK_SS_SIGNATURE = ssl.VerifyFlags(0x4000)  # OpenSSL's X509_V_FLAG: of the authority too, which signs itself
_PEM = Annotated[str, Field(pattern=r"^-----BEGIN ", max_length=16384)]


APassport = Annotated[Passport, PlainValidator(Passport.of), PlainSerializer(Passport.plain)]


class Bundle(BaseModel):
    """What is in the file: JSON."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    format: Literal[1] = FORMAT
    robofleet: str  # version that made it
    passport: APassport
    certificate: _PEM
    key: _PEM
    authority: _PEM
    router: Routers


class _Any(BaseModel):
    """What every format has."""

    format: int
    robofleet: str


def bundled(own: Credentials, passport: Passport, router: tuple[str, ...]) -> Bundle:
    certificate, key, authority = (file.read_text() for file in own[1:])
    return Bundle(
        robofleet=version("robofleet"), passport=passport, certificate=certificate, key=key, authority=authority,
        router=router,
    )  # fmt: skip


def write(file: Path, bundle: Bundle) -> None:
    write_private(file, bundle.model_dump_json(indent=1).encode())


def read(file: Path) -> Bundle:
    """Read a bundle that is valid now; KeysError where it cannot be used."""
    try:
        text = read_named(file, _LARGEST_BUNDLE_BYTES)
    except OSError as error:
        raise KeysError(f"{file}: {error.strerror}: name the file that `robofleet keys bundle` made") from error
    try:
        bundle = Bundle.model_validate_json(text)
    except ValidationError as error:
        raise KeysError(f"{file}: {_what_is_wrong(text, error)}") from error
    bundle.passport.check(utc_now())
    _prove(file, bundle)
    return bundle


def _prove(file: Path, bundle: Bundle) -> None:
    """Raise KeysError where certificate, key and authority do not belong together, or say other than the passport."""
    passport = bundle.passport
    try:
        found = _accepted(bundle)
    except (ssl.SSLError, ValueError) as error:
        raise KeysError(
            f"{file}: its certificate, key and authority do not belong together: "
            "copy again what `robofleet keys bundle` made"
        ) from error
    names = [value for part in found.get("subject", ()) for name, value in part if name == "commonName"]
    if names != [passport.common_name] or str(found["serialNumber"]).lower().lstrip("0") != passport.serial:
        raise KeysError(
            f"{file}: it says that it is of {passport.name}, and its certificate is of {', '.join(names)}: "
            "copy again what `robofleet keys bundle` made"
        )


def _accepted(bundle: Bundle) -> dict[str, Any]:
    """Return what the certificate says to who asks for one of this authority, as both ends of TLS in memory.

    It is asked for as it is used: a router's as that of a server, all others as those of clients.
    """
    ends = []
    for protocol in (ssl.PROTOCOL_TLS_SERVER, ssl.PROTOCOL_TLS_CLIENT):
        asks = (protocol == ssl.PROTOCOL_TLS_CLIENT) == (bundle.passport.kind == ROUTER)
        context = ssl.SSLContext(protocol)
        context.check_hostname, context.verify_mode = False, ssl.CERT_REQUIRED if asks else ssl.CERT_NONE
        context.verify_flags |= _CHECK_SS_SIGNATURE
        context.load_verify_locations(cadata=bundle.authority)
        with _in_memory(bundle.certificate) as certificate, _in_memory(bundle.key) as key:
            context.load_cert_chain(certificate, key, password="")  # asks nobody for one
        ends.append(context)
    up, down = ssl.MemoryBIO(), ssl.MemoryBIO()
    server = ends[0].wrap_bio(up, down, server_side=True)
    client = ends[1].wrap_bio(down, up)
    for end in (client, server, client, server):
        with suppress(ssl.SSLWantReadError):
            end.do_handshake()
    return dict((client if bundle.passport.kind == ROUTER else server).getpeercert() or {})


@contextmanager
def _in_memory(text: str) -> Iterator[str]:
    """Give the name of a file that is on no disk."""
    descriptor = os.memfd_create("robofleet")
    try:
        os.write(descriptor, text.encode())
        yield f"/proc/self/fd/{descriptor}"
    finally:
        os.close(descriptor)


def _what_is_wrong(text: bytes, error: ValidationError) -> str:
    for found in error.errors(include_url=False, include_input=False):
        if isinstance(why := found.get("ctx", {}).get("error"), KeysError):
            return f"{why}: trust nothing in this file"
    try:
        other = _Any.model_validate_json(text)
    except ValidationError:
        return "is no bundle, or damaged: copy again what `robofleet keys bundle` made"
    if other.format != FORMAT:
        return (
            f"robofleet {other.robofleet} made it, and {version('robofleet')} is installed here: "
            "install the same version on both"
        )
    return "is damaged: copy again what `robofleet keys bundle` made"


def unpack(bundle: Bundle, folder: Path) -> Credentials:
    """Put the keys into a folder, in the place of older ones of the same name."""
    _refuse_other_authority(bundle, folder)
    make_private(folder)
    own = Credentials.at(folder, bundle.passport.name)
    write_private(own.key, bundle.key.encode())
    write_private(own.certificate, bundle.certificate.encode())
    write_private(folder / AUTHORITY, bundle.authority.encode())
    write_private(folder / f"{own.name}.json", dumps(bundle.passport.plain()).encode())
    joined = Joined(arena=bundle.passport.arena, name=own.name, kind=bundle.passport.kind, router=bundle.router)
    write_private(folder / JOINED, dumps(joined._asdict()).encode())
    return own


def _refuse_other_authority(bundle: Bundle, folder: Path) -> None:
    """Raise KeysError where the folder is that of an authority, and the bundle is another one's."""
    installed = folder / AUTHORITY
    if (folder / "authority.key").exists() and installed.exists() and installed.read_text() != bundle.authority:
        raise KeysError(
            f"{folder} is the folder of another authority of {bundle.passport.arena}: "
            "the bundle would end it: move that folder away first if that is meant"
        )


def make_private(folder: Path) -> None:
    """Make a folder of keys, or take one that is this user's alone; KeysError where it is not.

    An empty one is closed to others; one that holds something is left as it is, whoever named it.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat()
        if stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid() and not any(folder.iterdir()):
            folder.chmod(0o700)
        check_private(folder, "XDG_CONFIG_HOME")
    except PlaceError as error:
        raise KeysError(str(error)) from error
    except OSError as error:
        raise KeysError(f"{error.filename}: {error.strerror}: keys are to be kept there") from error


def write_private(file: Path, content: bytes) -> None:
    """Write a file that only its owner may read, whole or not at all; KeysError where that cannot be."""
    umask = os.umask(0o077)
    try:
        write_bytes(file, content)
    except OSError as error:
        raise KeysError(f"{error.filename or file}: {error.strerror}") from error
    finally:
        os.umask(umask)
