"""A machine that is too busy for its run: which processes were late, and what a simulated fleet does then. Pure.

Evidence is asked for. A process was late by the machine's load only if, for at least half of the time in which it was
not heard, some process of this machine was ready to run and no core was free for it. And it must have tried: who
neither waited for a core for half of that time nor ran again and again hangs, or somebody stopped it.

Where everything is simulated, nobody is in danger while the fleet stands. So it stands as always, and where load alone
made it stand it goes on by itself as soon as everybody is heard, seen and at rest again. What ends a run of real robots
(a process that is silent for half a second) is a hold there, as long as that process comes back. Checks before a start
that load has spoilt are begun anew. Whatever else stops a fleet is not touched, and an operator's hold stays one.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from robofleet.safety import supervisor
from robofleet.safety.arming import missing
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import MOVING, TRANSITIONS, Event, Happening, Phase, RunStatus
from robofleet.safety.view import NEVER, FleetView, Turns

_MS = 1_000_000
_S = 1000 * _MS

SUPERVISOR, CONTROLLER, TRACKER, DRIVERS = range(4)  # rows of processes; then each robot's driver has one
_PERIOD_NS = 40 * _MS  # between two looks of the supervisor; all others are heard more often
LATE_NS = 60 * _MS  # what a gate's 120 ms leave beside the age of a nonce in health
TURN_NS = 50 * _MS  # all loop more often: who works is given a turn in each
EXPLAINS_NS = _S  # lateness explains what happens within this time
GONE_NS = 10 * _S  # a process that was not heard for so long does not come back
FRESH_NS = 300 * _MS  # nine images in which all is well
FIRST_WAIT_NS, LONGEST_WAIT_NS = 500 * _MS, 8 * _S  # before it goes on; doubled by every time in the last minute
_MINUTE_NS = 60 * _S
ATTEMPTS = 5  # of the checks before a start, beside the first one
_SAID = 3  # processes that are named

CAUSED = frozenset({  # what lateness can do to a fleet that drives
    Event.SUPERVISOR_STALLED, Event.DRIVER_SILENT, Event.CONTROLLER_SILENT, Event.TICKS_OVERRUN, Event.TRACKER_SILENT,
    Event.CAMERA_STALLED, Event.POSES_SILENT, Event.BEHAVIOUR_LATE,
})  # fmt: skip
SPOILT = CAUSED | {  # and to its checks: images too old, commands too late, a stroke that lasted too long
    Event.TAG_LOST, Event.LEASE_LOST, Event.GATE_LATCHED, Event.NOT_AT_REST, Event.ESTOP_UNANSWERED,
    Event.DID_NOT_MOVE, Event.WRONG_GAIN, Event.ARMED_TOO_LONG,
}  # fmt: skip
_ACTIVE = Phase.ARMED, Phase.HOLD, *MOVING
_PASSING = CAUSED | {Event.TAG_LATE, Event.TAG_LOST}  # what a fleet that waits for its processes waits for, too


class Lateness(NamedTuple):
    """Who was late, and by how much."""

    process: int  # SUPERVISOR, CONTROLLER, TRACKER, or DRIVERS and the robot's number
    late_ns: int


class BusyState(NamedTuple):
    """What one view does not tell. Instants on the supervisor's clock [ns]."""

    last_heard: tuple[tuple[int, int], ...] = ()  # every process: when it was heard last, and the contention by then
    turns: tuple[Turns | None, ...] = ()  # of every process by then; none where nobody counts them
    unexplained: frozenset[int] = frozenset()  # processes that are late now, but not by load
    late_ns: tuple[int, ...] = ()  # the most that each was late by load so far
    recent: tuple[Lateness, ...] = ()  # who was late by load in the newest view in which anybody was
    recent_ns: int = NEVER  # and when that was
    held_ns: int = NEVER  # since when the run is held by nothing but load; NEVER: it is not
    fresh_ns: int = NEVER  # since when everybody is heard, seen and at rest then
    goes_on_ns: tuple[int, ...] = ()  # when the run went on by itself, in the last minute
    resumed: int = 0  # how often it did
    checks_ns: int = NEVER  # when the checks before a start began, or began anew
    attempts: int = 0  # how often they did

    @property
    def worst(self) -> tuple[Lateness, ...]:
        """The most that each process was late by load, the latest first."""
        return latest(Lateness(row, ns) for row, ns in enumerate(self.late_ns) if ns)


