"""What the supervisor tells of a busy machine: every second since somebody was late by it, and at once at a stop."""

from robofleet.bus.messages import BusyMachine, Late
from robofleet.core.clock import S
from robofleet.safety import busy
from robofleet.safety.supervisor import Event, Phase, RunStatus
from robofleet.safety.view import NEVER, FleetView

_PERIOD_NS = S
_STOPPED_PERIOD_NS = S // 5  # a machine that is busy loses messages, and somebody waits for this one
_STOPPED = Phase.HOLD, Phase.FAULT


class BusyNews:
    """Makes the messages, and the one line of the log."""

    def __init__(self, epoch: int, robots: tuple[str, ...]) -> None:
        self._epoch, self._robots = epoch, robots
        self._seq = 0
        self._cause = Event.NOTHING  # that load explains, while it stands
        self._late: dict[int, int] = {}  # by process, when that cause came [ns]
        self._due_ns = 0
        self._reported = False

    def stopped(self, memory: busy.BusyState, status: RunStatus, now_ns: int) -> None:
        """Take note of a change of the run's phase."""
        explained = status.phase in _STOPPED and busy.explains(memory, status.cause, status.robot, now_ns, busy.SPOILT)
        self._cause = status.cause if explained else Event.NOTHING
        self._late = dict(memory.recent) if explained else {}
        self._due_ns = 0

    def due(self, memory: busy.BusyState, view: FleetView) -> BusyMachine | None:
        """Return the message that is due now; None before anybody was late."""
        if not memory.worst or view.machine is None or view.now_ns < self._due_ns:
            return None
        self._due_ns = view.now_ns + (_STOPPED_PERIOD_NS if self._cause else _PERIOD_NS)
        self._seq += 1
        late = tuple(Late(row, most_ns, self._late.get(row, 0)) for row, most_ns in memory.worst)
        goes_on = int(memory.held_ns != NEVER)
        _, load, cores, _ = view.machine
        return BusyMachine(
            self._epoch, self._seq, self._cause, goes_on, memory.resumed, memory.attempts, cores, load, late
        )

    def line(self, memory: busy.BusyState, message: BusyMachine) -> list[str]:
        """Return what the log says of the first message; of the others it says nothing."""
        already, self._reported = self._reported, True
        words = busy.words(memory.worst, message.load, message.cores, self._robots)
        return [] if already else [f"this machine is busy: {words}"]
