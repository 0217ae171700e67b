"""The twins' process: every twin of a run behind its port, and the truth about each."""

import sys
from functools import partial

from robofleet.bus.bus import Bus
from robofleet.bus.keys import STATE, TRUTH
from robofleet.bus.messages import UNIT_TRUTH, Truth, UnitTruth
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.core.clock import MS, Clock, S
from robofleet.nodes.node import LineWaker
from robofleet.nodes.unit import driver_settings
from robofleet.simulation.faults import Schedule
from robofleet.simulation.twin import Twin
from robofleet.vehicles.readings import TruePose

_TRUTH_NS = round(TRUTH.period_s * S)


class Twins:
    """Steps each twin when its driver has written, or something of its own is due."""

    def __init__(self, config: Config, bus: Bus, clock: Clock, waker: LineWaker, faults: Schedule | None) -> None:
        now_ns = clock.now_ns()
        self._waker, self._faults = waker, faults
        self._state = bus.newest(STATE)  # what the faults' times count from is said there
        self._twins: dict[str, Twin] = {}
        plant = slices.shared_plant(config, [robot.id for robot in config.twins], now_ns)
        try:
            for robot in config.twins:
                port, others = driver_settings.port_of_twin(config, robot), partial(self._others, robot.id)
                self._twins[robot.id] = Twin(config, robot.id, port, now_ns, faults, others, plant)
        except BaseException:
            self.close()
            raise
        self._publish = {unit: bus.publisher(TRUTH, unit) for unit in {config.unit_of[robot] for robot in self._twins}}
        self._units = config.units
        self._truth_ns, self._seq = now_ns, 0

    def step(self, now_ns: int) -> int:
        """Let every twin's time pass; every 10 ms publish where they are."""
        self._state.take()
        next_ns = min(twin.step(now_ns) for twin in self._twins.values())
        if now_ns >= self._truth_ns:
            self._truth_ns += _TRUTH_NS * (1 + (now_ns - self._truth_ns) // _TRUTH_NS)
            self._seq += 1
            for unit, publish in self._publish.items():
                places = [(index, robot) for index, robot in enumerate(self._units[unit]) if robot in self._twins]
                truths = tuple(Truth(index, *self._twins[robot].truth()) for index, robot in places)
                publish(UNIT_TRUTH.encode(UnitTruth(self._seq, now_ns, truths)))
        self._waker.descriptors = [twin.descriptor for twin in self._twins.values() if twin.descriptor is not None]
        return min(next_ns, self._truth_ns)

    def _others(self, robot: str) -> list[tuple[TruePose, float]]:
        """Return where the other twins are, and their bodies' radii."""
        return [(twin.truth(), twin.radius) for other, twin in self._twins.items() if other != robot]

    def close(self) -> None:
        """Take the ports away; say what the robots did that nobody had asked for. Idempotent."""
        struck = () if self._faults is None else self._faults.of("line_cut", "line_garbage", "line_late")
        if struck and self._twins:
            print(f"{sum(injection.effects for injection in struck)} lines were struck", file=sys.stderr)
        for robot, twin in self._twins.items():
            twin.close()
            if (ledger := twin.ledger) is not None:
                print(
                    f"{robot}: {ledger.wrong} wrong motions, at most {ledger.furthest:.3f} rad/s from what was asked "
                    f"and {ledger.longest_ns / MS:.0f} ms long",
                    file=sys.stderr,
                )
        self._twins = {}
