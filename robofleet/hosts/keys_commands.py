"""Manage who may join an arena from another computer.

Each robot, process and person has keys and a certificate, signed by the arena's authority on this computer.

$ robofleet keys init lab
"""

import re
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from robofleet.bus.credentials import KINDS, ROUTER, Credentials, keys_folder
from robofleet.bus.permissions import OPERATOR, UNIT, VIEWER
from robofleet.config.load import load_config
from robofleet.core.clock import utc_now
from robofleet.core.patterns import NAME_PATTERN, NETWORK_PATTERN
from robofleet.core.refusal import RefusedError, need_extra
from robofleet.core.valid_json import dumps
from robofleet.hosts import bundle as bundles
from robofleet.hosts.authority import AUTHORITY_DAYS, DAYS, Authority, Entry
from robofleet.hosts.join_command import refused

ArenaName = Annotated[str, typer.Argument(metavar="ARENA", help="The arena: arena.name of the configuration.")]
Who = Annotated[
    str, typer.Argument(metavar="NAME", help="The name of a robot's computer (unit), a process, or a person.")
]
Days = Annotated[
    int | None, typer.Option(metavar="N", min=1, max=36500, help="Days for which the certificate is valid.")
]


@contextmanager
def _authority(arena: str) -> Iterator["Authority"]:
    with refused():
        need_extra("lab", "cryptography")
        yield Authority(_named(arena), keys_folder(arena))


def _named(name: str) -> str:
    if not re.fullmatch(NAME_PATTERN, name):
        raise RefusedError(f"{name!r} is no name: small letters, digits, - and _, at most 32, a letter first")
    return name


def init(
    arena: ArenaName,
    address: Annotated[
        list[str],
        typer.Option(
            metavar="ADDRESS", help="Also sign for this address or name outside private networks. Repeatable."
        ),
    ] = [],  # noqa: B006
    days: Days = None,
) -> None:
    """Make an arena's authority on this computer.

    It can sign only for private networks, .local, .lan, .internal and .home.arpa, and for each --address. Next:
    `robofleet keys add ARENA router`.

    $ robofleet keys init lab

    $ robofleet keys init lab --address lab.example.edu
    """
    with refused():
        need_extra("lab", "cryptography")
        made = Authority.create(_named(arena), keys_folder(arena), days or AUTHORITY_DAYS, address)
    print(f"{made.folder}: the authority of {arena}; keep a copy of this folder, and let nobody else read it")
    print(f"Next: robofleet keys add {arena} router --address THIS_COMPUTERS_ADDRESS")


def add(
    arena: ArenaName,
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME", help="The name of a robot's computer (unit), a process, or a person; not with --from."
        ),
    ] = None,
    kind: Annotated[
        str | None,
        typer.Option(
            metavar="KIND", help="unit, router, web, operator, viewer or script. Default: by the name, else unit."
        ),
    ] = None,
    address: Annotated[
        list[str], typer.Option(metavar="ADDRESS", help="Address of the router or the page. Repeatable.")
    ] = [],  # noqa: B006
    days: Days = None,
    source: Annotated[
        Path | None,
        typer.Option(
            "--from",
            metavar="CONFIG",
            help="Add the router, an operator, a viewer and every unit of CONFIG that have no certificate.",
        ),
    ] = None,
) -> None:
    """Make keys and a certificate for a name.

    $ robofleet keys add lab r1

    $ robofleet keys add lab router --address 192.168.1.10

    $ robofleet keys add lab alice --kind operator

    $ robofleet keys add lab --from configs/lab.yaml --address 192.168.1.10
    """
    if (name is None) == (source is None):
        raise RefusedError("name one, or a configuration with --from: `robofleet keys add lab r1`")
    if source is not None:
        _add_roster(arena, source, kind, address, days)
        return
    assert name is not None
    with _authority(arena) as authority:
        kind = kind or (name if name in KINDS else UNIT)
        if kind not in KINDS:
            raise RefusedError(f"--kind {kind}: one of {', '.join(KINDS)}")
        if kind == UNIT and name in KINDS:
            raise RefusedError(f"{name} is what a process is called: name the unit otherwise")
        authority.issue(_named(name), kind, addresses=address, days=days or DAYS)
        ends = authority.entries()[name].newest.not_after
    print(f"{name}: {kind}, valid until {ends:%Y-%m-%d}")
    if kind == UNIT:
        print(f"Next: robofleet keys bundle {arena} {name} --router quic/THIS_COMPUTERS_ADDRESS:7447")


