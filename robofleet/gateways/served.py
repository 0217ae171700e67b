"""Whether the run goes on that a gateway serves. The arena's next run may be on the same bus: it is another one."""

from collections.abc import Callable

from robofleet.core.clock import S

_SILENT_NS = 3 * S  # of the supervisor: then it is asked whether there is a run


class Served:
    """The run whose supervisor is heard first."""

    def __init__(self, ended: Callable[[], bool], now_ns: int) -> None:
        """``ended`` tells of a silent run whether it has ended."""
        self._ended, self._heard_ns = ended, now_ns
        self._epoch, self._newest = 0, 0  # of supervisors; 0: none was heard

    def take(self, epoch: int, now_ns: int) -> None:
        """Take the epoch of a supervisor that has spoken."""
        self._newest = epoch
        self._epoch, self._heard_ns = self._epoch or self._newest, now_ns

    def is_over(self, now_ns: int) -> bool:
        """Return whether another run has begun, or this one has ended."""
        return self._newest != self._epoch or (now_ns - self._heard_ns > _SILENT_NS and self._ended())
