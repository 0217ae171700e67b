"""Makes the robots of a unit: each behind its driver, or all simulated ones at once."""

import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from numpy.typing import NDArray

from robofleet.bus.messages import LeaseAnswer
from robofleet.bus.sensors import SensorMessage
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.core.plugins import load
from robofleet.nodes.unit import driver_settings
from robofleet.nodes.unit.gated_robot import GatedRobots, Probe
from robofleet.nodes.unit.reconnecting_driver import ReconnectingDriver
from robofleet.nodes.unit.state_store import StateStore
from robofleet.safety.gate import LeaseAction
from robofleet.vehicles.interface import Driver, DriverContext, DriverError, SimulatedDriver, is_concurrent

if TYPE_CHECKING:
    from robofleet.simulation.bodies import Bodies

UnitMessage = tuple[NDArray[Any], NDArray[Any]]  # a message's head (1,) and its items (N,)
_ARRAYS = "simulated"  # the driver whose robots are simulated all at once


class Robots(Protocol):
    """The robots of a unit (N,), each behind its gate."""

    def __len__(self) -> int: ...

    @property
    def boot_id(self) -> int:
        """What every message to them must echo."""

    @property
    def deadline_ns(self) -> int:
        """When a gate must be asked again."""

    @property
    def hurries(self) -> bool:
        """Whether the link was bad a short while ago: then a status goes out in every loop."""

    @property
    def newest_nonce_ns(self) -> int:
        """The newest nonce that a command and a permission have echoed: by it the gates live."""

    @property
    def latch_is_new(self) -> bool:
        """Whether the newest status does not tell of a gate's latch yet."""

    @property
    def any_open(self) -> bool:
        """Whether a gate lets a controller's commands through."""

    def set_back(self, from_ns: int, now_ns: int) -> None:
        """Let every gate begin anew: the clock was set back from one instant to another."""

    def pass_on(self, now_ns: int, command: UnitMessage | None, enable: UnitMessage | None, *, due: bool) -> None:
        """Let the gates decide on what arrived, and write the wheels; read the robots before, if that is due."""

    def lease(self, session: int, action: LeaseAction, now_ns: int) -> tuple[LeaseAnswer, ...]:
        """Answer a request for the leases."""

    def keep(self, *, due: bool) -> None:
        """Keep what must be kept of the gates: the disk is slow, so every robot's wheels went before."""

    def statuses(self, now_ns: int, refused: int) -> NDArray[Any]:
        """Return every robot's part of a status; ``refused``: messages of the unit that nobody could read."""

    def truths(self) -> NDArray[Any] | None:
        """Return the part of a truth of each that is simulated; None where all exist."""

    def sensors(self) -> SensorMessage:
        """Return what is said of the sensors of each that tells of them; asked where somebody wants to know."""

    def say(self) -> None:
        """Say in the log what there is to complain about."""

    def close(self) -> None:
        """Motors off at once, drivers closed. Idempotent."""


class Drivers(Protocol):
    """What a driver process makes its robots from."""

    def context(self, robot: str) -> DriverContext:
        """Return what a robot's driver is made from."""

    def driver(self, context: DriverContext) -> Driver:
        """Return a driver whose robot has answered and stands; DriverError where it does not."""

    def bodies(self, contexts: Sequence[DriverContext]) -> "Bodies | None":
        """Return the robots of a unit as bodies in arrays; None where each has a driver of its own."""


class ConfiguredDrivers:
    """Makes what the configuration names. The driver of a robot that exists is made again when it fails."""

    def __init__(self, config: Config, now_ns: Callable[[], int]) -> None:
        self._config, self._now_ns, self._world = config, now_ns, slices.world(config)
        self._constructing = threading.Lock()

    def context(self, robot: str) -> DriverContext:
        """Return what a robot's driver is made from."""
        return driver_settings.context(self._config, self._config.robot(robot), self._now_ns, self._world)

    def driver(self, context: DriverContext) -> Driver:
        """Return a robot's driver; DriverError where the robot does not answer."""
        kind = load("robofleet.drivers", self._config.robot(context.robot).driver)
        make: Callable[[], Driver] = partial(kind, context)
        if not is_concurrent(kind):
            make = partial(self._alone, make)
        return make() if issubclass(kind, SimulatedDriver) else ReconnectingDriver(make, context.now_ns)

    def _alone(self, make: Callable[[], Driver]) -> Driver:
        """Construct a driver while no other is: several that failed at once are made again one after the other."""
        with self._constructing:
            return make()

    def bodies(self, contexts: Sequence[DriverContext]) -> "Bodies | None":
        """Return the robots of a unit that this project simulates, as bodies in arrays; None for any other unit."""
        if not in_arrays(self._config, [context.robot for context in contexts]):
            return None
        from robofleet.simulation.bodies import Bodies  # noqa: PLC0415 - it needs numba

        return Bodies(contexts)


def in_arrays(config: Config, robots: Sequence[str]) -> bool:
    """Return whether this project simulates all of these robots, so that their bodies are in arrays."""
    return all(config.robot(robot).driver == _ARRAYS for robot in robots)


def behind_gates(
    drivers: Drivers, config: Config, robots: Sequence[str], boot_id: int, state_store: StateStore, probe: Probe | None,
    now_ns: Callable[[], int],
) -> Robots:  # fmt: skip
    """Return a unit's robots, which have answered and stand, behind their gates; DriverError where one does not."""
    contexts = [drivers.context(robot) for robot in robots]
    if (bodies := drivers.bodies(contexts)) is not None:
        from robofleet.nodes.unit.simulated_robots import SimulatedRobots  # noqa: PLC0415 - it needs numba

        return SimulatedRobots(contexts, bodies, boot_id, state_store, probe, now_ns())
    opened: list[Driver] = []
    try:
        for context in contexts:
            try:
                opened.append(drivers.driver(context))
            except DriverError as error:
                raise DriverError(f"{driver_settings.place(config, config.robot(context.robot))}: {error}") from error
        return GatedRobots(contexts, opened, boot_id, state_store, probe, now_ns)
    except BaseException:
        for driver in opened:
            driver.close()
        raise