def watch(memory: BusyState, phase: Phase, view: FleetView) -> BusyState:
    """Return what the newest view adds: who is late, and whether load explains it.

    Before the checks begin and after the end of a run nobody is late: processes start and stop then.
    """
    if view.machine is None:
        return memory
    now_ns, contended_ns = view.now_ns, view.machine.contended_ns
    heard_ns = (now_ns, view.controller_ns, view.tracker_ns, *(robot.heard_ns for robot in view.robots))
    before = memory.last_heard or ((NEVER, contended_ns),) * len(heard_ns)
    own_ns = now_ns - before[SUPERVISOR][0]
    turns = view.machine.turns
    turns_then = memory.turns if len(memory.turns) == len(turns) else turns
    late, unexplained = [], []
    for row, (since_ns, contended_then_ns) in enumerate(before):
        gap_ns = now_ns - since_ns
        # who is not looked for is not late: the supervisor's own lateness is nobody else's
        late_ns = gap_ns - (_PERIOD_NS if row == SUPERVISOR else max(_PERIOD_NS, own_ns))
        if since_ns == NEVER or late_ns < LATE_NS:
            continue
        tried = not turns or tries(turns_then[row], turns[row], gap_ns)
        if tried and 2 * (contended_ns - contended_then_ns) >= gap_ns:
            late.append(Lateness(row, late_ns))
        else:
            unexplained.append(row)
    came = [at_ns != then[0] for at_ns, then in zip(heard_ns, before, strict=True)]
    memory = memory._replace(
        last_heard=tuple(
            (at_ns, contended_ns) if new else then for at_ns, then, new in zip(heard_ns, before, came, strict=True)
        ),
        turns=tuple(now if new else then for now, then, new in zip(turns, turns_then, came, strict=False)),
        unexplained=frozenset(unexplained),
    )
    if not late or phase not in _ACTIVE:
        return memory
    most = dict(enumerate(memory.late_ns or (0,) * len(heard_ns)))
    most |= {row: max(most[row], ns) for row, ns in late}
    return memory._replace(late_ns=tuple(most.values()), recent=latest(late), recent_ns=now_ns)


def tries(then: Turns | None, now: Turns | None, lasts_ns: int) -> bool:
    """Return whether a process that was not heard for so long worked, or waited for a core; also if nobody knows it."""
    if then is None or now is None:
        return True
    return 2 * (now.waited_ns - then.waited_ns) >= lasts_ns or TURN_NS * (now.taken - then.taken) >= lasts_ns


def explains(memory: BusyState, event: int, robot: int, now_ns: int, causes: frozenset[Event] = CAUSED) -> bool:
    """Return whether a cause is one that lateness can make, and somebody was late by load just now.

    Where it is one process's silence, that one must not be late by anything else.
    """
    lately = memory.recent_ns != NEVER and now_ns - memory.recent_ns <= EXPLAINS_NS
    return event in causes and lately and _process(event, robot) not in memory.unexplained


def step(
    memory: BusyState, status: RunStatus, happening: Happening, now_ns: int, *, simulated: bool
) -> tuple[BusyState, RunStatus]:
    """Return the run's status after an event; ``simulated``: nothing of the run exists outside this computer.

    An event that spoilt checks leaves the fleet ARMED, and ``attempts`` or ``checks_ns`` say that they begin anew.
    """
    after = supervisor.step(status, happening)
    if not simulated:
        return memory, after
    changes = after is not status
    if status.phase is Phase.ARMED and changes and _spoilt(memory, happening, now_ns):
        apart_ns = now_ns - memory.checks_ns  # what lasts begins them anew at every look, and counts once
        return memory._replace(checks_ns=now_ns, attempts=memory.attempts + (apart_ns >= _S)), status
    if status.phase in (Phase.HOLD, *MOVING) and changes and after.phase in (Phase.HOLD, Phase.FAULT):
        comes_back = explains(memory, happening.event, happening.robot, now_ns) and not _gone(memory, happening, now_ns)
        if comes_back and status.phase is Phase.HOLD:
            return memory, status
        if comes_back:
            return memory._replace(held_ns=now_ns, fresh_ns=NEVER), RunStatus(Phase.HOLD, *happening, status.phase)
    if status.phase is Phase.HOLD and not changes and _stops(happening.event):
        return memory._replace(held_ns=NEVER), after  # an operator, or something that somebody has to look at
    if after.phase is not status.phase:
        attempts = 0 if after.phase is Phase.ARMED else memory.attempts
        memory = memory._replace(held_ns=NEVER, checks_ns=now_ns, attempts=attempts)
    return memory, after


