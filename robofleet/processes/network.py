"""The router of an arena that other hosts reach: its certificate, and what each of them may say and hear."""

from typing import Any

from robofleet.comms.credentials import KeysError, credentials, keys_folder
from robofleet.comms.zenoh_bus import Network, router_settings
from robofleet.config.tree import Config
from robofleet.processes.refusal import RefusedError, need_extra


def network(config: Config) -> Network | None:
    """Return how other hosts reach the router, None where none does; RefusedError where a key is missing."""
    if not config.bus.listen:
        return None
    need_extra("lab", "cryptography")
    from robofleet.comms.authority import ROUTER, Authority, identities  # noqa: PLC0415
    from robofleet.comms.permissions import access_control  # noqa: PLC0415

    arena = config.arena.name
    try:
        authority = Authority(arena, keys_folder(arena))
        own = credentials(arena, ROUTER)
    except KeysError as error:
        raise RefusedError(f"bus.listen: {error}") from error
    known = authority.entries()
    for unit in config.daemons:
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
