"""The recorder: everything that is said in an arena, in one file. Nobody waits for it."""

from collections.abc import Callable

import numpy as np

from robofleet.bus.bus import Bus
from robofleet.bus.keys import RECORDER, split
from robofleet.bus.messages import RECORDER_STATUS, RecorderStatus
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.core.clock import MS
from robofleet.recording.channels import keys
from robofleet.recording.log import RunLog

_QUEUE_MESSAGES = 65536  # half a minute of a fleet of four, three seconds of a hundred robots
_PERIOD_NS = 40 * MS  # with the log's own flush a quarter of a second
_REPORT_NS = 250 * MS


class Recorder:
    """Keeps what comes in what ``log`` opens, and says how that goes.

    ``ending`` returns what the launcher said in the end.
    """

    def __init__(
        self, config: Config, bus: Bus, rng: np.random.Generator, log: Callable[[], RunLog], ending: Callable[[], bytes]
    ) -> None:
        self._stream = bus.stream(*keys(config), capacity=_QUEUE_MESSAGES)
        self._log, self._ending = log(), ending  # it may compile kernels: what others say meanwhile waits in the stream
        self._publish = bus.publisher(RECORDER)
        self._epoch = slices.drawn_id(rng, 32)
        self._seq = self._missed = 0
        self._failed = False
        self._say_ns = 0

    def step(self, now_ns: int) -> int:
        self._keep()
        self._log.flush(now_ns)
        failed = self._log.failed is not None
        if now_ns >= self._say_ns or failed != self._failed:
            self._failed, self._say_ns = failed, now_ns + _REPORT_NS
            self._seq += 1
            status = RecorderStatus(self._epoch, self._seq, self._log.messages, self._log.dropped, int(self._failed))
            self._publish(RECORDER_STATUS.encode(status))
        return now_ns + _PERIOD_NS

    def close(self) -> None:
        """Keep what is left, and end the file."""
        self._keep()
        self._log.end(self._ending())

    def _keep(self) -> None:
        add = self._log.add
        for at_ns, full, payload in self._stream.drain():
            add(split(full)[0], payload, at_ns)
        if (missed := self._stream.dropped) > self._missed:
            self._log.drop(missed - self._missed)
            self._missed = missed
