"""A driver process: one robot or several, each behind its gate. It owns the gates; the drivers know no bus."""

import numpy as np

from robofleet.clock import MS, Clock
from robofleet.comms.bus import Bus, Wake
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.processes import driver_settings
from robofleet.processes.drivers import Drivers
from robofleet.processes.gated_robot import GatedRobot, Witness
from robofleet.processes.keeping import Keeping
from robofleet.vehicles.interface import DriverError

_LOOP_NS = 10 * MS


class DriverProcess:
    """The robots of one driver process: a 100 Hz loop that also wakes for a message and for a gate's deadline."""

    def __init__(
        self,
        config: Config,
        robot_ids: tuple[str, ...],
        bus: Bus,
        clock: Clock,
        wake: Wake,
        rng: np.random.Generator,
        keeping: Keeping,
        drivers: Drivers,
        witness: Witness | None = None,
    ) -> None:
        """Open every robot; DriverError where one does not answer."""
        self._clock, self._drivers = clock, drivers
        self._keeping, self._witness = keeping, witness
        self._robots: list[GatedRobot] = []
        try:
            self._open(config, robot_ids, bus, wake, rng)
        except BaseException:
            self.close()
            raise
        self._loop_ns = clock.now_ns() + int(rng.integers(_LOOP_NS))  # loops of several processes are not in phase
        self._loops = 0

    def _open(self, config: Config, robot_ids: tuple[str, ...], bus: Bus, wake: Wake, rng: np.random.Generator) -> None:
        for robot_id in robot_ids:
            context = self._drivers.context(robot_id)
            try:
                driver = self._drivers.open(context)
            except DriverError as error:
                raise DriverError(f"{driver_settings.place(config, config.robot(robot_id))}: {error}") from error
            boot_id, build = slices.drawn_id(rng, 64), slices.build(config)
            try:
                gated = GatedRobot(context, driver, boot_id, build, bus, wake, self._keeping, self._witness)
            except BaseException:
                driver.close()
                raise
            self._robots.append(gated)

    def step(self, now_ns: int) -> int:
        """Pass on what arrived; every 10 ms read and publish. Wheels go first, then latches, disk, bus, log."""
        due = not self._loop_ns - _LOOP_NS <= now_ns < self._loop_ns  # also when the clock was set back
        if due:
            self._loop_ns += _LOOP_NS * (1 + (now_ns - self._loop_ns) // _LOOP_NS)
            self._loops += 1
        now = self._clock.now_ns  # the robot before may have kept us: no gate decides by an old instant
        for robot in self._robots:
            if due:
                robot.look(now())
            robot.pass_on(now())
        for robot in self._robots:
            if robot.latch_is_new:
                robot.announce(now())
        for robot in self._robots:
            robot.settle(now(), due=due)
            if due:
                robot.publish(now(), status=self._loops % 2 == 1 or robot.hurries)
        if due:
            for robot in self._robots:
                robot.say()
        deadlines = [robot.deadline_ns for robot in self._robots if robot.deadline_ns is not None]
        return min([self._loop_ns, *deadlines])

    def close(self) -> None:
        """Motors off, every robot, whatever one of them does."""
        errors = []
        for robot in self._robots:
            try:
                robot.close()
            except Exception as error:  # noqa: BLE001 - the others' motors must go off too
                errors.append(error)
        if errors:
            raise ExceptionGroup("closing the drivers", errors)
