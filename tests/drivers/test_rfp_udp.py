"""rfp/1 over UDP, on real sockets: the driver, and the C sources compiled for this computer."""

import mmap
import subprocess
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from random import Random

import pytest

from robofleet.bus.arena_file import twin_port
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S, SimulatedClock, WallClock
from robofleet.doctor.needs import Needs
from robofleet.drivers.rfp import Rfp
from robofleet.drivers.rfp_frames import Hello, Lease, LeaseAnswer, Message, Receiver, Status, frame, line, message
from robofleet.nodes.unit import driver_settings
from robofleet.runs.check_drivers import complaints
from robofleet.safety.latches import GateStatus, Latch
from robofleet.simulation.firmware_library import firmware_library, robot_program
from robofleet.simulation.udp_line import UdpLine, UdpLineError
from robofleet.testing.serial_world import shared
from robofleet.vehicles.interface import STOP, DriverContext, DriverError, RobotFault, WheelSpeeds
from tests.drivers.line_bench import COUNTS_PER_TURN
from tests.drivers.network_bench import NetworkBench, datagrams, readable
from tests.drivers.test_rfp import WHEELS, driven, stops
from tests.endpoints import free_port
from tests.robots import GTERNAL
from tests.shipped import PLATOON

DRIVE = replace(GTERNAL, wheel_radius=0.0325, max_wheel_speed=12.0, max_speed=0.3, max_wheel_acceleration=100.0)
COUNTS, CLIFF = 2248, 4


# A robot that is a process, in real time.


class Robot:
    """It is killed, and started anew with the same memory."""

    def __init__(self, folder: Path) -> None:
        self.port, self._memory = free_port(), folder / "memory"
        self._drivers: list[Rfp] = []
        self.start()

    def start(self) -> None:
        self._process = subprocess.Popen([robot_program({}), str(self.port), str(self._memory)])
        until(lambda: self._memory.exists() and self._memory.stat().st_size > 0)
        with self._memory.open("r+b") as file:
            ffi = firmware_library({}).ffi
            self.pins = ffi.from_buffer("struct host *", mmap.mmap(file.fileno(), 0))

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def driver(self) -> Rfp:
        settings = Rfp.Settings(port=f"udp://127.0.0.1:{self.port}", counts_per_turn=COUNTS)
        context = DriverContext(
            robot="r1", drive=DRIVE, simulation=None, now_ns=WallClock().now_ns, settings=settings
        )  # fmt: skip
        self._drivers.append(Rfp(context))
        return self._drivers[-1]

    def close(self) -> None:
        for driver in self._drivers:
            driver.close()
        self.kill()


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Robot]:
    monkeypatch.setattr("robofleet.drivers.rfp._SILENT_NS", 60 * S)  # a busy machine lets a process wait
    robot = Robot(tmp_path)
    yield robot
    robot.close()


def until(done: Callable[[], bool]) -> None:
    clock = WallClock()
    for _ in range(2000):
        if done():
            return
        clock.sleep_until(clock.now_ns() + 10 * MS)
    raise AssertionError("it was waited for in vain")


def test_a_robot_on_a_network_stands_without_its_host_and_obeys_the_next_one(robot: Robot) -> None:
    for _ in range(2):
        driver = robot.driver()

        def turns(driver: Rfp = driver) -> bool:
            driver.write(WHEELS)
            reading = driver.read()
            return reading[2:4] == pytest.approx(WHEELS, abs=0.3)

        until(turns)
        assert robot.pins.duty[0] > 0 > robot.pins.duty[1]
        driver._line.close()  # as a process that is killed
        until(lambda: list(robot.pins.duty) == [0, 0])


def test_a_robot_that_was_switched_off_keeps_its_latch_and_its_driver_says_that_it_started(robot: Robot) -> None:
    driver = robot.driver()

    def latched() -> bool:
        driver.write(WHEELS)
        return bool(driver.read().faults)

    robot.pins.faults = CLIFF
    until(latched)
    robot.pins.faults = 0
    until(lambda: not latched())
    robot.kill()
    robot.start()
    with pytest.raises(DriverError, match="its board started anew: it was switched on"):
        until(latched)
    driver.close()
    driver = robot.driver()
    assert driver.read().faults == RobotFault.OWN << Latch.ROBOT_FAULT


# Robot and driver in virtual time.


