"""A twin to test a driver with: stepped by the test, or by a thread in real time while a driver is being made."""

import select
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from robofleet.config import slices
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import Clock, WallClock
from robofleet.simulation.faults import Schedule
from robofleet.simulation.twin import Twin
from robofleet.vehicles.interface import DriverContext
from tests.shipped import PLATOON


def config_of(*overrides: str, twin: str, vehicle: str = "gternal", faults: str = "") -> Config:
    """Return a configuration whose r1 has a twin; ``faults``: a YAML list without its brackets."""
    own = (f"robots.0.twin={twin}", f"robots.0.vehicle={vehicle}", f"faults=[{faults}]")
    return load_config(PLATOON, [*own, *overrides])


class TwinStand:
    """r1's twin on a port in a folder, on a clock.

    Attributes:
        unplugged: Set it, and a twin that is running cuts its line.
    """

    def __init__(self, config: Config, folder: Path, clock: Clock) -> None:
        self.config, self.clock, self.port = config, clock, folder / "r1.tty"
        self.faults = Schedule(config, clock) if config.faults else None
        plant = slices.shared_plant(config, ["r1"], clock.now_ns())
        self.unplugged = threading.Event()
        self.twin = Twin(config, "r1", str(self.port), clock.now_ns(), self.faults, plant=plant)

    def step(self) -> int:
        """Let the twin do what is due; returns when it is due again [ns]."""
        return self.twin.step(self.clock.now_ns())

    def hear(self, seconds: float = 1.0) -> None:
        """Step the twin when what the driver has written is there: a pseudo-terminal takes a moment in real time."""
        if self.twin.descriptor is not None:
            select.select([self.twin.descriptor], [], [], seconds)
        self.step()

    @contextmanager
    def running(self) -> Iterator[None]:
        """Let a thread step the twin meanwhile; its clock must be the wall clock."""
        assert isinstance(self.clock, WallClock)
        ended = threading.Event()

        def go_on() -> None:
            while not ended.is_set():
                if self.unplugged.is_set():
                    self.twin.close()
                wait_s = max(0.0, (self.step() - self.clock.now_ns()) * 1e-9)
                readable = [] if self.twin.descriptor is None else [self.twin.descriptor]
                select.select(readable, [], [], min(0.05, wait_s))

        thread = threading.Thread(target=go_on)
        thread.start()
        try:
            yield
        finally:
            ended.set()
            thread.join()

    def context(self, settings: Any = None) -> DriverContext:
        """Return what a driver of r1 is made from."""
        robot = self.config.robot("r1")
        simulation = slices.simulation(self.config, robot, None)
        return DriverContext(
            robot="r1",
            drive=slices.drive(robot),
            simulation=simulation,
            now_ns=self.clock.now_ns,
            settings=settings,
            sensors=slices.sensors(robot),
        )
