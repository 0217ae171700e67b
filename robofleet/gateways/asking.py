"""What an operator asks of a run in real time through another world's services."""

from collections.abc import Callable
from concurrent.futures import Future

from robofleet.operator import asking
from robofleet.operator.asking import ESTOP, Outcome

SERVICES = "hold", "resume", "stop", "reset"
Ask = Callable[[str], "Future[Outcome]"]


class Asking(asking.Asking):
    """Asks by the names of services: ``stop`` is the emergency stop."""

    def __call__(self, what: str) -> "Future[Outcome]":
        return super().__call__(ESTOP if what == "stop" else what)