@pytest.mark.slow
def test_the_target_is_zero_120_ms_after_the_newest_nonce() -> None:
    with NetworkBench() as bench:
        driven(bench)
        bench.pass_time(0.5, WHEELS)
        assert bench.firmware.robot.gate.status == GateStatus.OPEN
        assert stops(bench) <= 0.125
        assert 115 <= bench.firmware.robot.gate.target_after <= 125


class Disturbed:
    """A network that loses, doubles, delays and strikes a share of what it carries, each."""

    def __init__(self, random: Random, share: float) -> None:
        self._random, self._share = random, share

    def __call__(self, datagram: bytes) -> Sequence[tuple[int, bytes]]:
        copies = [datagram] * (1 + self._happens()) if not self._happens() else []
        return [(self._late_ns(), self._struck(copy) if self._happens() else copy) for copy in copies]

    def _happens(self) -> bool:
        return self._random.random() < self._share

    def _late_ns(self) -> int:
        return round(self._random.uniform(0.0, 0.5) * S) if self._happens() else 0

    def _struck(self, datagram: bytes) -> bytes:
        random, struck = self._random, bytearray(datagram)
        struck[random.randrange(len(struck))] ^= random.randrange(1, 256)
        return bytes(struck[: random.randrange(1, len(struck) + 1)]) + random.randbytes(random.randrange(3))


@pytest.mark.slow_after_first
@pytest.mark.parametrize("seed", range(3))
def test_lost_doubled_late_and_struck_datagrams_move_nothing_wrongly(seed: int) -> None:
    random = Random(seed)
    moved = 0
    with NetworkBench() as bench:
        driven(bench)
        bench.fate = Disturbed(random, 0.15)
        given = deque([(bench.now_ns, WHEELS)])
        for _ in range(800):
            given.append((bench.now_ns, WheelSpeeds(*(random.randrange(-2500, 2500) / 512 for _ in range(2)))))
            bench.write(*given[-1][1])
            bench.let_pass(0.005)
            bench.read()
            gate = bench.firmware.robot.gate
            target = WheelSpeeds(gate.target_left / 512, gate.target_right / 512)
            if target != STOP:
                moved += 1
                while given and given[0][1] != target:  # what was given before a command that moved it moves it no more
                    given.popleft()
                assert given and bench.now_ns - given[0][0] <= 125 * MS
        assert moved > 400
        assert bench.firmware.robot.receiver.struck > 0
        assert stops(bench) <= 0.125
        bench.let_pass(0.5)  # what is still on its way comes
        assert gate.target_left == gate.target_right == 0


def test_a_robot_that_leaves_the_network_is_missed_and_drives_when_it_is_back() -> None:
    with NetworkBench() as bench:
        driven(bench)
        bench.line.unplug()
        with pytest.raises(DriverError, match=r"it said nothing for 0.5 s: is the robot on, and in reach of its Wi-Fi"):
            bench.pass_time(0.7, WHEELS)
        assert bench.hardware.command == STOP
        bench.driver.close()
        bench.line.plug()
        driven(bench)


def test_a_second_host_gets_answers_but_no_lease_and_the_first_one_drives_on() -> None:
    with NetworkBench() as bench, datagrams() as stranger:
        driven(bench)
        bench.patience_s = 0.0
        stranger.connect(bench.robot)
        receiver, got = Receiver(), list[Message]()
        for k in range(50):
            if k % 10 == 0:
                stranger.send(frame(Hello(), k) + frame(Lease(99, 1), k))
            bench.write(*WHEELS)
            bench.let_pass(0.02)
            bench.read()
            assert bench.firmware.robot.gate.status == GateStatus.OPEN
            while readable(stranger.fileno(), 0.0):
                got += [each for body in receiver.receive(stranger.recv(2048)) if (each := message(body))]
        answers = [each for each in got if isinstance(each, LeaseAnswer)]
        assert answers and not any(each.granted for each in answers if each.session == 99)
        assert any(isinstance(each, Status) for each in got)


def test_nobody_is_answered_who_has_been_silent_for_a_second_and_no_robot_answers_another() -> None:
    with NetworkBench() as bench, datagrams() as other:
        driven(bench)
        assert bench.line.open
        bench.let_pass(1.1)
        assert not bench.line.open
        status = bytes([10 << 4]) + bytes(28)
        for nonsense in (b"", b"\0", bytes(100), b"hello", line(status)):
            other.sendto(nonsense, bench.robot)
            bench.arrived()
            bench.hear()
        assert not bench.line.open
        other.sendto(frame(Hello(), 0), bench.robot)
        bench.arrived()
        bench.hear()
        assert bench.line.open


