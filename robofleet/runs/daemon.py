"""A robot's own computer: it waits for a run for ever, takes its configuration, and drives as that says."""

import json
import secrets
import socket
import sys
from collections.abc import Callable
from contextlib import closing
from importlib.metadata import version
from pathlib import Path

from robofleet.bus.bus import Request, Wake
from robofleet.bus.credentials import Credentials, KeysError, credentials, passport, session_id
from robofleet.bus.keys import CONFIG, HOST
from robofleet.bus.living import RoleTakenError
from robofleet.bus.messages import HANDED
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.config.files.robot_file import RobotFile, load_robot_file, robot_file
from robofleet.config.load import ConfigError
from robofleet.config.tree import Config
from robofleet.core.clock import Clock, S, WallClock, utc_now
from robofleet.core.log_lines import never_raise
from robofleet.core.patterns import driver_role
from robofleet.core.refusal import RefusedError
from robofleet.nodes.handing import HandedError, unpacked
from robofleet.nodes.node import Lifeline, Waker, ahead_of_others, realtime_priority, run
from robofleet.nodes.unit import driver_settings
from robofleet.nodes.unit.driver import LOOP_NS, DriverProcess
from robofleet.nodes.unit.drivers import ConfiguredDrivers
from robofleet.nodes.unit.state_store import FileStateStore
from robofleet.runs.table import say
from robofleet.vehicles.interface import DriverError

_IDLE_NS = S // 10
_DRIVER_PRIORITY = 15

Say = Callable[[str], None]


class Daemon:
    """The driver of a unit, whatever run comes: each hands it a configuration.

    ``file``: where ``robot`` was read; ``host``: what is told of this computer; ``say``: a line of the log. Each run
    has a part of the bus of its own, which is closed when another run comes.
    """

    def __init__(
        self, robot: RobotFile, file: Path, bus: ZenohBus, clock: Clock, wake: Wake,
        host: dict[str, str], say: Say,
    ) -> None:  # fmt: skip
        self._robot, self._file, self._bus, self._clock, self._wake = robot, file, bus, clock, wake
        self._host, self._say = host, say
        self._requests = bus.serve(CONFIG, robot.unit, wake)
        self._questions = bus.serve(HOST, robot.unit, wake)
        self._driver: DriverProcess | None = None
        self._part: ZenohBus | None = None
        self._newest = ""  # line of the log

    def step(self, now_ns: int) -> int:
        """Take a configuration if one came, and drive."""
        if (request := self._requests()) is not None:
            self._answer(request)
        if (question := self._questions()) is not None:
            question.reply(json.dumps(self._host).encode())
        if self._driver is None:
            return now_ns + _IDLE_NS
        return self._driver.step(self._clock.now_ns())

    def close(self) -> None:
        """Motors off. Idempotent."""
        driver, self._driver = self._driver, None
        part, self._part = self._part, None
        try:
            if driver is not None:
                driver.close()
        finally:
            if part is not None:
                part.close()

    def _answer(self, request: Request) -> None:
        try:
            self._take(request.payload)
            words = "ok"
        except (HandedError, DriverError, RefusedError, OSError) as error:
            words = f"refused: {error}"
        except Exception as error:  # noqa: BLE001 - a run that cannot be taken does not end the daemon: others will come
            words = f"refused: {type(error).__name__}: {error}"
        self._log(words)
        request.reply(words.encode()[:1024])

    def _log(self, line: str) -> None:
        if line != self._newest:
            self._newest = line
            self._say(line)

    def _take(self, payload: bytes) -> None:
        """Drive by a configuration from now on; nothing changes where it cannot be."""
        message = HANDED.decode(payload)
        if message is None:
            raise HandedError("the configuration came damaged")
        if self._driver is not None and self._driver.build == message.build:
            return
        if self._driver is not None and self._driver.any_open:
            raise HandedError(f"{self._robot.unit} is driving in another run: end that one first")
        config = unpacked(message)
        if self._robot.unit not in config.units:
            raise HandedError(f"no robot of this configuration has the unit {self._robot.unit}")
        self._refuse(config)
        self.close()
        self._part = self._bus.part()
        try:
            self._driver = self._made(config, self._part)
        except BaseException:
            self.close()
            raise

    def _refuse(self, config: Config) -> None:
        """Raise HandedError where a run wants what the robot's own file does not allow."""
        for name in config.units[self._robot.unit]:
            wanted = config.robot(name)
            port, fastest = driver_settings.port(config, wanted), wanted.vehicle.max_wheel_speed_rad_s
            if (refusal := self._robot.refusal(wanted.driver, port, fastest)) is not None:
                raise HandedError(f"{name}: {self._file} on this robot does not allow {refusal}")

    def _made(self, config: Config, bus: ZenohBus) -> DriverProcess:
        state_store = FileStateStore(config.arena.name, simulated=config.simulated)
        state_store.prove(config.units[self._robot.unit])
        drivers = ConfiguredDrivers(config, self._clock.now_ns)
        boot_id, phase_ns = 1 + secrets.randbelow((1 << 63) - 1), secrets.randbelow(LOOP_NS)
        unit, clock, wake = self._robot.unit, self._clock, self._wake
        return DriverProcess(config, unit, bus, clock, wake, boot_id, phase_ns, state_store, drivers)


def _joined(robot: RobotFile, clock: Clock, own: Credentials, session: str) -> ZenohBus:
    """Join the arena's bus, whenever its router is there; RefusedError where this unit is driven already."""
    try:
        return ZenohBus(
            robot.arena, robot.router, robot.unit, clock, roles=(driver_role(robot.unit),), credentials=own,
            session=session,
        )  # fmt: skip
    except RoleTakenError as error:
        raise RefusedError(str(error)) from error


def main() -> None:
    """Be this computer's driver until the process is ended. RefusedError where its file or its keys cannot be used."""
    never_raise(stdout=True)
    file = robot_file()
    try:
        robot = load_robot_file(file)
        own, certificate = credentials(robot.arena, robot.unit), passport(robot.arena, robot.unit)
    except (ConfigError, KeysError) as error:
        raise RefusedError(str(error)) from error
    held = Lifeline(None)
    ahead_of_others()
    clock, waker = WallClock(), Waker()
    say(f"{robot.unit} of {robot.arena}: waiting for the router at {', '.join(robot.router)}")
    with closing(_joined(robot, clock, own, session_id(certificate))) as bus:
        host = {
            "version": version("robofleet"), "host": socket.gethostname(), "since": f"{utc_now():%Y-%m-%dT%H:%M:%SZ}",
            "certificate_ends": f"{certificate.not_after:%Y-%m-%d}",
        }  # fmt: skip
        node = Daemon(robot, file, bus, clock, waker, host, say)
        realtime_priority(_DRIVER_PRIORITY)
        run(node, clock, held, waker)


if __name__ == "__main__":
    try:
        main()
    except RefusedError as refused:
        say(str(refused))
        sys.exit(2)
