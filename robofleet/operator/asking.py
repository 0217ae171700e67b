"""What an operator asks of a run in real time: requests to its supervisor, and the emergency stop."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial

from robofleet.bus.bus import Bus
from robofleet.bus.permissions import OPERATOR
from robofleet.bus.requests import asked
from robofleet.core.clock import Clock
from robofleet.operator.estop import SUPERVISOR, Units, emergency_stop

ESTOP = "estop"
Outcome = tuple[bool, str]  # whether it is done, and what was answered


def ask_supervisor(bus: Bus, clock: Clock, what: str, role: str = OPERATOR) -> Outcome:
    """Ask the supervisor and wait for its answer; TimeoutError where none comes."""
    answer = asked(bus, clock, SUPERVISOR, what.encode(), role=role).decode(errors="replace")
    return answer.startswith("ok"), answer


class Asking:
    """Asks in threads: an answer may take two seconds. The emergency stop has threads of its own."""

    def __init__(self, bus: Bus, clock: Clock, units: Units, role: str = OPERATOR, at_once: int = 1) -> None:
        """``role``: in which this program is on the bus; ``at_once``: requests that wait for their answers. Of one at a
        time each arrives after those before it: a hold never overtakes a resume."""
        self._bus, self._clock, self._units, self._role = bus, clock, units, role
        self._threads = ThreadPoolExecutor(at_once, "ask")
        self._urgent = ThreadPoolExecutor(4, "estop")

    def __call__(self, what: str) -> "Future[Outcome]":
        """Ask; the emergency stop (``ESTOP``) also tells every gate itself."""
        if what == ESTOP:
            return self._urgent.submit(_answered, self._stop)
        return self._threads.submit(_answered, partial(ask_supervisor, self._bus, self._clock, what, self._role))

    def _stop(self) -> Outcome:
        stopped = emergency_stop(self._bus, self._clock, self._units)
        return not stopped.silent, stopped.describe()

    def close(self) -> None:
        """End the threads; start no more requests."""
        for threads in (self._threads, self._urgent):
            threads.shutdown(wait=False, cancel_futures=True)


def _answered(ask: Callable[[], Outcome]) -> Outcome:
    """Return the outcome, also of an exception."""
    try:
        return ask()
    except Exception as error:  # noqa: BLE001 - of the bus, too
        return False, str(error)
