"""A process beside a run: it hears what the recorder hears, and shows viewers what the recorder writes."""

import os
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

from robofleet.bus.bus import Stream
from robofleet.bus.keys import STATE, split
from robofleet.bus.keys import key as key_of
from robofleet.bus.messages import RUN_STATE
from robofleet.bus.permissions import VIEWER
from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.core.clock import MS, WallClock, epoch_ns
from robofleet.core.refusal import RefusedError
from robofleet.gateways.asking import Asking
from robofleet.gateways.place import ArenaAccess, Served, is_over, joined_bus
from robofleet.gateways.viewers.server import Run, Server
from robofleet.nodes.node import Lifeline
from robofleet.operator.viewer_address import RERUN, Address
from robofleet.recording.channels import Channel, keys, of_key
from robofleet.recording.scenes.drawn import Drawn

_NICE = 5  # viewers wait for the run, never the other way round
_JOIN_WITHIN_S = 60.0  # the router is the first process of a run
_QUEUE_MESSAGES = 65536
_PERIOD_NS = 40 * MS
_BATCH_TICKS = 15  # of a robot at once: half a second


def serve(
    viewer: str,
    config: Config,
    access: ArenaAccess,
    at: Address,
    folder: Path,
    lifeline: Lifeline,
    within_s: float = _JOIN_WITHIN_S,
) -> None:
    """Serve a run until it ends, or until the lifeline is cut.

    TimeoutError where its bus does not answer, RefusedError where the address cannot be used. ``folder``: for a layout.
    """
    os.nice(_NICE)
    clock = WallClock()

    def look() -> None:
        if lifeline.cut:
            raise SystemExit

    bus = joined_bus(config, access, VIEWER, clock, within_s, look)
    run = Run(config, access, folder, Asking(bus, clock, config.units, access.role))

    def opened(channels: Sequence[Channel]) -> Server:
        try:
            return _opening(viewer)(run, at, channels)
        except OSError as error:
            raise RefusedError(f"{at}: {error}: name another HOST:PORT") from error

    served = Served(lambda: is_over(config, access), clock.now_ns())
    try:
        stream = bus.stream(*keys(config), capacity=_QUEUE_MESSAGES)
        with closing(Viewers(config, stream, served, opened, epoch_ns())) as viewers:
            lifeline.ready(viewers.address)
            while not lifeline.cut and not served.is_over(now_ns := clock.now_ns()):
                viewers.step(now_ns)
                clock.sleep_until(now_ns + _PERIOD_NS)
            viewers.rest(clock.now_ns())
    finally:
        run.ask.close()
        bus.close()


def _opening(viewer: str) -> Callable[[Run, Address, Sequence[Channel]], Server]:
    """Return what opens a viewer's server; its library is loaded by that."""
    if viewer == RERUN:
        from robofleet.gateways.viewers.rerun import server as of_rerun  # noqa: PLC0415

        return of_rerun.opened
    from robofleet.gateways.viewers.foxglove import server as of_foxglove  # noqa: PLC0415

    return of_foxglove.opened


class Viewers:
    """Tells viewers what the bus says, and what is drawn of it."""

    def __init__(
        self, config: Config, stream: Stream, served: Served, opened: Callable[[Sequence[Channel]], Server],
        epoch_ns: int,
    ) -> None:  # fmt: skip
        """Take all that is said, what opens a server of channels, and what makes its instants dates."""
        self._stream, self._served, self._epoch_ns = stream, served, epoch_ns
        self._drawn = Drawn(config, groups.descriptions(config), epoch_ns=epoch_ns, batch=_BATCH_TICKS)
        self._server = opened([*map(of_key, keys(config)), *self._drawn.channels])
        self.address = self._server.address
        self._state = key_of(config.arena.name, STATE)

    def step(self, now_ns: int) -> None:
        for at_ns, full_of_sender, payload in self._stream.drain():
            full, _ = split(full_of_sender)
            if full == self._state and (epoch := RUN_STATE.head_of(payload, "epoch")):
                self._served.take(epoch, at_ns)
                if self._served.is_over(at_ns):
                    return  # what comes now is another run's
            self._server.tell(full, at_ns + self._epoch_ns, payload)
            for message in self._drawn.update(full, payload, at_ns):
                self._server.tell(*message)
        self._server.step(now_ns + self._epoch_ns)

    def rest(self, now_ns: int) -> None:
        """Pass on the last messages of a run."""
        for message in self._drawn.rest():
            self._server.tell(*message)
        self._server.step(now_ns + self._epoch_ns)

    def close(self) -> None:
        self._server.close()
