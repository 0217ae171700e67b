"""The bench of the drivers' contract: a driver, its robot's twin, the true wheels, and the loop of a driver process."""

import os
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import KW_ONLY, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, Self
from unittest.mock import patch

from robofleet.bus.arena_file import twin_port
from robofleet.config import slices
from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, SimulatedClock
from robofleet.core.plugins import load
from robofleet.drivers.dead_man import DeadMan
from robofleet.nodes.unit import driver_settings
from robofleet.simulation.faults import Schedule
from robofleet.simulation.twin import Twin
from robofleet.testing.serial_world import shared, unread
from robofleet.vehicles.differential_drive import DifferentialDrive, wheels_from_body
from robofleet.vehicles.interface import STOP, Driver, DriverContext, DriverError, DriverReading, WheelSpeeds
from robofleet.vehicles.readings import TruePose

LOOP_NS = 10 * MS  # the kit's
_WRITES = 3  # a command comes in every third loop
_AGAIN_NS = S // 5  # so long after a failure the kit makes a driver anew
_PLATOON = SHIPPED / "platoon.yaml"
_IDEAL = ("wheel_gain_spread", "wheel_base_spread", "slip_s_per_rad", "slip_noise", "top_speed_sag")


@dataclass(frozen=True)
class DriverSubject:
    """A driver under test. The names are those of a configuration's ``robots[]``.

    Attributes:
        driver: The driver: an entry point of ``robofleet.drivers``, or ``module:Class``.
        twin: The twin's firmware. None: the driver simulates its robot.
        vehicle: A file of ``configs/robots``, or the path of a .yaml file.
        settings: The driver's settings, without the port.
        sensors: Whether the driver reads its vehicle's sensors.
        encoders: Whether the robot has encoders. If not, its driver reads angles and speeds of 0.
    """

    driver: str
    twin: str | None
    _: KW_ONLY
    vehicle: str = "gternal"
    settings: Mapping[str, Any] = field(default_factory=dict)
    sensors: bool = False
    encoders: bool = True

    @property
    def stops_after_s(self) -> float | None:
        """How long after the last command the robot stops by itself [s]. None: it does not."""
        return 0.2 if self.twin is None else load("robofleet.twins", self.twin).watchdog_s

    @property
    def drive(self) -> DifferentialDrive:
        """The robot's wheels and limits, as configured."""
        return slices.drive(_config(self).robots[0])


class Moment(NamedTuple):
    """The end of one loop."""

    at_ns: int
    speeds: WheelSpeeds  # the wheels' true ones, mean over the loop [rad/s]
    angles: WheelSpeeds  # that the wheels have truly turned [rad]
    reading: DriverReading | None  # None: there was no driver, or it failed
    made: int  # how many drivers have been made


