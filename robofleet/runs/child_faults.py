"""Timed faults of a real run's processes: they are killed and started again, stopped and continued."""

import signal

from robofleet.config.tree import Config
from robofleet.core.clock import Clock
from robofleet.runs.children import Children
from robofleet.simulation.faults import Schedule


class ChildFaults:
    """Does to the children what the configuration's faults ask for. Its times count from ``begin``."""

    def __init__(self, config: Config, clock: Clock, children: Children) -> None:
        self._clock, self._children = clock, children
        self._schedule = Schedule(config, clock)
        self._acting: set[int] = set()  # by number

    def begin(self) -> None:
        """Note that the fleet is running; only the first time counts."""
        self._schedule.begin(self._clock.now_ns())

    def step(self) -> None:
        """Let begin and end what is due."""
        now_ns = self._clock.now_ns()
        for injection in self._schedule.of("killed", "stopped"):
            acts = injection.acts(now_ns)
            if acts == (injection.number in self._acting):
                continue
            self._acting ^= {injection.number}
            name = injection.fault.process
            if injection.fault.kind == "stopped":
                self._children.signal(name, signal.SIGSTOP if acts else signal.SIGCONT)
            elif acts:
                self._children.kill(name)
            else:
                self._children.start_again(name)
