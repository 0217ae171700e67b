"""Fault injection: when each timed fault of ``config/troubles.py`` acts, and what it does to a body and to a clock.

Nothing of this is made where a configuration has no faults. Whoever puts a process together wraps what it touches: its
bus (``faulty_bus.py``), camera and poses (``faulty_poses.py``), drivers (``faulty_driver.py``), disk
(``faulty_disk.py``). Each stands in the place of the real thing, behind the same interface: no process knows of it.
"""

import math
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from robofleet.bus.keys import ENABLE, STATE, TICK, Topic
from robofleet.bus.messages import RUN_STATE, TICK_RECORD, UNIT_ENABLE, Truth
from robofleet.config.slices import generator
from robofleet.config.tree import Config
from robofleet.config.troubles import InjectedFault
from robofleet.core.clock import Clock, S
from robofleet.safety.supervisor import Phase
from robofleet.simulation.bodies import Bodies
from robofleet.vehicles.interface import BodyTrouble, Driver, SimulatedDriver

_NEVER = math.inf
_SLIP = 0.5


class Injection:
    """One fault, from when until when it acts [ns], and how often it had an effect."""

    def __init__(self, fault: InjectedFault, number: int) -> None:
        self.fault: Any = fault  # each kind has keys of its own
        self.number = number
        self.start_ns = self.end_ns = _NEVER
        self.effects = 0

    def acts(self, now_ns: int) -> bool:
        return self.start_ns <= now_ns < self.end_ns

    def strike(self, now_ns: int) -> bool:
        """Return whether it acts now, and count it."""
        acts = self.start_ns <= now_ns < self.end_ns
        self.effects += acts
        return acts

    def start(self, from_ns: int) -> None:
        """Fix its times, from the instant that they count from."""
        fault = self.fault
        self.start_ns = from_ns + round((fault.at_s or 0.0) * S)
        self.end_ns = _NEVER if fault.duration_s is None else self.start_ns + round(fault.duration_s * S)


def struck(injections: Iterable[Injection], now_ns: int) -> bool:
    """Return whether one of them acts now, and count each that does."""
    return sum(injection.strike(now_ns) for injection in injections) > 0


class Schedule:
    """Every fault of a run. Lockstep has one for all processes; in real time each process has its own."""

    def __init__(self, config: Config, clock: Clock) -> None:
        self.now_ns = clock.now_ns  # of the world: it does not jump
        self.injections = tuple(Injection(fault, number) for number, fault in enumerate(config.faults))
        self.units = config.units
        self.begun = False
        self._seed = config.run.seed
        # Robots that outlive lockstep's processes that drove them: by name, and those of a unit that are in arrays.
        self.drivers: dict[str, Driver] = {}
        self.bodies: dict[tuple[str, ...], Bodies] = {}
        for injection in self.injections:
            if injection.fault.at_s is None:
                injection.start(clock.now_ns())

    def of(self, *kinds: str, **keys: str) -> tuple[Injection, ...]:
        """Return the injections of some kinds, of those whose keys have these values."""
        return tuple(
            injection
            for injection in self.injections
            if injection.fault.kind in kinds
            and all(getattr(injection.fault, key) == value for key, value in keys.items())
        )

    def begin(self, now_ns: int) -> None:
        """Let the run have begun; only the first time counts."""
        if not self.begun:
            self.begun = True
            for injection in self.injections:
                if injection.fault.at_s is not None:
                    injection.start(now_ns)

    def hear(self, topic: Topic, payload: bytes, now_ns: int) -> None:
        """Learn from what a process hears that the run has begun."""
        if topic is STATE and (state := RUN_STATE.decode(payload)) is not None:
            running = state.phase == Phase.RUNNING
        elif topic is ENABLE and (enable := UNIT_ENABLE.arrays(payload)) is not None:
            running = enable[0]["phase"][0] == Phase.RUNNING
        else:
            tick = TICK_RECORD.arrays(payload) if topic is TICK else None
            running = tick is not None and tick[0]["run_tick"][0] >= 0
        if running:
            self.begin(now_ns)

    def rng(self, *key: str) -> np.random.Generator:
        return generator(self._seed, "faults", *key)

    def body_trouble(self, robot: str) -> Callable[[], BodyTrouble] | None:
        """Return what tells what is wrong with a simulated robot; None if there will never be anything."""
        stuck, slip = self.of("motor_stuck", robot=robot), self.of("slip", robot=robot)
        runs, pushes = self.of("motor_runs", robot=robot), self.of("pushed", robot=robot)

        def trouble() -> BodyTrouble:
            now_ns = self.now_ns()
            by_itself = {i.fault.wheel: i.fault.speed_rad_s for i in runs if i.strike(now_ns)}
            hands = [push.fault.velocity_m_s for push in pushes if push.strike(now_ns)]
            pushed = sum(x for x, _ in hands), sum(y for _, y in hands)
            slips = _SLIP if struck(slip, now_ns) else 0.0
            return BodyTrouble(struck(stuck, now_ns), slips, **by_itself, pushed=pushed)

        return trouble if stuck or slip or runs or pushes else None

    def truths(self, unit: str) -> tuple[Truth, ...]:
        """Return where a unit's simulated robots are, whether their process lives or not."""
        robots = self.units[unit]
        if (bodies := self.bodies.get(robots)) is not None:
            return tuple(Truth(index, *row) for index, row in enumerate(bodies.truths().tolist()))
        drivers = ((index, self.drivers[robot]) for index, robot in enumerate(robots))
        return tuple(Truth(index, *driver.truth()) for index, driver in drivers if isinstance(driver, SimulatedDriver))

    def disk_is_full(self) -> bool:
        return struck(self.of("disk_full"), self.now_ns())


class SteppedClock:
    """A process's clock in lockstep, which jumps when a fault says so."""

    def __init__(self, clock: Clock, schedule: Schedule, process: str) -> None:
        self._clock = clock
        self._steps = [(i, round(i.fault.step_s * S)) for i in schedule.of("clock_step", process=process)]

    def offset_ns(self) -> int:
        """Return by how much it is ahead of the others' [ns]."""
        now_ns = self._clock.now_ns()
        return sum(step_ns for injection, step_ns in self._steps if injection.acts(now_ns))

    def now_ns(self) -> int:
        return self._clock.now_ns() + self.offset_ns()

    def sleep_until(self, instant_ns: int, *, precise: bool = False) -> None:
        self._clock.sleep_until(instant_ns - self.offset_ns(), precise=precise)
