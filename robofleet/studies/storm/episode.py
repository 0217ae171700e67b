"""One seed of a storm: a fleet starts, faults act and end, and the fleet must run again; then everything is judged."""

import gc
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, redirect_stderr
from typing import NamedTuple

import numpy as np

from robofleet.bus.bus import Answer
from robofleet.bus.keys import REQUEST, STATE, TRUTH, key
from robofleet.config import barrier, obstacles, slices
from robofleet.config.slices import generator
from robofleet.config.tree import Config
from robofleet.config.troubles import InjectedFault
from robofleet.core.clock import S
from robofleet.core.log_lines import Unfailing
from robofleet.operator.estop import EmergencyStop
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.distances import least_room_m
from robofleet.safety.supervisor import Event, Phase
from robofleet.simulation.faults import Injection
from robofleet.simulation.faulty_disk import FaultyLog
from robofleet.studies.storm.bodies import apart, at_goals, rolling_on, unheld, unnamed
from robofleet.studies.storm.fleet import States, moved_unasked, unanswered, without_cause
from robofleet.studies.storm.forger import forge
from robofleet.studies.storm.gates import GateAudit
from robofleet.studies.storm.ledger import Ledger, Span, Violation
from robofleet.studies.storm.schedule import Plan, plan, shared
from robofleet.studies.storm.setpoints import Senders
from robofleet.studies.storm.stops import going_on, out_of_reach, stops, unlatched
from robofleet.vehicles.solids import distances

_ARMED_WITHIN_S = 60.0  # without faults it takes far less
_AGAIN_S, _SLOWER = 5.0, 2.0  # after healing, beside what the checks took at first: they are slower on the spot
_STAY_S, _LONG_STAY_S, _LONG = 0.3, 6.0, 4  # how long it goes on then, in most seeds, and in one of so many
_MOST_QUEUED = 5000  # a link that is cut for four seconds holds back three thousand
_STOP_POLL_S = 0.002
_OPERATOR_POLL_S = 0.05
_WAITING_S, _PAUSE_S = 30.0, 0.1  # of a robot that lets others by, and of all of them together
_SETTLE_S = 0.5  # what was under way when the last fault ended may still arrive
_NEXT = {Phase.IDLE: b"start", Phase.HOLD: b"resume", Phase.FAULT: b"reset", Phase.ESTOP: b"reset"}


class Episode(NamedTuple):
    """What one seed left."""

    seed: int
    plan: Plan
    trace_hash: str
    violations: tuple[Violation, ...]
    events: frozenset[Event]
    injected: Counter[str]  # effects by kind of fault
    simulated_s: float
    run_s: float  # when the fleet ran first, on lockstep's clock
    longest_queue: int
    crowded: bool  # robots met outside the envelope: somebody has to carry them apart before they run again


def play(config: Config, seed: int) -> Episode:
    """Play a seed; the same seed gives the same episode."""
    config, storm = shared(config, seed), plan(config, seed)
    run, robots = config.run.model_copy(update={"seed": seed}), (*config.robots, *storm.parked)
    tree = config.model_copy(update={"run": run, "faults": storm.faults, "robots": robots})
    gc.disable()  # as a lockstep run does: nothing is cyclic but what ends with the episode
    try:
        player = _Player(tree, storm)
        with player.log():
            episode = player.play()
        player.forget()
        return episode
    finally:
        gc.enable()


