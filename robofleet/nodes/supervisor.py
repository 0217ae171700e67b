"""The supervisor: it owns the run's state and says every 40 ms to every driver whether its wheels may move."""

from collections.abc import Callable
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.bus import Bus, Request, Wake
from robofleet.bus.keys import BUSY, ENABLE, REQUEST, SAFE_REQUEST, STATE
from robofleet.bus.messages import (
    BUSY_MACHINE,
    RUN_STATE,
    UNIT_ENABLE,
    UNIT_STATUS,
    BusyMachine,
    Late,
    LinkState,
    RunState,
    UnitEnable,
)
from robofleet.bus.requests import SAFE, SAFE_WORDS
from robofleet.bus.statuses import URGENT_PERIOD_NS
from robofleet.config import groups, obstacles, slices
from robofleet.config.tree import Config
from robofleet.core.clock import MS, Clock, S
from robofleet.core.compiling import Say, told
from robofleet.core.kernels import kernel
from robofleet.nodes import fleet_view
from robofleet.nodes.camera_reports import stale_ticks
from robofleet.nodes.fleet_view import FleetListener
from robofleet.nodes.handing import Handing
from robofleet.nodes.rescues import Words
from robofleet.safety import arming, busy, monitor, rescue
from robofleet.safety.advice import WAY_OUT
from robofleet.safety.arming import ArmingSettings, ArmingState, Stage
from robofleet.safety.latches import Latch
from robofleet.safety.monitor import MonitorSettings, MonitorState
from robofleet.safety.requests import acknowledged, latched, refusal
from robofleet.safety.rescue import Rescue
from robofleet.safety.supervisor import CAUSES, MOVING, NOBODY, Event, Happening, Phase, RunStatus, describe
from robofleet.safety.view import NEVER, FleetView, Machine, RobotView
from robofleet.safety.wiggle import STROKES, probe_speeds
from robofleet.vehicles import solids

_PERIOD_NS = 40 * MS
_EVERY_OTHER = 2  # status of a robot on a radio, which comes every 33 ms, is answered
_RADIO_NS = 80 * MS  # where none comes
_DRILL = int(Latch.DRILL)
_ACKNOWLEDGED_WITHIN_NS = 200 * MS
_MOST_REQUESTS = 16  # of a step and a kind: a flood of them does not keep it from publishing
_CLEARED_WITHIN_NS = 500 * MS  # some enables and statuses; a latch that is still there was made anew

_REQUESTS = {
    b"arm": Event.ARM_REQUESTED,
    b"start": Event.START_REQUESTED,
    b"stop": Event.STOP_REQUESTED,
    b"hold": Event.HOLD_REQUESTED,
    b"resume": Event.RESUME_REQUESTED,
    b"estop": Event.ESTOP_REQUESTED,
    b"reset": Event.RESET,
    b"park": Event.PARK_REQUESTED,
}


