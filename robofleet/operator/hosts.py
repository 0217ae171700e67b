"""The computers of an arena's robots, as they answer within some seconds: during a run, and where the router stays."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table

from robofleet.bus.keys import HOST, STATUS, key
from robofleet.bus.messages import UNIT_STATUS, UnitStatus
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, WallClock
from robofleet.core.patterns import unit_of_role
from robofleet.operator.requests import JoinedArena, answering, reached
from robofleet.safety.latches import GateStatus

_LISTEN_NS = 2 * S
_POLL_NS = MS


def hosts(config: Config) -> dict[str, Any]:
    """Return every unit of an arena: what its computer says of itself, and how well it is heard.

    UnreachableError where no router answers.
    """
    clock, arena = WallClock(), config.arena.name
    silent = f"no router of {arena} answers at {config.bus.endpoint}: start a run, or one that stays (bus.router)"
    with answering(silent, arena, config.bus.endpoint, clock) as bus:
        return {"arena": arena, "units": _answers(bus, clock, arena, config.units, config.daemons)}


def hosts_elsewhere(access: JoinedArena) -> dict[str, Any]:
    """Return the units of another computer's arena that are linked now: only its configuration knows the others.

    UnreachableError where no router answers.
    """
    clock = WallClock()
    with reached(access, clock) as bus:
        linked = sorted(unit for role in bus.roles() if (unit := unit_of_role(role)) is not None)
        return {"arena": access.arena, "units": _answers(bus, clock, access.arena, dict.fromkeys(linked, ()), linked)}


def _answers(
    bus: ZenohBus, clock: WallClock, arena: str, units: Mapping[str, Sequence[str]], daemons: Sequence[str]
) -> list[dict[str, Any]]:
    by_unit: dict[str, list[UnitStatus]] = {unit: [] for unit in units}
    answers: dict[str, tuple[float, dict[str, Any]]] = {}
    keys = {key(arena, STATUS, unit): unit for unit in units}
    statuses = bus.stream(*keys, capacity=1024 * len(keys))
    clock.sleep_until(clock.now_ns() + S // 5)  # who serves what is heard of first
    requests = {unit: (clock.now_ns(), bus.ask(HOST, unit, b"?")) for unit in daemons}
    end_ns = clock.now_ns() + _LISTEN_NS
    while (now_ns := clock.now_ns()) < end_ns:
        for unit, (asked_ns, answer) in requests.items():
            if unit not in answers and (reply := answer.take()) is not None:
                answers[unit] = (now_ns - asked_ns) / MS, _read(reply)
        for _, full, payload in statuses.drain():
            if (status := UNIT_STATUS.decode(payload)) is not None:
                by_unit[keys[full]].append(status)
        clock.sleep_until(now_ns + _POLL_NS)
    return [_unit(unit, units[unit], by_unit[unit], answers.get(unit), daemon=unit in daemons) for unit in units]


def _read(reply: bytes) -> dict[str, Any]:
    try:
        fields = json.loads(reply)
    except ValueError:
        return {}
    return fields if isinstance(fields, dict) else {}


def _unit(
    unit: str, robots: Sequence[str], statuses: list[UnitStatus], answer: tuple[float, dict[str, Any]] | None, *,
    daemon: bool,
) -> dict[str, Any]:  # fmt: skip
    trip_ms, fields = answer or (None, {})
    seqs = [status.seq for status in statuses]
    sent = max(seqs) - min(seqs) + 1 if seqs else 0
    charges = [robot.battery for robot in statuses[-1].robots if robot.battery >= 0.0] if statuses else []
    return {
        "unit": unit, "robots": list(robots),
        "state": _state(statuses, daemon=daemon, answers=answer is not None),
        **{name: fields.get(name) for name in ("host", "version", "certificate_ends", "since")},
        "round_trip_ms": None if trip_ms is None else round(trip_ms, 1),
        "loss": round(1.0 - len(set(seqs)) / sent, 3) if sent > 1 else None,
        "battery": round(min(charges), 3) if charges else None,
    }  # fmt: skip


def _state(statuses: list[UnitStatus], *, daemon: bool, answers: bool) -> str:
    """Return what a unit does: where it is silent, somebody must look."""
    if daemon and not answers:
        return "no answer" if statuses else "silent"
    if not daemon and not statuses:
        return "silent"
    drives = bool(statuses) and any(robot.gate == GateStatus.OPEN for robot in statuses[-1].robots)
    return ("drives" if drives else "waits") + ("" if daemon else ", on this computer")


def table(found: dict[str, Any]) -> Table:
    shown = Table(title=f"the computers of {found['arena']}", box=None, header_style="bold")
    for name in ("unit", "state", "host", "version", "certificate", "round trip", "loss", "battery", "since"):
        shown.add_column(name)
    for host in found["units"]:
        state = f"[red]{host['state']}[/]" if host["state"] in ("silent", "no answer") else host["state"]
        shown.add_row(
            host["unit"], state, host["host"] or "", host["version"] or "", host["certificate_ends"] or "",
            "" if host["round_trip_ms"] is None else f"{host['round_trip_ms']:.1f} ms",
            "" if host["loss"] is None else f"{100 * host['loss']:.1f} %",
            "" if host["battery"] is None else f"{100 * host['battery']:.0f} %",
            (host["since"] or "")[5:16].replace("T", " "),
        )  # fmt: skip
    return shown
