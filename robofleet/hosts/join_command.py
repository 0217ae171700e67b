"""``robofleet join``: puts a bundle in place on the computer that joins an arena, and installs its driver's service."""

import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from math import inf
from pathlib import Path
from typing import Annotated, Any

import typer

from robofleet.bus.credentials import AUTHORITY, KeysError
from robofleet.bus.permissions import OPERATOR, UNIT
from robofleet.config.files.robot_file import FILE, load_robot_file
from robofleet.config.load import ConfigError
from robofleet.core import folders
from robofleet.core.files import write_text
from robofleet.core.plugins import known
from robofleet.core.refusal import RefusedError
from robofleet.core.valid_json import dumps
from robofleet.hosts import bundle as bundles

_SERVICE = Path("/etc/systemd/system/robofleet-unit.service")


@contextmanager
def refused() -> Iterator[None]:
    """End with exit code 2 and a line where a key cannot be used."""
    try:
        yield
    except KeysError as error:
        raise RefusedError(str(error)) from error
    except OSError as error:
        raise RefusedError(f"{error.filename}: {error.strerror}") from error


def join(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The file that `robofleet keys bundle` has written.")],
    service: Annotated[
        bool, typer.Option("--service", help="Install the driver as a systemd service; as root.")
    ] = False,
    into: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Write into this folder, for example /etc/robofleet of a mounted SD card."),
    ] = None,
    driver: Annotated[str | None, typer.Option(metavar="KIND", help="Allow only this kind of driver.")] = None,
    port: Annotated[str | None, typer.Option(metavar="PORT", help="Allow only this serial port.")] = None,
    max_wheel_speed: Annotated[
        float | None, typer.Option(metavar="RAD_S", help="Largest wheel speed that a run may set, in rad/s.")
    ] = None,
) -> None:
    """Let this computer join an arena.

    It installs the keys: as root or with --service in /etc/robofleet, else in ~/.config/robofleet. Without --service,
    XDG_CONFIG_HOME names another folder.

    $ robofleet join r1.bundle --service

    $ robofleet join r1.bundle --into /media/card/etc/robofleet --driver gternal --max-wheel-speed 12.5
    """
    with refused():
        allows = _allowed(driver, port, max_wheel_speed)
        made = bundles.read(file)
        passport = made.passport
        if allows and passport.kind != UNIT:
            raise RefusedError(f"--driver, --port, --max-wheel-speed: {passport.name} is no unit: leave them out")
        if service:
            _refuse_service(passport.kind, into)
        base = _base(passport.arena, into, service=service)
        if passport.kind == UNIT:
            _refuse_other(base, passport.arena, passport.name)
        with _readable(base):
            bundles.unpack(made, base / "keys" / passport.arena)
        print(f"{base}/keys/{passport.arena}: the keys of {passport.name}, valid until {passport.not_after:%Y-%m-%d}")
        if passport.kind == OPERATOR:
            print(f"Next: on this computer, robofleet stop {passport.arena} stops that arena's robots")
        if passport.kind != UNIT:
            return
        with _readable(base):
            written = _write_robot_file(base, made, allows)
        print(f"{written}: what a run may ask of this robot: its driver, port and fastest wheel")
        if service:
            _install(passport.arena, passport.name)
        print(
            "Next: systemctl enable --now robofleet-unit"
            if service
            else f"Next: robofleet node driver --unit {passport.name}"
        )
        print(f"Then delete {file} here and at the laboratory")


def _refuse_other(base: Path, arena: str, unit: str) -> None:
    """Refuse a bundle where this computer is another unit already, or one of another arena."""
    file = base / FILE
    if not file.exists():
        return
    try:
        present = load_robot_file(file)
    except ConfigError as error:
        raise RefusedError(f"{error}\n{file} cannot be read: mend it or remove it, and join again") from error
    if (present.arena, present.unit) != (arena, unit):
        raise RefusedError(
            f"this computer is {present.unit} of {present.arena}, and the bundle is for {unit} of {arena}: "
            f"remove {file} first if that is meant"
        )


def _allowed(driver: str | None, port: str | None, max_wheel_speed: float | None) -> dict[str, Any]:
    """Return what robot.yaml is to allow, as the options say; RefusedError where that cannot be."""
    allows: dict[str, Any] = {}
    if driver is not None:
        if ":" not in driver and driver not in (kinds := known("robofleet.drivers")):
            raise RefusedError(f"--driver {driver}: known: {', '.join(kinds)}, or write module:Class")
        allows["drivers"] = [driver]
    if port is not None:
        if not port.strip():
            raise RefusedError("--port: name a port, as /dev/ttyUSB0")
        allows["ports"] = [port]
    if max_wheel_speed is not None:
        if not 0 < max_wheel_speed < inf:
            raise RefusedError(f"--max-wheel-speed {max_wheel_speed:g}: write a speed above 0, in rad/s")
        allows["max_wheel_speed_rad_s"] = max_wheel_speed
    return allows


