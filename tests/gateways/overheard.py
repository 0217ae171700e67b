"""A run in lockstep as a process beside it hears it, and the recording of what it heard."""

from pathlib import Path

from mcap.reader import make_reader

from robofleet.bus.bus import Arrival
from robofleet.config.tree import Config
from robofleet.recording.channels import keys
from robofleet.recording.log import RunLog
from robofleet.runs.lockstep import Lockstep
from tests.gateways.foxglove_client import Message

EPOCH_NS = 1_790_000_000 * 10**9


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

    def recorded(self, file: Path) -> list[Message]:
        """Write the recording of all that was said, and return its messages."""
        with RunLog(file, self.config, epoch_ns=EPOCH_NS) as log:
            for at_ns, full, payload in self._arrivals:
                log.add(full, payload, at_ns)
        with file.open("rb") as stream:
            messages = make_reader(stream).iter_messages(log_time_order=False)
            return [Message(channel.topic, message.log_time, message.data) for _, channel, message in messages]
