"""What an operator asks of a run in real time through another world's services."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial

from robofleet.clock import Clock
from robofleet.comms.bus import Bus
from robofleet.comms.requests import asked
from robofleet.config.tree import Config
from robofleet.processes.estop import emergency_stop

SERVICES = "hold", "resume", "stop", "reset"
Asked = tuple[bool, str]  # whether it is done, and what was answered
Ask = Callable[[str], "Future[Asked]"]


class Asking:
    """Asks in a thread of its own: an answer may take two seconds."""

    def __init__(self, bus: Bus, clock: Clock, config: Config) -> None:
        self._bus, self._clock, self._config = bus, clock, config
        self._thread = ThreadPoolExecutor(1, "robofleet-asking")

    def __call__(self, what: str) -> "Future[Asked]":
        """Ask; the emergency stop tells every gate itself, too."""
        return self._thread.submit(self._stop if what == "stop" else partial(self._ask, what))

    def _ask(self, what: str) -> Asked:
        try:
            answer = asked(self._bus, self._clock, "supervisor", what.encode()).decode(errors="replace")
        except TimeoutError as error:
            return False, str(error)
        return answer.startswith("ok"), answer

    def _stop(self) -> Asked:
        stopped = emergency_stop(self._bus, self._clock, self._config.units)
        return not stopped.silent, stopped.describe()

    def close(self) -> None:
        """End the thread."""
        self._thread.shutdown(wait=False, cancel_futures=True)