class _Player:
    def __init__(self, config: Config, storm: Plan) -> None:
        self._config, self._plan = config, storm
        self._ledger = Ledger()
        self._lockstep = Lockstep(config, self._ledger.probe)
        assert self._lockstep.faults is not None
        self._faults = self._lockstep.faults
        self._ledger.follow(self._lockstep.clock, self._lockstep.bus)
        self._senders = Senders(config, self._lockstep.bus)
        self._found: list[Violation] = []
        self._longest_queue = 0
        self._stops_ns: list[int] = []
        self._answer: Answer | None = None
        self._answer_text = b""  # by the supervisor, to the newest request
        self._crowded = False
        self._rng = generator(config.run.seed, "operator")

    def log(self) -> AbstractContextManager[object]:
        """Have everybody's log lines go where theirs go in a run: to the disk that may be full."""
        return redirect_stderr(Unfailing(FaultyLog(self._faults)))

    def play(self) -> Episode:
        lockstep, storm = self._lockstep, self._plan
        started_ns = lockstep.clock.now_ns()
        self._ask(b"start")
        if not lockstep.advance(_ARMED_WITHIN_S, lambda: lockstep.status.phase is Phase.RUNNING):
            self._fail("the fleet never ran", str(lockstep.status))
        run_ns = lockstep.clock.now_ns()
        for at_s, request in self._restless():
            lockstep.advance(max(0.0, run_ns / S + at_s - lockstep.clock.now_ns() / S))  # a stop takes its time
            if request is None:
                self._look()
                forge(lockstep.bus, lockstep.recording, self._losing, self._rng)
            elif request == b"estop":
                self._stop()
            else:
                self._ask(request)
        lockstep.advance(max(0.0, run_ns / S + storm.healed_s + _SETTLE_S - lockstep.clock.now_ns() / S))
        self._senders.calm()
        self._again(_AGAIN_S + _SLOWER * (run_ns - started_ns) / S)
        lockstep.close()
        self._judge(run_ns)
        return Episode(
            self._config.run.seed, storm, lockstep.recording.trace_hash or "", tuple(self._found),
            frozenset(self._states.events()), self._injected(), (lockstep.clock.now_ns() - started_ns) / S,
            run_ns / S, self._longest_queue, self._crowded,
        )  # fmt: skip

    def forget(self) -> None:
        """Let go of the hundred thousand messages at once: the garbage collector need not look at them."""
        self._lockstep.recording.messages.clear()
        self._ledger.forget()

    def _restless(self) -> Iterator[tuple[float, bytes | None]]:
        """Yield what is asked and when; None: whatever brings a fleet that stands back to running."""
        acts = [(act.at_s, act.request) for act in self._plan.acts]
        looks = np.cumsum(self._rng.uniform(0.3, 1.5, math.ceil(self._plan.healed_s / 0.3)))
        yield from sorted([*acts, *((t, None) for t in looks.tolist() if t < self._plan.healed_s)], key=lambda a: a[0])

    def _again(self, within_s: float) -> None:
        """Bring the fleet back to running, and see every robot's wheels turn, or its robot where it is to be.

        A robot whose gate lets commands through may wait longer, as long as others drive: a plan gives them the way.
        """
        lockstep = self._lockstep
        end_s = lockstep.clock.now_ns() / S + within_s
        last_s = end_s + _WAITING_S
        stay_s = _STAY_S if self._config.run.seed % _LONG else _LONG_STAY_S
        turned: set[str] = set()
        members = {robot.id for robot in self._config.members}
        while lockstep.clock.now_ns() / S < end_s:
            self._look()
            everybody = turned >= members
            lockstep.advance(stay_s if everybody else _OPERATOR_POLL_S)
            if everybody and Event.ACCOMPLISHED is lockstep.status.cause:
                return
            if lockstep.status.phase is not Phase.RUNNING:
                turned.clear()
            elif everybody:
                return
            turning, obeying = self._ledger.turning(), self._ledger.obeying()
            turned |= turning | (obeying & at_goals(self._config, self._true_poses()))
            if turning and obeying >= members and lockstep.status.phase is Phase.RUNNING:
                end_s = min(last_s, max(end_s, lockstep.clock.now_ns() / S + _PAUSE_S))
        self._crowded = self._plan.outside_s < math.inf and self._no_room()
        if not self._crowded:
            words = lockstep.status.describe(self._config.ids)
            numbers = f"{lockstep.status.phase.name}: {words}; answer {self._answer_text!r}; turned: {sorted(turned)}"
            self._fail("it does not run again within 5 s", numbers)

    def _no_room(self) -> bool:
        """Whether a robot has no room to be tried on the spot, by arming's own distances and the poses' error."""
        config, poses = self._config, self._true_poses()
        known = [robot for robot in config.bodies if robot.id in poses]
        at = np.array([poses[robot.id][:2] for robot in known])
        radii = np.array([robot.vehicle.body_radius_m for robot in known])
        gaps = np.hypot(*(at[:, None] - at[None]).transpose(2, 0, 1)) - radii[:, None] - radii[None]
        np.fill_diagonal(gaps, np.inf)
        walls = (np.array(config.arena.size_m) / 2 - np.abs(at)).min(axis=1) - radii
        solids = distances(obstacles.every(config.arena), at) - radii
        free, members = np.vstack([gaps, walls, solids]).min(axis=0), {robot.id for robot in config.members}
        error_m = barrier.keepout(config).pose_error
        return any(
            left < least_room_m(slices.drive(robot).wheel_radius) + error_m
            for robot, left in zip(known, free.tolist(), strict=True)
            if robot.id in members
        )

    def _true_poses(self) -> dict[str, tuple[float, float, float]]:
        return {
            name: (truth.x_m, truth.y_m, truth.psi_rad)
            for unit, names in self._config.units.items()
            if (truths := self._lockstep.recording.newest(TRUTH, unit)) is not None
            for name, truth in zip(names, truths.robots, strict=True)
        }

    def _look(self) -> None:
        """Do what an operator does who wants the fleet to run."""
        self._longest_queue = max(self._longest_queue, self._lockstep.backlog)
        self._answer_text = (self._answer and self._answer.take()) or self._answer_text
        request = _NEXT.get(self._lockstep.status.phase)
        if request == b"start" and self._answer_text.startswith(b"refused"):
            request = b"reset"
        if request is not None:
            self._ask(request)

    def _ask(self, request: bytes) -> None:
        self._answer_text, self._answer = b"", self._lockstep.request(request)

    def _stop(self) -> None:
        clock = self._lockstep.clock
        self._stops_ns.append(clock.now_ns())
        stop = EmergencyStop(self._lockstep.bus, self._config.units, clock.now_ns())
        while stop.step(clock.now_ns()) is None:
            self._lockstep.advance(_STOP_POLL_S)

    def _losing(self, topic: str) -> bool:
        """Whether messages of a topic may be lost now, or were a moment ago."""
        now_ns = self._lockstep.clock.now_ns()
        return any(
            injection.start_ns <= now_ns <= injection.end_ns + S
            and (injection.fault.kind == "network_cut" or topic in getattr(injection.fault, "topics", ()))
            for injection in self._faults.injections
        )

    def _fail(self, invariant: str, numbers: str) -> None:
        self._found.append(Violation(invariant, self._lockstep.clock.now_ns() / S, "", numbers))

    def _judge(self, run_ns: int) -> None:
        config, recording, ledger = self._config, self._lockstep.recording, self._ledger
        arena = config.arena.name
        state_key, request_key = key(arena, STATE), key(arena, REQUEST, "supervisor")
        self._states = States.of(ledger.sent_ns[state_key], recording.messages[state_key], len(config.bodies))
        resets = [
            ns for ns, payload in zip(ledger.sent_ns[request_key], recording.messages[request_key], strict=True)
            if payload == b"reset"
        ]  # fmt: skip
        truths, sent_ns = [], []
        requested_stops = stops(self._stops_ns, resets)
        unheard: list[Span] = []
        for row, robot in enumerate(config.bodies):
            truths.append(recording.of_robot(TRUTH, robot.id))
            unit_sent_ns = np.array(ledger.sent_ns[key(arena, TRUTH, config.unit_of[robot.id])], dtype=np.float64)
            sent_ns.append(unit_sent_ns[truths[-1]["message"]])
            outages = self._outages(config.driver_of(robot.id))
            audit = GateAudit(robot.id, slices.drive(robot), lambda ns: any(t <= ns for t in resets), outages)
            self._found += audit.violations(ledger.decisions[robot.id])
            unreached = out_of_reach(self._faults, robot.id)
            unheard += unreached
            self._found += unlatched(robot.id, ledger.decisions[robot.id], requested_stops, unreached)
            runaways = self._faults.of("motor_runs", robot=robot.id)
            if row < len(config.members):  # a hand moves bystanders
                self._found += rolling_on(robot, audit.standing, sent_ns[-1], truths[-1], _spans(runaways))
            stuck = self._acting("motor_stuck", robot=robot.id)
            self._found += unnamed(robot.id, ledger.decisions[robot.id], runaways, outages + stuck)
            unseen = outages + unreached + self._outages("supervisor")
            self._found += unheld(robot.id, ledger.decisions[robot.id], stuck, unseen)
            self._found += moved_unasked(self._states, row, robot.id, audit.moving)
        self._found += apart(config, sent_ns, truths, run_ns + self._plan.outside_s * S)
        if self._longest_queue > _MOST_QUEUED:
            self._fail("a queue grows without bound", f"{self._longest_queue} steps")
        self._found += going_on(self._states, requested_stops, self._outages("supervisor"), unheard)
        self._found += without_cause(self._states, config.ids[: len(config.members)])
        self._found += unanswered(self._states, len(config.members), self._of_the_fleet(), run_ns)

    def _of_the_fleet(self) -> list[InjectedFault]:
        """Return the faults but those of bystanders, which need stop nobody."""
        parked = {robot.id for robot in self._plan.parked}
        return [fault for fault in self._plan.faults if getattr(fault, "robot", None) not in parked]

    def _injected(self) -> Counter[str]:
        effects: Counter[str] = Counter()
        for injection in self._faults.injections:
            effects[injection.fault.kind] += injection.effects
        return effects

    def _outages(self, process: str) -> list[Span]:
        return self._acting("killed", "stopped", "clock_step", process=process)

    def _acting(self, *kinds: str, **keys: str) -> list[Span]:
        return _spans(self._faults.of(*kinds, **keys))


def _spans(injections: Iterable[Injection]) -> list[Span]:
    return [Span(injection.start_ns, injection.end_ns) for injection in injections]
