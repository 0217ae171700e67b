"""Hands a run's configuration to the drivers that wait on computers of their own."""

import json
import zlib
from importlib.metadata import version
from typing import Any, NamedTuple

from pydantic import ValidationError

from robofleet.bus.bus import Answer, Bus
from robofleet.bus.keys import CONFIG
from robofleet.bus.messages import HANDED, Handed
from robofleet.bus.statuses import Statuses
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.core.errors import RobofleetError

_AGAIN_NS, _SILENT_NS = S // 2, S
_LARGEST_CONFIG_BYTES = 16 << 20  # unpacked


class HandedError(RobofleetError):
    """Raised where this computer cannot take a configuration. The message says why."""


def packed(config: Config) -> Handed:
    text = json.dumps({"version": version("robofleet"), "config": config.model_dump(mode="json")})
    return Handed(slices.build(config), zlib.compress(text.encode()))


def unpacked(message: Handed) -> Config:
    """Return the configuration of a message; HandedError where it is another version's, or damaged."""
    ours = version("robofleet")
    try:
        unpacking = zlib.decompressobj()
        fields: Any = json.loads(unpacking.decompress(message.packed, _LARGEST_CONFIG_BYTES))
        theirs, plain = str(fields["version"]), json.dumps(fields["config"])
    except (zlib.error, ValueError, TypeError, KeyError) as error:
        raise HandedError("the configuration came damaged") from error
    if theirs != ours:
        raise HandedError(f"robofleet {ours} runs here and {theirs} at the laboratory: install the same on both")
    try:
        config = Config.model_validate_json(plain)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise HandedError(
            f"the configuration is not valid here ({where}: {first['msg']}): install the laboratory's robofleet"
        ) from error
    if slices.build(config) != message.build:
        raise HandedError("the configuration came damaged: its number is another one")
    return config


class Refusal(NamedTuple):
    """What a unit said instead of taking the configuration."""

    unit: str
    why: str


class Handing:
    """Asks each unit that waits, again until its status shows the run's own build."""

    def __init__(self, config: Config, bus: Bus, statuses: Statuses) -> None:
        self._bus, self._statuses, self._units = bus, statuses, config.daemons
        self._message = HANDED.encode(packed(config)) if self._units else b""
        self._build = slices.build(config)
        self._numbers = {unit.name: number for number, unit in enumerate(statuses.units)}
        self._requests: dict[str, Answer] = {}
        self._heard_ns: dict[str, int] = {}  # when a unit's status was a new one
        self._newest: dict[str, tuple[int, int]] = {}
        self._again_ns = 0
        self.refused: dict[str, str] = {}  # by unit: why it does not take the configuration

    def step(self, now_ns: int) -> list[Refusal]:
        """Ask who has not taken it; returns what is refused anew."""
        if not self._units:
            return []
        self._listen(now_ns)
        news = [refusal for unit in tuple(self._requests) if (refusal := self._heard(unit)) is not None]
        if now_ns >= self._again_ns:
            self._again_ns = now_ns + _AGAIN_NS
            for unit in self._units:
                if not self._has(unit, now_ns):
                    self._requests[unit] = self._bus.ask(CONFIG, unit, self._message)
        return news

    def _listen(self, now_ns: int) -> None:
        for unit in self._units:
            status = self._statuses.newest[self._numbers[unit]]
            if status is not None and (status.boot_id, status.nonce) != self._newest.get(unit):
                self._newest[unit], self._heard_ns[unit] = (status.boot_id, status.nonce), now_ns

    def _has(self, unit: str, now_ns: int) -> bool:
        """Whether a unit has this run's configuration, and speaks: a computer that starts again has none."""
        status = self._statuses.newest[self._numbers[unit]]
        silent = now_ns - self._heard_ns.get(unit, 0) > _SILENT_NS
        has = status is not None and status.build == self._build and not silent
        if has:
            self.refused.pop(unit, None)
        return has

    def _heard(self, unit: str) -> Refusal | None:
        answer = self._requests[unit].take()
        if answer is None:
            return None
        del self._requests[unit]
        words = answer.decode(errors="replace")
        if words == "ok" or words == self.refused.get(unit):
            return None
        self.refused[unit] = words
        return Refusal(unit, words)
