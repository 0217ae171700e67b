"""The router of an arena that other hosts reach: its certificate, and what each of them may say and hear."""

from collections.abc import Mapping
from typing import Any

from robofleet.bus.arena_file import running
from robofleet.bus.credentials import REGISTER, ROUTER, KeysError, credentials, keys_folder
from robofleet.bus.zenoh_bus import Network, router_settings
from robofleet.config.tree import Config
from robofleet.core.clock import S, WallClock
from robofleet.core.refusal import RefusedError, need_extra


def network(config: Config, *, all_units: bool = True) -> Network | None:
    """Return how other hosts reach the router, None where none does; RefusedError where a key is missing.

    ``all_units``: that of a unit, too.
    """
    if not config.bus.listen:
        return None
    need_extra("lab", "cryptography")
    from robofleet.bus.permissions import access_control  # noqa: PLC0415
    from robofleet.hosts.authority import Authority, identities  # noqa: PLC0415

    arena = config.arena.name
    try:
        authority = Authority(arena, keys_folder(arena))
        own = credentials(arena, ROUTER)
    except KeysError as error:
        raise RefusedError(f"bus.listen: {error}") from error
    known = authority.entries()
    for unit in config.daemons if all_units else ():
        if unit not in known or known[unit].revoked:
            raise RefusedError(f"bus.listen: {unit} has no certificate: `robofleet keys add {arena} {unit}`")
    addresses = known[ROUTER].newest.addresses
    for endpoint in config.bus.listen:
        host = endpoint.partition("/")[2].rpartition(":")[0].strip("[]")
        if host not in (*addresses, "localhost", "127.0.0.1", "::1", "0.0.0.0", "::"):
            raise RefusedError(
                f"bus.listen: {endpoint}: the router's certificate names {', '.join(addresses)}: `robofleet keys "
                f"revoke {arena} router`, then `robofleet keys add {arena} router --address {host}`"
            )
    return Network(config.bus.listen, own, access_control(arena, identities(authority)))


class Keys:
    """An arena's keys, of which its router must hear: of a revocation at once, of others while no run is on."""

    _RUNS_NS = S  # between two looks at the runs of this computer

    def __init__(self, config: Config) -> None:
        self._config, self._clock = config, WallClock()
        self._seen = self._read = self._next_ns = 0
        self._seen = self._read = self._state()

    def changed(self, permitted: Mapping[str, Any]) -> bool:
        """Return whether a router that goes by ``permitted`` (``permissions.access_control``) must begin anew.

        That disturbs a run, so only a revocation does it while one is on; a run's own router hears of nothing else.
        """
        state = self._state()
        if state == self._seen:
            return False
        if state != self._read and (revoked := self._revoked(permitted)) is not None:
            self._read = state
            if revoked:
                self._seen = state
                return True
        now_ns = self._clock.now_ns()
        if self._config.bus.router != "service" or now_ns < self._next_ns:
            return False
        self._next_ns = now_ns + self._RUNS_NS
        if running(self._config.arena.name):
            return False
        self._seen = state
        return True

    def _revoked(self, permitted: Mapping[str, Any]) -> bool | None:
        """Return whether somebody is let in whose certificate is revoked; None where the keys cannot be read now."""
        from robofleet.hosts.authority import Authority, identities  # noqa: PLC0415

        arena = self._config.arena.name
        try:
            valid = {who.common_name for who in identities(Authority(arena, keys_folder(arena)))}
        except KeysError:
            return None
        return any(not valid.issuperset(subject.get("cert_common_names", ())) for subject in permitted["subjects"])

    def _state(self) -> int:
        try:
            return (keys_folder(self._config.arena.name) / REGISTER).stat().st_mtime_ns
        except OSError:  # a folder that is away says nothing new
            return self._seen


def settings_of(config: Config) -> dict[str, Any]:
    """Return Zenoh's settings of the router, as zenohd's file has them: nested."""
    nested: dict[str, Any] = {}
    for name, value in router_settings(config.bus.endpoint, network(config)).items():
        *path, last = name.split("/")
        part = nested
        for step in path:
            part = part.setdefault(step, {})
        part[last] = value
    return nested