class Supervisor:
    """Requests of the operator and what is seen of the fleet drive one transition table.

    ``free_bytes`` returns the room left where the run is recorded, ``machine`` how busy the computer is at an instant,
    ``attended`` asks for signs of the operator's life, and ``say`` is given a line for each change of the run and for
    each robot that is stopped. A disk or a reader that takes no line delays no stop: what a step decides is published
    before anything is said or answered.
    """

    def __init__(
        self,
        config: Config,
        bus: Bus,
        clock: Clock,
        wake: Wake,
        rng: np.random.Generator,
        *,
        free_bytes: Callable[[], int],
        attended: bool,
        say: Callable[[str], None],
        machine: Callable[[int], Machine | None] = lambda _: None,
    ) -> None:
        robots, driven = config.bodies, len(config.members)
        drives = [slices.drive(robot) for robot in robots]
        radii = tuple(robot.vehicle.body_radius_m for robot in robots)
        wheels, bases = tuple(d.wheel_radius for d in drives), tuple(d.wheel_base for d in drives)
        speeds = tuple(drive.max_speed for drive in drives)
        build, arena, every = slices.build(config), config.arena.size_m, obstacles.every(config.arena)
        self._epoch = slices.drawn_id(rng, 32)
        self._ids = config.ids
        probing = [[max(map(abs, probe_speeds(k, d.wheel_radius))) for d in drives] for k in range(len(STROKES))]
        # Nobody lets a bystander's wheels turn; the emergency stop latches its gate as everybody's.
        fastest = [robot.vehicle.max_wheel_speed_rad_s * (row < driven) for row, robot in enumerate(robots)]
        self._limits, self._probing = np.array(fastest, dtype=np.float64), np.array(probing)  # by stroke and robot
        daemons = frozenset(config.daemons)
        elsewhere = frozenset(row for row, robot in enumerate(robots) if config.unit_of[robot.id] in daemons)
        self._monitoring = MonitorSettings(
            build=build, body_radius=radii, wheel_radius=wheels, wheel_base=bases, arena=arena, max_speed=speeds,
            attended=attended, elsewhere=elsewhere, floors=tuple(solid for solid in every if solid.floor),
            stale_ticks=stale_ticks(config),
        )  # fmt: skip
        self._arming = ArmingSettings(build, wheels, bases, radii, arena, every, groups.jam_of(config))
        self._say = say
        self._lines: list[str] = []  # of this step
        self._replies: list[tuple[Request, str]] = []
        self._listener = FleetListener(config, bus, wake, free_bytes, machine)
        units = self._listener.statuses.units
        self._handing = Handing(config, bus, self._listener.statuses)
        self._enables = [bus.publisher(ENABLE, unit.name) for unit in units]
        self._enabled_ns, self._passed_over, self._echoed = ([NEVER] * len(units) for _ in range(3))
        self._items = [np.zeros(unit.size, UNIT_ENABLE.item_dtype) for unit in units]
        self._places = [np.arange(unit.size)[unit.places] for unit in units]
        self._driven = driven
        self._publish_state = bus.publisher(STATE)
        self._orders = bus.serve(REQUEST, "supervisor", wake)
        self._safe_requests = bus.serve(SAFE_REQUEST, "supervisor", wake)
        self._status = RunStatus()
        self._view = FleetView(clock.now_ns(), tuple(RobotView(driven=row < driven) for row in range(len(robots))))
        self._memory = MonitorState()
        self._instead = {Event.PROVED: Event.SET_OUT} if config.run.begin == "go_to_start" else {}
        self._instead |= {Event.ACCOMPLISHED: Event.OFF_TO_PARK} if config.run.end == "park" else {}
        self._simulated, self._phases = config.simulated, groups.phases(config)
        self._busy = busy.BusyState()
        self._busy_news = BusyNews(self._epoch, self._ids)
        self._publish_busy = bus.publisher(BUSY)
        self._standing: tuple[Happening, ...] = ()  # of the newest view
        self._checks: ArmingState | None = None  # while ARMED
        self._start = False  # is asked for, while ARMED
        self._states = np.zeros(len(robots), RUN_STATE.item_dtype)  # as published last
        self._permitted = np.zeros(len(robots))  # fastest wheel [rad/s]
        self._operator_ns = NEVER
        self._naming_ns: int | None = None  # when who has not answered the emergency stop will be named
        self._clear = np.zeros(len(robots), np.uint64)  # latches that a reset clears, by their ids; 0: none
        self._resets: list[Request] = []  # that wait for the gates to be clear
        self._resets_end_ns = 0  # when they have waited long enough
        self._words, self._rescue = Words(config, bus), Rescue()
        self._next_ns, self._seq, self._enable_seq = clock.now_ns(), 0, 0

    def step(self, now_ns: int) -> int:
        """Listen, decide, and publish when due or when something changed.

        In between, robots whose link is bad are told again what was decided, with their newest nonce, and robots on a
        radio as soon as their status comes: their permissions are as fresh as can be, and none is said twice.
        """
        requests, statuses = self._requests(), self._listener.statuses
        urgent_units = statuses.urgent_units
        between = self._next_ns - _PERIOD_NS <= now_ns < self._next_ns
        if (urgent_units or statuses.by_radio) and between and not requests:
            self._listener.hear_robots(now_ns)
            for unit in (*urgent_units, *filter(self._waits, self._listener.newer)):
                self._enable(unit, now_ns)
            return self._wakes_ns(now_ns)
        self._lines += [f"{unit}: {why}" for unit, why in self._handing.step(now_ns)]
        before = (self._status, self._checks, self._states.tobytes(), self._clear.tobytes())
        self._view, out = self._listener.look(now_ns, self._operator_ns), self._view.cameras_out
        self._name_cameras(out)
        self._memory, self._standing = monitor.watch(
            self._memory, self._monitoring, self._status.phase, self._view, proved=self._proved
        )
        self._busy = busy.watch(self._busy, self._status.phase, self._view)
        for happening in self._standing:
            self._happen(happening)
        for request in requests:
            self._serve(request)
        self._arm()
        self._go_on()
        self._finish_resets()
        self._look_at_rescue()
        self._judge_robots()
        after = (self._status, self._checks, self._states.tobytes(), self._clear.tobytes())
        if now_ns >= self._next_ns or after != before:
            self._tell_busy()
            self._publish(now_ns, anew=after != before)
        for unit in filter(self._waits, self._listener.newer):
            self._enable(unit, now_ns)
        self._speak()
        if not now_ns < self._next_ns <= now_ns + _PERIOD_NS:
            self._next_ns += _PERIOD_NS * (1 + (now_ns - self._next_ns) // _PERIOD_NS)
        return self._wakes_ns(now_ns)

    def _name_cameras(self, before: tuple[Happening, ...]) -> None:
        """Say which of several cameras gives no poses any more, and which does again."""
        if self._view.cameras_out == before or self._status.phase not in MOVING:
            return
        were, are = (
            {int(happening.detail): happening.event for happening in out} for out in (before, self._view.cameras_out)
        )
        for camera in sorted(were.keys() ^ are.keys()):
            name = f"camera {self._ids.cameras[camera]}"
            back = f"{name} gives poses again"
            why = CAUSES[are[camera]] if camera in are else ""
            self._lines.append(f"{name}: {why}; robots that only it sees stand, the others drive" if why else back)

    def _requests(self) -> list[Request]:
        """Take what was asked since the last step; what makes nothing move comes last, so no order undoes it."""
        orders, safe = ([*islice(iter(take, None), _MOST_REQUESTS)] for take in (self._orders, self._safe_requests))
        for request in safe:
            if request.payload not in SAFE:
                self._replies.append((request, f"refused: only {SAFE_WORDS} are for everybody: ask as an operator"))
        known = [request for request in (*orders, *safe) if request.payload in SAFE]
        return [*(request for request in orders if request.payload not in SAFE), *known]

    def _speak(self) -> None:
        """Answer and say what this step left."""
        replies, self._replies = self._replies, []
        lines, self._lines = self._lines, []
        for request, answer in replies:
            request.reply(answer.encode())
        for line in lines:
            self._say(line)

    def _wakes_ns(self, now_ns: int) -> int:
        urgent = self._listener.statuses.urgent_units
        return min(self._next_ns, now_ns + URGENT_PERIOD_NS) if urgent else self._next_ns

    def close(self) -> None:
        """Nothing to bring to rest: the gates close when enables cease."""

    def _happen(self, happening: Happening) -> None:
        happening = happening._replace(event=self._instead.get(happening.event, happening.event))
        before, then, now_ns = self._status, self._busy, self._view.now_ns
        self._busy, self._status = busy.step(then, before, happening, now_ns, simulated=self._simulated)
        if self._status.phase is Phase.ARMED is before.phase and self._busy.checks_ns != then.checks_ns:
            self._check_again(happening, repeated=self._busy.attempts > then.attempts)
        if self._status.phase is not before.phase:
            self._busy_news.stopped(self._busy, self._status, now_ns)
            self._lines.append(f"{before.phase.name} -> {self._status.phase.name}: {self._status.describe(self._ids)}")
            self._checks, self._start = None, False
            self._naming_ns = None
            if self._status.phase is Phase.ESTOP:
                self._naming_ns = self._view.now_ns + _ACKNOWLEDGED_WITHIN_NS

    def _check_again(self, happening: Happening, *, repeated: bool) -> None:
        """Begin the checks before a start anew: a busy machine has spoilt them."""
        self._checks = arming.begin(self._view.now_ns)
        self._memory = self._memory._replace(since_ns=self._view.now_ns)
        if repeated:
            self._lines.append(f"the checks begin anew, this machine is busy: {describe(happening, self._ids)}")

    def _go_on(self) -> None:
        """Resume a run that nothing but a busy machine holds."""
        self._busy, happening = busy.go_on(self._busy, self._status, self._view, self._standing)
        if happening is not None:
            self._happen(happening)

    def _tell_busy(self) -> None:
        news = self._busy_news.due(self._busy, self._view)
        if news is not None:
            self._publish_busy(BUSY_MACHINE.encode(news))
            self._lines += self._busy_news.line(self._busy, news)

    @property
    def _proved(self) -> bool:
        """Whether the fleet waits for its start."""
        return self._checks is not None and self._checks.stage is Stage.DONE

    def _arm(self) -> None:
        """Go on with the checks before a start."""
        if self._status.phase is Phase.ARMED:
            checks = self._checks or arming.begin(self._view.now_ns)
            self._checks, happening = arming.step(checks, self._arming, self._view, self._start)
            if happening is not None:
                self._happen(happening)

    def _serve(self, request: Request) -> None:
        """Do what an operator asks for, or say why not."""
        answer: str | None = "ok"
        if request.payload == b"status":
            answer = f"ok: {self._describe()}"
        elif request.payload == b"attended":
            self._operator_ns = self._view.now_ns
        elif (event := _REQUESTS.get(request.payload)) is None:
            known = ", ".join(name.decode() for name in (*_REQUESTS, b"status"))
            answer = f"refused: {request.payload!r} is not one of {known}"
        elif (why := self._refusal(event)) is not None:
            answer = f"refused: {why}"
        elif event is Event.RESET:
            self._reset(request)
            answer = None  # when the gates have followed
        else:
            self._happen(Happening(event))
            if event in (Event.ARM_REQUESTED, Event.START_REQUESTED):
                self._operator_ns = self._view.now_ns
                self._start = self._start or event is Event.START_REQUESTED
        if answer is not None:
            self._replies.append((request, answer))

    def _refusal(self, event: Event) -> str | None:
        if event is Event.PARK_REQUESTED and Phase.PARKING not in self._phases:
            return "not every robot has a place to park: write robots[].park into the configuration"
        unready = arming.unready(self._arming, self._view) if self._proved else None
        return refusal(event, self._status, self._standing, self._view, self._ids, unready)

    def _reset(self, request: Request) -> None:
        """Clear every latch that is there now; the answer waits until the gates say so."""
        self._clear = np.array([seen.latch_id if seen.latch else 0 for seen in self._view.robots], np.uint64)
        if not self._resets:
            self._resets_end_ns = self._view.now_ns + _CLEARED_WITHIN_NS
        self._resets.append(request)
        self._happen(Happening(Event.RESET))

    def _finish_resets(self) -> None:
        if not self._resets:
            return
        phase, held = self._status.phase, latched(self._view, self._ids)
        if phase is Phase.IDLE and held and self._view.now_ns < self._resets_end_ns:
            return
        answer = f"refused: {', '.join(held)}: the gate stays latched: look at the robot, then reset" if held else "ok"
        for request in self._resets:
            self._replies.append((request, answer if phase is Phase.IDLE else f"refused: {WAY_OUT[phase]}"))
        self._resets, self._clear = [], np.zeros(len(self._ids), np.uint64)

    def _describe(self) -> str:
        """Return where the run is, what led there, and what holds whom, in a line."""
        parts = [f"{self._status.phase.name}: {self._status.describe(self._ids)}"]
        parts += ["every check is passed: start it, or stop"] * self._proved
        parts += dict.fromkeys(describe(happening, self._ids) for happening in self._standing)
        if unanswered := self._unanswered():
            parts.append(f"not acknowledged by {', '.join(unanswered)}")
        return "; ".join(parts)

    def _unanswered(self) -> list[str]:
        """Return who has not acknowledged the emergency stop."""
        if self._status.phase is not Phase.ESTOP:
            return []
        known = self._states["acknowledged"].tolist()
        return [robot for robot, acknowledges in zip(self._ids, known, strict=True) if not acknowledges]

    def _look_at_rescue(self) -> None:
        """See whom a person drives out of a held run; say when that begins and ends."""
        before = self._rescue
        self._rescue = rescue.watch(before, self._words.new(), self._status, self._standing, self._view)
        if self._rescue.robot != before.robot:
            if before.robot != NOBODY:
                self._lines.append(f"{self._ids[before.robot]}: it is driven out no more")
            if self._rescue.robot != NOBODY:
                self._lines.append(describe(Happening(self._rescue.request, self._rescue.robot), self._ids))

    def _judge_robots(self) -> None:
        """Find out who may move; say who must stand, and who keeps its gate open in an emergency stop."""
        causes: dict[int, Happening] = {}
        for happening in self._standing:
            causes.setdefault(happening.robot, happening)
        before, states = self._states, np.zeros(len(self._ids), RUN_STATE.item_dtype)
        if self._checks is not None:
            states["stroke"] = [self._checks.stroke(row) for row in range(len(self._ids))]
        self._permitted = self._fastest(states["stroke"])
        for row, happening in causes.items():
            if row < len(states):
                self._permitted[row], states["cause"][row] = 0.0, happening.event
        if (out := self._rescue.robot) != NOBODY:  # in a HOLD, in which all others have no permission
            self._permitted[out] = self._words.crawls[out]
            states["cause"][out] = self._rescue.request
        states["permitted"] = self._permitted > 0.0
        if self._status.phase is Phase.ESTOP:
            states["acknowledged"] = [acknowledged(seen) for seen in self._view.robots]
        self._states = states
        if causes and self._status.phase in MOVING:
            new = (states["cause"] != before["cause"]) & (states["cause"] != Event.NOTHING)
            self._lines += [f"stands: {describe(causes[row], self._ids)}" for row in np.flatnonzero(new).tolist()]
        if self._naming_ns is not None and self._view.now_ns >= self._naming_ns:
            self._naming_ns = None
            if unanswered := self._unanswered():
                self._lines.append(f"the emergency stop is not acknowledged by {', '.join(unanswered)}")

    def _fastest(self, strokes: NDArray[Any]) -> NDArray[np.float64]:
        """Return the fastest wheel of each robot, if nothing is wrong with it [rad/s]; ``strokes``: that it must do."""
        if self._status.phase in MOVING:
            return self._limits.copy()
        if self._checks is None:
            return np.zeros(len(self._limits))
        return np.asarray(np.minimum(self._probing[strokes, np.arange(len(strokes))], self._limits))

    def _publish(self, now_ns: int, *, anew: bool) -> None:
        """Say where the run is, and to each unit what it may; ``anew``: that has changed."""
        self._seq += 1
        phase, cause, robot, detail, _ = self._status
        checks = self._checks or ArmingState()
        state = RunState(
            self._epoch,
            self._seq,
            phase,
            cause,
            robot,
            detail,
            checks.stage,
            (),
        )
        self._publish_state(RUN_STATE.encode_view(state, self._states))
        by_radio = self._listener.statuses.by_radio
        for unit in range(len(self._enables)):
            if anew or unit not in by_radio or now_ns - self._enabled_ns[unit] >= _RADIO_NS:
                self._enable(unit, now_ns)

    def _waits(self, unit: int) -> bool:
        """Whether a unit on a radio, of which a status has just come, is to be told what it may."""
        statuses = self._listener.statuses
        status = statuses.newest[unit]
        if status is None or unit not in statuses.by_radio or status.nonce == self._echoed[unit]:
            return False
        self._passed_over[unit] += 1
        urgent = status.hurry != LinkState.GOOD or self._status.phase is Phase.ESTOP
        return urgent or self._passed_over[unit] >= _EVERY_OTHER

    def _enable(self, unit: int, now_ns: int) -> None:
        """Say to a unit which of its robots may move, and which gates must close or may be cleared."""
        statuses, phase, checks = self._listener.statuses, self._status.phase, self._checks
        status, part = statuses.newest[unit], statuses.units[unit]
        if status is None:
            return
        self._enable_seq += 1
        self._enabled_ns[unit], self._passed_over[unit], self._echoed[unit] = now_ns, 0, status.nonce
        drill = int(Latch.NONE if checks is None else checks.latch)
        latch = int(Latch.EMERGENCY_STOP if phase is Phase.ESTOP else Latch.NONE)
        _fill_enables(
            self._items[unit], statuses.robots, part.numbers, self._places[unit], self._permitted, self._clear,
            self._driven, latch, drill, checks is None or checks.clear,
        )  # fmt: skip
        head = UnitEnable(self._enable_seq, status.boot_id, status.nonce, phase, ())
        self._enables[unit](UNIT_ENABLE.encode_view(head, self._items[unit]))


@kernel
def _fill_enables(  # type: ignore[no-untyped-def]
    enables, statuses, rows, places, permitted, clear, driven, latch, drill, clearing
):
    """Write each robot's permission; a drill's latch is cleared without a reset: it was no incident."""
    for k in range(len(rows)):
        row, enable = rows[k], enables[places[k]]
        seen = statuses[row]
        enable.epoch, enable.limit_rad_s = seen.epoch, permitted[row]
        enable.latch = latch if latch or row >= driven else drill
        enable.clear = seen.latch_id if clearing and seen.latch == _DRILL else clear[row]


KERNELS = (_fill_enables, *fleet_view.KERNELS, *monitor.KERNELS, *solids.KERNELS)


def compile_kernels(say: Say) -> None:
    """Compile every kernel, or load it from the cache; ``say`` is told how far it is."""
    with told(KERNELS, say):
        fleet_view.compile_kernels()
        monitor.compile_kernels()
        solids.rehearse()
        none, rows_of = np.zeros(0, np.intp), np.zeros(1, UNIT_STATUS.item_dtype)
        _fill_enables(
            np.zeros(0, UNIT_ENABLE.item_dtype), rows_of, none, none, np.zeros(1), np.zeros(1, np.uint64), 0, 0, 0, True
        )


_NEWS_PERIOD_NS = S
_STOPPED_NEWS_PERIOD_NS = S // 5  # a machine that is busy loses messages, and somebody waits for this one
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
        if view.machine is None or view.now_ns < self._due_ns or not memory.worst:
            return None
        self._due_ns = view.now_ns + (_STOPPED_NEWS_PERIOD_NS if self._cause else _NEWS_PERIOD_NS)
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