def go_on(
    memory: BusyState, status: RunStatus, view: FleetView, standing: Iterable[Happening]
) -> tuple[BusyState, Happening | None]:
    """Return Event.CAUGHT_UP where a run that is held by load alone goes on; ``standing``: what the monitor tells."""
    if status.phase is not Phase.HOLD or memory.held_ns == NEVER:
        return memory, None
    now_ns = view.now_ns
    well = missing(view) is None and not any((Phase.RUNNING, happening.event) in TRANSITIONS for happening in standing)
    memory = memory._replace(fresh_ns=(memory.fresh_ns or now_ns) if well else NEVER)
    lately = tuple(at_ns for at_ns in memory.goes_on_ns if now_ns - at_ns < _MINUTE_NS)
    wait_ns = min(LONGEST_WAIT_NS, FIRST_WAIT_NS << len(lately))
    if not well or now_ns - memory.fresh_ns < FRESH_NS or now_ns - memory.held_ns < wait_ns:
        return memory, None
    return memory._replace(goes_on_ns=(*lately, now_ns), resumed=memory.resumed + 1), Happening(Event.CAUGHT_UP)


def words(late: Sequence[Lateness], load: float, cores: int, robots: Sequence[str]) -> str:
    """Return how busy a machine is, and who was late by how much; ``robots`` are the ids in their order."""
    processes: dict[tuple[int, int], list[int]] = {}  # a driver of several robots is one: it is late by the same time
    for row, ns in late:
        processes.setdefault((min(row, DRIVERS), ns), []).append(row)
    sentences = [f"load {load:.1f} on {cores} core{'s' * (cores != 1)}"]
    sentences += [
        f"{name(rows, robots)} was late by {ns / _MS:.0f} ms" for (_, ns), rows in [*processes.items()][:_SAID]
    ]
    return ", ".join(sentences)


def name(rows: Sequence[int], robots: Sequence[str]) -> str:
    """Return what a process is called; a driver has a row for each of its robots."""
    if rows[0] >= DRIVERS:
        known = [robots[row - DRIVERS] for row in rows if row - DRIVERS < len(robots)]
        more = f" and {len(known) - _SAID} more" if len(known) > _SAID + 1 else ""
        return f"the driver of {', '.join(known[:_SAID] if more else known)}{more}" if known else "another driver"
    return ("the supervisor", "the controller", "the tracker")[rows[0]]


def latest(late: Iterable[Lateness]) -> tuple[Lateness, ...]:
    """Return them in the order of their lateness, the latest first."""
    return tuple(sorted(late, key=lambda robot: -robot.late_ns))


def _spoilt(memory: BusyState, happening: Happening, now_ns: int) -> bool:
    """Return whether load explains why the checks failed: somebody was late by it since they began."""
    event, robot, detail = happening
    drill = event is not Event.GATE_LATCHED or detail <= Latch.DRILL  # a graver latch is no matter of time
    together = memory.recent_ns == memory.checks_ns == now_ns  # another one in the look that began them anew
    late = together or (memory.recent_ns > memory.checks_ns and memory.attempts < ATTEMPTS)
    hangs = _process(event, robot) in memory.unexplained
    return event in SPOILT and drill and late and not hangs and not _gone(memory, happening, now_ns)


_PROCESSES: dict[int, int] = {
    Event.SUPERVISOR_STALLED: SUPERVISOR,
    Event.CONTROLLER_SILENT: CONTROLLER,
    Event.TRACKER_SILENT: TRACKER,
    Event.CAMERA_STALLED: TRACKER,
    Event.POSES_SILENT: TRACKER,
}


def _process(event: int, robot: int) -> int | None:
    """Return the process whose silence an event tells of; None where it tells of something else."""
    return DRIVERS + robot if event == Event.DRIVER_SILENT else _PROCESSES.get(event)


def _gone(memory: BusyState, happening: Happening, now_ns: int) -> bool:
    """Return whether the process that an event tells of was not heard for so long that nobody waits for it."""
    row = _process(happening.event, happening.robot)
    if row is None or row >= len(memory.last_heard):
        return False
    heard_ns = memory.last_heard[row][0]
    return heard_ns != NEVER and now_ns - heard_ns > GONE_NS


def _stops(event: Event) -> bool:
    """Return whether an event would stop a run that drives, and lateness is not what makes it."""
    return (Phase.RUNNING, event) in TRANSITIONS and event not in _PASSING