def _base(arena: str, into: Path | None, *, service: bool) -> Path:
    """Return the folder for keys and robot.yaml; RefusedError where keys there would hide this user's authority."""
    if into is not None:
        return into
    if not service and (not _is_root() or os.environ.get("XDG_CONFIG_HOME")):
        return folders.own_settings()
    own = folders.own_settings() / "keys" / arena
    if (own / "authority.key").exists() and not (folders.SYSTEM / "keys" / arena).exists():
        raise RefusedError(
            f"{own}: the authority of {arena} is here, and keys in {folders.SYSTEM} would hide it: join on the robot, "
            f"or --into {own.parent.parent}"
        )
    return folders.SYSTEM


@contextmanager
def _readable(base: Path) -> Iterator[None]:
    """Let every user of this computer read what is written for all of it; keys are written for their owner alone."""
    umask = os.umask(0o022)
    if base != folders.SYSTEM:
        os.umask(umask)
    try:
        yield
    finally:
        os.umask(umask)


def _write_robot_file(base: Path, made: Any, allows: dict[str, Any]) -> Path:
    """Write robot.yaml; one that is there keeps what it allows, but for what ``allows`` names."""
    file: Path = base / FILE
    if file.exists():
        present = load_robot_file(file)
        if present.router == made.router and not allows:
            return file
        allows = present.allows.model_dump(mode="json", exclude_none=True) | allows
    passport = made.passport
    example = "  # for example {drivers: [gternal], ports: [/dev/ttyUSB0], max_wheel_speed_rad_s: 12.5}"
    lines = [
        "# This robot's own computer: `robofleet join` has written it.",
        f"arena: {dumps(passport.arena)}", f"unit: {dumps(passport.name)}", f"router: {dumps(made.router)}",
        "# What a run may ask of this robot, whatever its configuration says; what is not named is allowed.",
        f"allows: {dumps(allows)}" + ("" if allows else example),
    ]  # fmt: skip
    write_text(file, "\n".join(lines) + "\n")
    return file


def _is_root() -> bool:
    return os.geteuid() == 0


def _refuse_service(kind: str, into: Path | None) -> None:
    if into is not None:
        raise RefusedError("--service: it starts at /etc/robofleet of this computer: leave --service or --into out")
    if kind != UNIT:
        raise RefusedError("--service: only a unit's driver is a service")
    if not _is_root():
        raise RefusedError("--service: run it as root: `sudo robofleet join FILE --service`")
    if not _SERVICE.parent.is_dir():
        raise RefusedError(f"--service: there is no {_SERVICE.parent}: this computer has no systemd")


def _install(arena: str, unit: str) -> None:
    program = shutil.which("robofleet") or f"{sys.executable} -P -m robofleet"
    keys = folders.SYSTEM / "keys" / arena
    handed = "\n".join(
        f"LoadCredential={file}:{keys / file}"
        for file in (*(f"{unit}.{end}" for end in ("json", "pem", "key")), AUTHORITY)
    )
    text = f"""\
[Unit]
Description=robofleet's driver of {unit}
After=network.target
StartLimitIntervalSec=0

[Service]
Type=notify
ExecStart={program} node driver --unit {unit}
# A user of its own, without a right but to the robot's port. Root keeps the keys, and systemd hands over copies.
DynamicUser=yes
SupplementaryGroups=dialout
{handed}
StateDirectory=robofleet
Environment=XDG_STATE_HOME=/var/lib PYTHONUNBUFFERED=1
TimeoutStartSec=infinity
TimeoutStopSec=2
# Longer than a robot's port takes to open. The dead man's process stops the wheels long before.
WatchdogSec=15
WatchdogSignal=SIGKILL
KillMode=process
Restart=always
RestartSec=1
RestartPreventExitStatus=2
# Niceness -10 and SCHED_FIFO for the loop need these limits, and no capability.
LimitNICE=-10
LimitRTPRIO=20
OOMScoreAdjust=-500

NoNewPrivileges=yes
CapabilityBoundingSet=
ProtectSystem=strict
ProtectHome=yes
ProtectProc=invisible
ProtectClock=yes
ProtectHostname=yes
ProtectKernelLogs=yes
ProtectKernelModules=yes
ProtectKernelTunables=yes
ProtectControlGroups=yes
PrivateTmp=yes
PrivateMounts=yes
RestrictNamespaces=yes
RestrictSUIDSGID=yes
RemoveIPC=yes
LockPersonality=yes
UMask=0077
# Serial ports and no other device. A driver of yours that needs one: `systemctl edit robofleet-unit`, DeviceAllow=.
DevicePolicy=closed
DeviceAllow=char-ttyUSB rw
DeviceAllow=char-ttyACM rw
DeviceAllow=char-ttyAMA rw
DeviceAllow=char-ttyS rw
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6 AF_NETLINK
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallErrorNumber=EPERM

[Install]
WantedBy=multi-user.target
"""
    write_text(_SERVICE, text)
    print(f"{_SERVICE}: the service")
