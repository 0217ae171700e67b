"""A run in lockstep as a process beside it hears it, and the recording of what it heard."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TypeVar

from robofleet.bus.bus import Arrival
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.gateways.place import Served
from robofleet.gateways.viewers.live import Viewers
from robofleet.gateways.viewers.server import Server
from robofleet.recording.channels import Channel, keys
from robofleet.recording.log import RunLog
from robofleet.runs.lockstep import Lockstep

EPOCH_NS = 1_790_000_000 * 10**9
AnyServer = TypeVar("AnyServer", bound=Server)


class Overheard:
    """A run, and the stream of what it says to recorder and viewers."""

    dropped = 0

    def __init__(self, config: Config) -> None:
        self.config, self.run = config, Lockstep(config)
        self._arrivals: list[Arrival] = []
        self._taken, self._keys = 0, set(keys(config))
        self.run.bus.tap(self._hear)

    def _hear(self, message: tuple[str, bytes]) -> None:
        if message[0] in self._keys:
            self._arrivals.append(Arrival(self.now_ns, *message))

    @property
    def now_ns(self) -> int:
        """The run's time."""
        return self.run.clock.now_ns()

    def drain(self) -> list[Arrival]:
        """Return all that was said since the last call."""
        new = self._arrivals[self._taken :]
        self._taken = len(self._arrivals)
        return new

    @contextmanager
    def shown(self, open_server: Callable[[Sequence[Channel]], AnyServer]) -> Iterator[tuple[Viewers, AnyServer]]:
        """Give a server of viewers, and what tells it of this run."""
        servers: list[AnyServer] = []

        def opened(channels: Sequence[Channel]) -> Server:
            servers.append(open_server(channels))
            return servers[0]

        with closing(Viewers(self.config, self, Served(lambda: False, 0), opened, EPOCH_NS)) as viewers:
            yield viewers, servers[0]

    def played(self, viewers: Viewers, file: Path) -> Path:
        """Run to the end, tell it to viewers, and return the recording of all that was said."""
        assert self.run.run() == ("completed", None)
        viewers.step(self.now_ns)
        viewers.rest(self.now_ns + S)  # when what waits for company is due
        with RunLog(file, self.config, epoch_ns=EPOCH_NS) as log:
            for at_ns, full, payload in self._arrivals:
                log.add(full, payload, at_ns)
        return file