class DriverBench:
    """A robot, its driver once it is made, and a simulated clock. Use it as a context.

    The wheels are alike and do not slip.

    Attributes:
        config: The configuration, of which r1 is the robot.
        port: The robot's serial port.
        twin: The robot's twin. None: the driver simulates the robot.
        driver: The driver. None: it is not made yet, or given up.
        believed: The robot's wheels and limits, as configured.
        sensors: The robot's sensors that the driver reads. None: it reads none.
        clock: The simulated clock.
        angles: Angles by which the wheels have truly turned [rad].
        fastest: The largest true speed of a wheel so far [rad/s].
        waited_ns: How long drivers have waited for the robot so far [ns].
    """

    def __init__(self, subject: DriverSubject, *faults: Any, faster: float = 1.0) -> None:
        """Prepare the bench.

        Args:
            subject: The driver under test.
            faults: Faults of the configuration. They begin with ``strike``.
            faster: The true top speed of the wheels, as a multiple of the configured one.
        """
        self.config = _config(subject, faster).model_copy(update={"faults": faults})
        self.believed, self.sensors = subject.drive, slices.sensors(self.config.robots[0])
        self.clock = SimulatedClock()
        self.clock.advance_to(5 * S)
        self.angles = STOP  # that the wheels have truly turned [rad]
        self.fastest = 0.0  # that a wheel has truly turned [rad/s]
        self.waited_ns = 0  # by drivers
        self.driver: Driver | None = None
        self._made: list[Driver] = []
        self._schedule = Schedule(self.config, self.clock)
        self._next_ns = self._seen_ns = self.now_ns
        self._stack = ExitStack()
        self.twin: Twin | None = None

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            stack.enter_context(patch.dict(os.environ, {"XDG_RUNTIME_DIR": folder}))
            stack.enter_context(shared(lambda: self.now_ns, self._pass_while_waiting))
            # A dead man counts real seconds, and here none pass: without a sign of life it does not watch.
            stack.enter_context(patch.object(DeadMan, "sign", lambda _: None))
            self.port = twin_port(self.config.arena.name, "r1")
            if self.config.robots[0].twin is not None:
                self.twin = Twin(self.config, "r1", str(self.port), self.now_ns, self._schedule)
                stack.callback(self.twin.close)
            stack.callback(self._close_all)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    @property
    def now_ns(self) -> int:
        """The simulated time [ns]."""
        return self.clock.now_ns()

    def make(self) -> Driver:
        """Make the driver, on the same port as the one before.

        Returns:
            The driver.
        """
        self.driver = load("robofleet.drivers", self.config.robots[0].driver)(self.context())
        self._made.append(self.driver)
        return self.driver

    def context(self) -> DriverContext:
        """Make the context of the driver.

        Returns:
            What the driver is made from.
        """
        robot = self.config.robots[0]
        simulation = slices.simulation(self.config, robot, None)
        settings, world = driver_settings.of(self.config, robot), slices.world(self.config)
        return DriverContext(
            robot="r1",
            drive=self.believed,
            simulation=simulation,
            now_ns=self.clock.now_ns,
            settings=settings,
            sensors=self.sensors,
            world=world,
        )

    def strike(self) -> None:
        """Begin the faults."""
        self._schedule.begin(self.now_ns)

    def let_pass(self, seconds: float) -> None:
        """Let time pass for the robot. The driver is not called.

        Args:
            seconds: How long [s].
        """
        end_ns = self.now_ns + round(seconds * S)
        self._step()  # it hears what was written before
        while self.now_ns < end_ns:
            self._pass_until(end_ns)

    def drive(self, wheels: WheelSpeeds | None, seconds: float) -> list[Moment]:
        """Call the driver as its process does: ``read`` in every loop, ``write`` in every third one.

        Args:
            wheels: The commanded speeds [rad/s]. None: nothing is written.
            seconds: How long [s].

        Returns:
            The end of each loop.
        """
        return [self._loop(wheels, k) for k in range(round(seconds * S / LOOP_NS))]

    def drive_on(self, wheels: WheelSpeeds | None, seconds: float, *, hold: bool = False) -> list[Moment]:
        """Drive through failures: a driver that fails is closed and made again, and then only read.

        Args:
            wheels: The commanded speeds [rad/s]. None: nothing is written.
            seconds: How long [s].
            hold: Go on to command the wheels after a failure.

        Returns:
            The end of each loop.
        """
        moments: list[Moment] = []
        again_ns = 0
        for k in range(round(seconds * S / LOOP_NS)):
            if self.driver is None and self.now_ns >= again_ns:
                again_ns = self.now_ns + _AGAIN_NS
                with suppress(DriverError, OSError):
                    self.make()
            try:
                moments.append(self._loop(wheels, k))
            except (DriverError, OSError):
                again_ns, wheels = self.now_ns + _AGAIN_NS, wheels if hold else None
                self.give_up()
                moments.append(self._moment(None))
        return moments

    def run(self, step: Callable[[int], int], seconds: float) -> None:
        """Step a process whenever it asks to be stepped.

        Args:
            step: Takes the time [ns], and returns when to step again [ns].
            seconds: How long [s].
        """
        end_ns = self.now_ns + round(seconds * S)
        while self.now_ns < end_ns:
            next_ns = step(self.now_ns)
            self.let_pass((min(end_ns, next_ns) - self.now_ns) / S)

    def unheard(self) -> int:
        """Count the bytes that the robot has not read.

        Returns:
            How many bytes wait at the robot's end of the line.
        """
        return 0 if self.twin is None else unread(self.port)

    def give_up(self) -> None:
        """Close the driver."""
        if self.driver is not None:
            self.driver.close()
            self.driver = None

    def _loop(self, wheels: WheelSpeeds | None, number: int) -> Moment:
        reading = None
        if self.driver is not None:
            reading = self.driver.read()
            if wheels is not None and number % _WRITES == 0:
                self.driver.write(wheels)
        return self._moment(reading)

    def _moment(self, reading: DriverReading | None) -> Moment:
        before = self.angles
        self.let_pass(LOOP_NS / S)
        speeds = WheelSpeeds(*((b - a) * S / LOOP_NS for a, b in zip(before, self.angles, strict=True)))
        return Moment(self.now_ns, speeds, self.angles, reading, len(self._made))

    def _pass_while_waiting(self, deadline_ns: int) -> None:
        before_ns = self.now_ns
        self._step()
        self._pass_until(deadline_ns)
        self.waited_ns += self.now_ns - before_ns

    def _pass_until(self, deadline_ns: int) -> None:
        self.clock.advance_to(min(deadline_ns, max(self._next_ns, self.now_ns + 1)))
        self._step()

    def _step(self) -> None:
        self._next_ns = self.now_ns + LOOP_NS if self.twin is None else self.twin.step(self.now_ns)
        truth, passed_s = self._truth(), (self.now_ns - self._seen_ns) / S
        if truth is None or not passed_s:
            return
        self._seen_ns = self.now_ns
        turn = wheels_from_body(truth.v, truth.omega, self.believed.wheel_radius, self.believed.wheel_base)
        self.fastest = max(self.fastest, *map(abs, turn))
        self.angles = WheelSpeeds(*(angle + speed * passed_s for angle, speed in zip(self.angles, turn, strict=True)))

    def _truth(self) -> TruePose | None:
        if self.twin is not None:
            return self.twin.truth()
        truth = getattr(self.driver, "truth", None)
        return None if truth is None else truth()

    def _close_all(self) -> None:
        for driver in self._made:
            with suppress(DriverError, OSError):
                driver.close()


@lru_cache
def _loaded(driver: str, twin: str | None, vehicle: str, settings: str, sensors: bool, faster: float) -> Config:
    ideal = [f"robots.0.vehicle.simulated.{key}=0" for key in _IDEAL]
    twins = [] if twin is None else [f"robots.0.twin='{twin}'"]
    own = [f"robots.0.driver='{driver}'", f"robots.0.vehicle={vehicle}", f"robots.0.settings={settings}", *twins]
    own += ["robots.0.sensors=true"] if sensors else []
    config = load_config(_PLATOON, [*own, *ideal])
    fast = f"robots.0.vehicle.max_wheel_speed_rad_s={faster * config.robots[0].vehicle.max_wheel_speed_rad_s}"
    return config if faster == 1.0 else load_config(_PLATOON, [*own, *ideal, fast])


def _config(subject: DriverSubject, faster: float = 1.0) -> Config:
    named = subject.vehicle.endswith(".yaml")
    vehicle = str(Path(subject.vehicle).absolute()) if named else subject.vehicle
    return _loaded(subject.driver, subject.twin, vehicle, str(dict(subject.settings)), subject.sensors, faster)
