"""A process beside a run: it hears what the recorder hears, and serves what the recorder writes."""

import os
from contextlib import closing
from pathlib import Path

from foxglove import Service

from robofleet.clock import MS, S, WallClock, epoch_ns
from robofleet.comms.bus import Stream
from robofleet.comms.credentials import credentials
from robofleet.comms.joining import joined
from robofleet.comms.keys import STATE
from robofleet.comms.keys import key as key_of
from robofleet.comms.permissions import OPERATOR, PAGE, VIEWER
from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.files import replaced
from robofleet.gateways.asking import SERVICES, Asking
from robofleet.gateways.foxglove.address import Address
from robofleet.gateways.foxglove.server import Keys, Server
from robofleet.gateways.foxglove.services import new_key, services
from robofleet.gateways.place import Place, is_over
from robofleet.processes.node import Lifeline
from robofleet.processes.refusal import RefusedError
from robofleet.recording.channels import keys
from robofleet.recording.drawn import Drawn, of_key
from robofleet.recording.run import Recording
from robofleet.recording.viewers import foxglove as layouts

_NICE = 5  # viewers wait for the run, never the other way round
_JOIN_WITHIN_S = 60.0  # the router is the first process of a run
_QUEUE = 65536  # messages
_PERIOD_NS = 40 * MS
_BATCH = 15  # ticks of a robot at once: half a second
_SILENT_NS = 3 * S  # of the supervisor: then it is asked whether there is a run
LAYOUT = "foxglove.json"


def serve(
    config: Config, place: Place, at: Address, folder: Path, lifeline: Lifeline, within_s: float = _JOIN_WITHIN_S
) -> None:
    """Serve a run until it ends, or until the lifeline is cut.

    TimeoutError where its bus does not answer, RefusedError where the address cannot be used. ``folder``: for the
    layout, which has the key of the services.
    """
    os.nice(_NICE)
    clock = WallClock()

    def look() -> None:
        if lifeline.cut:
            raise SystemExit

    bus = joined(config.arena.name, place.endpoint, VIEWER, clock, within_s, look, place.credentials)
    asking = Asking(bus, clock, config)
    key = new_key() if place.role == OPERATOR else ""
    try:
        offered = services(asking, key) if key else []
        stream = bus.stream(*keys(config), capacity=_QUEUE)
        with closing(Viewers(config, stream, at, offered, epoch_ns())) as viewers:
            layout = _layout(config, folder, key)
            lifeline.ready(f"Foxglove, Lichtblick: open {at.url(viewers.port)}, with the layout {layout}")
            while not lifeline.cut:
                now_ns = clock.now_ns()
                viewers.step(now_ns)
                if now_ns - viewers.state_ns > _SILENT_NS and is_over(config, place):
                    break
                clock.sleep_until(now_ns + _PERIOD_NS)
            viewers.rest()
    finally:
        asking.close()
        bus.close()


class Viewers:
    """Tells viewers what the bus says, and what is drawn of it."""

    def __init__(self, config: Config, stream: Stream, at: Address, offered: list[Service], epoch_ns: int) -> None:
        """Take all that is said, and what makes its instants dates; RefusedError where the address is no good."""
        self._stream, self._epoch_ns = stream, epoch_ns
        self._drawn = Drawn(config, groups.descriptions(config), epoch_ns=epoch_ns, batch=_BATCH)
        channels = [*map(of_key, keys(config)), *self._drawn.channels]
        try:
            self._server = Server(config.arena.name, at, _certificate(config, at), channels, offered)
        except OSError as error:
            raise RefusedError(f"{at}: {error}: name another HOST:PORT") from error
        self._state = key_of(config.arena.name, STATE)
        self.port = self._server.port
        self.state_ns = 0  # when the supervisor was heard last

    def step(self, now_ns: int) -> None:
        """Tell what came."""
        for at_ns, full, payload in self._stream.drain():
            self._server.tell(full, at_ns + self._epoch_ns, payload)
            for told in self._drawn.update(full, payload, at_ns):
                self._server.tell(*told)
            if full == self._state:
                self.state_ns = at_ns
        self._server.welcome(now_ns + self._epoch_ns)

    @property
    def subscriptions(self) -> int:
        """How many there were, of all viewers."""
        return self._server.subscriptions

    def rest(self) -> None:
        """Tell what is left at the end of a run."""
        for told in self._drawn.rest():
            self._server.tell(*told)

    def close(self) -> None:
        """Leave every viewer."""
        self._server.close()


def _certificate(config: Config, at: Address) -> Keys | None:
    if not at.secured:
        return None
    own = credentials(config.arena.name, PAGE)
    return Keys(own.certificate.read_bytes(), own.key.read_bytes())


def _layout(config: Config, folder: Path, key: str) -> Path:
    """Write the layout of a run, for this user alone: whoever has it may drive."""
    file = folder / LAYOUT
    with replaced(file) as stream:
        os.fchmod(stream.fileno(), 0o600)
        stream.write(layouts.layout(Recording(config), SERVICES if key else (), {"key": key}))
    return file