def _add_roster(arena: str, source: Path, kind: str | None, address: list[str], days: int | None) -> None:
    """Add whom a configuration needs and who has no certificate: all of them, or nobody."""
    with _authority(arena) as authority:
        if kind is not None:
            raise RefusedError("--kind: it belongs to a name: leave --kind or --from out")
        config = load_config(source)
        if config.arena.name != arena:
            raise RefusedError(f"{source}: its arena is {config.arena.name}, not {arena}")
        exist = {robot.id for robot in config.robots if robot.driver != "simulated" and robot.twin is None}
        units = [unit for unit, robots in config.units.items() if exist & {*robots} or unit in config.daemons]
        if processes := [unit for unit in units if unit in KINDS]:
            raise RefusedError(f"{source}: {processes[0]} is what a process is called: name the unit otherwise")
        known = authority.entries()
        listened = [endpoint.partition("/")[2].rpartition(":")[0].strip("[]") for endpoint in config.bus.listen]
        at = address or [host for host in listened if host not in ("0.0.0.0", "::")]
        if ROUTER not in known and not at:
            raise RefusedError("the router needs the address by which robots reach it: add `--address 192.168.1.10`")
        # The router first: of all that can be wrong, its addresses are.
        for name, role in [(ROUTER, ROUTER), *((unit, UNIT) for unit in units), (OPERATOR, OPERATOR), (VIEWER, VIEWER)]:
            if name not in known:
                authority.issue(name, role, addresses=at if role == ROUTER else (), days=days or DAYS)
                print(f"{name}: {role}, valid until {authority.entries()[name].newest.not_after:%Y-%m-%d}")
            elif known[name].revoked:
                print(f"{name}: revoked, and stays so: `robofleet keys add {arena} {name}` lets it in again")
    if units:
        print(f"Next: robofleet keys bundle {arena} {units[0]} --router quic/THIS_COMPUTERS_ADDRESS:7447")


def listed(
    arena: ArenaName,
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
) -> None:
    """List the certificates, and when each ends.

    $ robofleet keys list lab
    """
    with _authority(arena) as authority:
        rows = [_row(name, entry) for name, entry in authority.entries().items()]
    if as_json:
        print(dumps({"arena": arena, "names": rows}))
        return
    table = Table("name", "kind", "valid until", "state", box=None, header_style="bold")
    colours = {"valid": "green", "ends soon": "yellow", "expired": "red", "revoked": "red"}
    for row in rows:
        table.add_row(row["name"], row["kind"], row["ends"][:10], f"[{colours[row['state']]}]{row['state']}[/]")
    Console().print(table)


def _row(name: str, entry: "Entry") -> dict[str, Any]:
    now, passport = utc_now(), entry.newest
    state = "expired" if now > passport.not_after else "ends soon" if passport.ends_soon(now) else "valid"
    return {
        "name": name, "kind": entry.kind, "common_name": passport.common_name, "ends": passport.not_after.isoformat(),
        "serial": passport.serial, "addresses": list(passport.addresses),
        "state": "revoked" if entry.revoked else state,
    }  # fmt: skip


def renew(
    arena: ArenaName,
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="The name; not with --all.")] = None,
    everybody: Annotated[bool, typer.Option("--all", help="Renew all that are not revoked.")] = False,
    days: Days = None,
) -> None:
    """Make new keys and a new certificate for a name.

    Then write its bundle, and join with it again on the other computer.

    $ robofleet keys renew lab r1
    """
    with _authority(arena) as authority:
        if (name is None) != everybody:
            raise RefusedError("name one, or say --all")
        names = [who for who, entry in authority.entries().items() if not entry.revoked] if name is None else [name]
        for who in names:
            authority.renew(who, days)
            print(f"{who}: valid until {authority.entries()[who].newest.not_after:%Y-%m-%d}")
    print(f"Next: robofleet keys bundle {arena} NAME, for whoever is on another computer, and join it there again")


def revoke(arena: ArenaName, name: Who) -> None:
    """Make a certificate invalid at once.

    The router starts again. This may hold a run that is on: its robots stand, and `robofleet resume` continues.

    $ robofleet keys revoke lab r1
    """
    with _authority(arena) as authority:
        authority.revoke(name)
        is_router = authority.entries()[name].kind == ROUTER
    resume = f", and cut off; if a run is held by that, go on: robofleet resume {arena}"
    print(
        f"{name} is revoked{'; a router that is on keeps it until it ends' if is_router else resume}\n"
        f"`robofleet keys add {arena} {name}` lets it in again"
    )


def bundle(
    arena: ArenaName,
    name: Who,
    router: Annotated[
        list[str],
        typer.Option(metavar="ADDRESS", help="Address of the router, for example quic/192.168.1.10:7447. Repeatable."),
    ],
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="File to write. Default: NAME.bundle.")] = None,
) -> None:
    """Write the file that another computer needs to join.

    Copy it to that computer, then delete it here. It holds a private key.

    $ robofleet keys bundle lab r1 --router quic/192.168.1.10:7447
    """
    with _authority(arena) as authority:
        for address in router:
            _refuse_no_router(address)
        entry = authority.entries().get(name)
        if entry is None or entry.revoked:
            raise RefusedError(f"{name} has no certificate: `robofleet keys add {arena} {name}`")
        entry.newest.check(utc_now())
        file = out or Path(f"{name}.bundle")
        own = Credentials.at(authority.folder, name)
        try:
            made = bundles.bundled(own, entry.newest, tuple(router))
        except OSError as error:
            raise RefusedError(f"{error.filename}: {error.strerror}: `robofleet keys renew {arena} {name}`") from error
        bundles.write(file, made)
    print(f"{file}: carry it to {name}, and there: robofleet join {shlex.quote(file.name)}")


def _refuse_no_router(address: str) -> None:
    if not re.fullmatch(NETWORK_PATTERN, address) or not 0 < int(address.rpartition(":")[2]) < 65536:
        raise RefusedError(f"--router {address!r}: write quic/HOST:PORT or tls/HOST:PORT, as quic/192.168.1.10:7447")
