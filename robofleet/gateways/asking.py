"""What an operator asks of a run in real time through another world's services."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial

from robofleet.bus.bus import Bus
from robofleet.bus.permissions import OPERATOR
from robofleet.bus.requests import asked
from robofleet.config.tree import Config
from robofleet.core.clock import Clock
from robofleet.operator.estop import emergency_stop

SERVICES = "hold", "resume", "stop", "reset"
Outcome = tuple[bool, str]  # whether it is done, and what was answered
Ask = Callable[[str], "Future[Outcome]"]


class Asking:
    """Asks in threads: an answer may take two seconds. The emergency stop has its own thread."""

    def __init__(self, bus: Bus, clock: Clock, config: Config, role: str = OPERATOR) -> None:
        """``role``: in which this gateway is on the bus."""
        self._bus, self._clock, self._config, self._role = bus, clock, config, role
        self._thread = ThreadPoolExecutor(1, "robofleet-asking")
        self._urgent = ThreadPoolExecutor(1, "robofleet-stopping")

    def __call__(self, what: str) -> "Future[Outcome]":
        """Ask; the emergency stop tells every gate itself, too."""
        if what == "stop":
            return self._urgent.submit(_answered, self._stop)
        return self._thread.submit(_answered, partial(self._ask, what))

    def _ask(self, what: str) -> Outcome:
        answer = asked(self._bus, self._clock, "supervisor", what.encode(), role=self._role).decode(errors="replace")
        return answer.startswith("ok"), answer

    def _stop(self) -> Outcome:
        stopped = emergency_stop(self._bus, self._clock, self._config.units)
        return not stopped.silent, stopped.describe()

    def close(self) -> None:
        """End the threads."""
        for thread in (self._thread, self._urgent):
            thread.shutdown(wait=False, cancel_futures=True)


def _answered(ask: Callable[[], Outcome]) -> Outcome:
    """Return the outcome, also of an exception."""
    try:
        return ask()
    except Exception as error:  # noqa: BLE001 - of the bus, too
        return False, str(error)