# What cannot be opened.


def refused(url: str, pass_time: Callable[[], None] = lambda: None) -> str:
    """Return what the driver says of a port; its patience costs no real time."""
    clock = SimulatedClock()
    settings = Rfp.Settings(port=url, counts_per_turn=COUNTS_PER_TURN)

    def wait(deadline_ns: int) -> None:
        pass_time()
        clock.advance_to(deadline_ns)

    with shared(clock.now_ns, wait), pytest.raises(DriverError) as error:
        Rfp(DriverContext(robot="r1", drive=GTERNAL, simulation=None, now_ns=clock.now_ns, settings=settings))
    assert str(error.value).startswith(f"{url}: ") and "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    ("host", "why"),
    [
        ("nobody.invalid", "the name nobody.invalid does not resolve"),
        ("r1..lab", "the name r1..lab does not resolve"),
        ("255.255.255.255", "this address is not one robot's"),
        ("127.0.0.1", "no program listens at this port"),
    ],
)
def test_a_robot_that_cannot_be_reached_is_named_in_a_line(host: str, why: str) -> None:
    assert why in refused(f"udp://{host}:{free_port()}")


def test_another_program_at_the_port_is_no_robot() -> None:
    with datagrams() as program:
        program.setblocking(False)

        def answer() -> None:
            with suppress(BlockingIOError):
                program.sendto(b"what?", program.recvfrom(2048)[1])

        assert "does not speak rfp" in refused(f"udp://127.0.0.1:{program.getsockname()[1]}", answer)


def test_a_robot_that_says_nothing_on_a_network_that_carries_is_looked_for() -> None:
    with datagrams() as deaf:
        assert "in reach of its Wi-Fi?" in refused(f"udp://127.0.0.1:{deaf.getsockname()[1]}")


@pytest.mark.parametrize("url", ["udp://", "udp://r1", "udp://r1:0", "udp://r1:65536", "udp://a b:1", "udp://[::1]:1"])
def test_a_port_that_is_none_is_refused_before_a_run(url: str) -> None:
    settings = Rfp.Settings(port=url, counts_per_turn=1)
    assert Rfp.refusals(settings, GTERNAL) == [
        ("settings.port", f"{url}: write udp://HOST:PORT, for example udp://192.168.1.21:4210")
    ]
    assert "write udp://HOST:PORT" in refused(url)


# A twin on a network.


def test_a_twin_on_a_network_has_the_configured_port_for_itself() -> None:
    settings = "{port: 'udp://127.0.0.1:4210', counts_per_turn: 2248}"
    keys = {"driver": "rfp", "vehicle": "rfp", "twin": "rfp", "settings": settings}
    config = load_config(PLATOON, [f"robots.{k}.{key}={value}" for k in (0, 1) for key, value in keys.items()])
    assert driver_settings.port(config, config.robots[0]) == "udp://127.0.0.1:4210"
    assert [*complaints(config)] == [("robots.1.settings.port", "r1 has this port: each robot needs its own")]


@pytest.mark.parametrize("address", ["192.168.1.21:4210", "0.0.0.0:4210", "r1:4210"])
def test_a_twin_of_a_robot_elsewhere_listens_to_no_network(address: str) -> None:
    settings = f"{{port: 'udp://{address}', counts_per_turn: 2248}}"
    keys = {"driver": "rfp", "vehicle": "rfp", "twin": "rfp", "settings": settings}
    config = load_config(PLATOON, [f"robots.0.{key}={value}" for key, value in keys.items()])
    assert driver_settings.port(config, config.robots[0]) == str(twin_port("platoon", "r1"))
    assert [*complaints(config)] == []


def test_a_robot_on_a_network_needs_no_serial_port() -> None:
    config = load_config(
        PLATOON, ["robots.0.settings={port: 'udp://r1:4210', counts_per_turn: 2248}", "robots.0.driver=rfp"]
    )
    assert [*Needs(config).ports()] == []


def test_a_twin_whose_port_somebody_has_says_so() -> None:
    with datagrams() as other:
        url = f"udp://127.0.0.1:{other.getsockname()[1]}"
        with pytest.raises(UdpLineError, match=f"{url}: a twin needs a free port of this computer"):
            UdpLine(url, lambda: 0)
