"""A driver process: the robots of one unit, each behind its gate. It owns the gates; the drivers know no bus."""

from robofleet.bus import sensors
from robofleet.bus.bus import Bus, Inbox, Publish, Request, Wake
from robofleet.bus.keys import COMMAND, ENABLE, LEASE, SENSORS, STATUS, TRUTH
from robofleet.bus.messages import (
    LEASE_REQUEST,
    UNIT_COMMAND,
    UNIT_ENABLE,
    UNIT_LEASES,
    UNIT_STATUS,
    UNIT_TRUTH,
    UnitLeases,
    UnitStatus,
    UnitTruth,
)  # fmt: skip
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.core.clock import MS, Clock
from robofleet.nodes.unit.drivers import Drivers, behind_gates
from robofleet.nodes.unit.gated_robot import Probe, UnitMessage
from robofleet.nodes.unit.state_store import StateStore
from robofleet.nodes.unit.status_scheduling import ByCable, ByRadio
from robofleet.safety.gate import LeaseAction

LOOP_NS = 10 * MS
_ACTIONS = tuple(LeaseAction)


class DriverProcess:
    """The robots of one unit: a 100 Hz loop that also wakes for a message and for a gate's deadline."""

    def __init__(
        self, config: Config, unit: str, bus: Bus, clock: Clock, wake: Wake, boot_id: int, phase_ns: int,
        state_store: StateStore, drivers: Drivers, probe: Probe | None = None,
    ) -> None:  # fmt: skip
        """Open every robot; DriverError where one does not answer.

        ``boot_id``: 64 bits that nobody has had before; ``phase_ns``: of the loop, so that those of several processes
        are not in phase.
        """
        self._clock, self.build = clock, slices.build(config)
        self._newest_ns = clock.now_ns()
        self._sensing_ns = slices.sensing_period_ns(config, unit)
        self._robots = behind_gates(drivers, config, config.units[unit], boot_id, state_store, probe, self._now)
        try:
            self._join(unit, bus, wake)
        except BaseException:
            self.close()
            raise
        self._refused = 0  # messages and requests that nobody could read
        self._seq = 0
        self._loop_ns = clock.now_ns() + phase_ns
        self._scheduling = ByRadio() if unit in config.daemons else ByCable()
        self._truth_is_due = False
        self._sense_ns, self._sensed = self._loop_ns, 0

    def _join(self, unit: str, bus: Bus, wake: Wake) -> None:
        self._commands = Inbox(bus.newest(COMMAND, unit, wake), UNIT_COMMAND.arrays)
        self._enables = Inbox(bus.newest(ENABLE, unit, wake), UNIT_ENABLE.arrays)
        self._requests = bus.serve(LEASE, unit, wake)
        self._publish_status = bus.publisher(STATUS, unit)
        self._publish_sensors: Publish | None = None if self._sensing_ns is None else bus.publisher(SENSORS, unit)
        self._publish_truth: Publish | None = None if self._robots.truths() is None else bus.publisher(TRUTH, unit)

    def step(self, now_ns: int) -> int:
        """Pass on what arrived; every 10 ms read, then publish. Wheels go first, then latches, disk, bus, log."""
        due = not self._loop_ns - LOOP_NS <= now_ns < self._loop_ns  # also when the clock was set back
        if due:
            self._loop_ns += LOOP_NS * (1 + (now_ns - self._loop_ns) // LOOP_NS)
            self._truth_is_due = not self._truth_is_due
        robots, scheduling = self._robots, self._scheduling
        command, enable = self._whole(self._commands.take()), self._whole(self._enables.take())
        robots.pass_on(self._now(), command, enable, due=due)
        if command is not None:
            scheduling.heard(self._newest_ns)
        if robots.latch_is_new:
            self._tell()  # before the disk, and before anything is said in the log
        if (request := self._requests()) is not None:
            self._answer(request)
        robots.keep(due=due)
        if due and self._truth_is_due:
            self._tell_truth()
        if scheduling.due(now_ns, robots, loop=due):
            self._tell()
        if due:
            if self._publish_sensors is not None and self._sensing_ns is not None:
                self._tell_sensors(now_ns, self._sensing_ns, self._publish_sensors)
            robots.say()
        return min(self._loop_ns, robots.deadline_ns, scheduling.next_ns)

    @property
    def any_open(self) -> bool:
        return self._robots.any_open

    def close(self) -> None:
        self._robots.close()

    def _now(self) -> int:
        """Return the instant: no gate decides by an old one, and none goes on when the clock was set back."""
        now_ns, before_ns = self._clock.now_ns(), self._newest_ns
        self._newest_ns = now_ns
        if now_ns < before_ns:
            self._robots.set_back(before_ns, now_ns)
        return now_ns

    def _whole(self, command: UnitMessage | None) -> UnitMessage | None:
        """Return a message that says something to every robot of the unit, and to no other one."""
        if command is None or len(command[1]) == len(self._robots):
            return command
        self._refused += 1
        return None

    def _answer(self, request: Request) -> None:
        lease_request = LEASE_REQUEST.decode(request.payload)
        if lease_request is None or lease_request.action not in _ACTIONS:
            self._refused += 1
            return
        answers = self._robots.lease(lease_request.session, LeaseAction(lease_request.action), self._now())
        request.reply(UNIT_LEASES.encode(UnitLeases(answers)))

    def _tell_truth(self) -> None:
        if self._publish_truth is not None and (truths := self._robots.truths()) is not None:
            self._seq += 1
            self._publish_truth(UNIT_TRUTH.encode_view(UnitTruth(self._seq, self._now(), ()), truths))

    def _tell_sensors(self, now_ns: int, period_ns: int, publish: Publish) -> None:
        """Publish what the robots' sensors say, if it is time to."""
        if not self._sense_ns - period_ns <= now_ns < self._sense_ns:  # also when the clock was set back
            self._sense_ns += period_ns * (1 + (now_ns - self._sense_ns) // period_ns)
            self._sensed += 1
            publish(sensors.encoded(self._sensed, self._now(), self._robots.sensors()))

    def _tell(self) -> None:
        robots, now_ns = self._robots, self._now()
        self._seq += 1
        refused = self._refused + self._commands.rejected + self._enables.rejected
        head = UnitStatus(self._seq, self.build, robots.boot_id, now_ns, now_ns, self._scheduling.hurry, ())
        self._publish_status(UNIT_STATUS.encode_view(head, robots.statuses(now_ns, refused)))
        self._scheduling.told(now_ns)
