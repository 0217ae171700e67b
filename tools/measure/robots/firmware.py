"""What the firmware of an Uno does when its host dies, when noise strikes its line, and when its power fails.

    python -m tools.measure.robots.firmware deaths [--tries 100] [--slower 1]
    python -m tools.measure.robots.firmware silences [--tries 100]
    python -m tools.measure.robots.firmware images [--tries 100]
    python -m tools.measure.robots.firmware noise [--minutes 10] [--share 0.01] [--seed 1] [--board uno|host]
    python -m tools.measure.robots.firmware latency [--tries 500]
    python -m tools.measure.robots.firmware resets [--tries 100]

The binary is the one that is flashed (drivers/firmware), in simavr; its driver is the real one, at a pseudo-terminal.
Board ``host``: the same sources, compiled for this computer; many times faster.

deaths: real processes at full speed, in real time; where a machine is too slow for that, in time that passes so many
  times slower. Times are the binary's own: from the issue of the newest nonce on.
silences: the same in virtual time: the host falls silent at any moment; or its line is cut, in the middle of a frame.
images: the same of the images of a Pico (in rp2040py) and a Teensy (on a model of its chip), without their driver.
noise: virtual time. Of the bytes a share is changed, of the lines that share each is cut, doubled or late, both ways.
  A motion is wrong if the gate's target is neither zero nor what was commanded in the last 0.3 s.
latency: virtual time, from a write of the driver to the motors' pins (from rest) or to the gate's target (in motion).
resets: virtual time. An emergency stop, and the power fails at any moment of the writing of its latch; a program that
  hangs; what the robot says then.
"""

import os
import random
import signal
import statistics
import tempfile
import traceback
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from robofleet.core.clock import MS, S, WallClock
from robofleet.drivers.rfp import Rfp
from robofleet.simulation.avr.board import Reset
from robofleet.simulation.firmwares.arduino_uno import ArduinoUnoFirmware, Gate
from robofleet.vehicles.interface import STOP, DriverError, WheelSpeeds
from tests.drivers.line_bench import COUNTS_PER_TURN, LineBench, rfp
from tests.simulation.pico import Pico
from tests.simulation.rfp_host import NO_LEASE
from tests.simulation.teensy import Teensy
from tests.simulation.test_arduino_uno import SLEEP, hang, latched_by_an_emergency_stop
from tests.simulation.uno import UNO_SETTINGS, Uno, uno_behind_its_driver, uno_configured
from tests.twins import TwinStand
from tools.measure.program import program

WALL = WallClock()
FASTEST = WheelSpeeds(9.0, 9.0)  # rad/s; by the body's top speed
REMEMBERED_NS = 300 * MS
BETWEEN_WRITES_CYCLES = 160  # 10 us: the emulator may stop a board when it has written the target of one wheel only
_PATIENCE_NS = 10 * S  # with a driver that starts, or a stop
_LATEST_S = 0.2  # of a line that is late


# --- deaths ---


class SlowClock(WallClock):
    """The wall clock, and time passes slower; in every process alike."""

    def __init__(self, slower: float) -> None:
        self._slower = slower

    def now_ns(self) -> int:
        return round(super().now_ns() / self._slower)

    def sleep_until(self, instant_ns: int, *, precise: bool = False) -> None:
        while (left_ns := instant_ns - self.now_ns()) > 0:
            WALL.sleep_until(WALL.now_ns() + round(left_ns * self._slower))


def deaths(tries: int, slower: float) -> None:
    for name, number in (("kill -9", signal.SIGKILL), ("SIGSTOP", signal.SIGSTOP), ("cable cut", None)):
        gates: list[Gate] = []
        repeated = 0
        while len(gates) < tries:
            gate = _death(number, random.Random(len(gates) + repeated), SlowClock(slower))
            if gate is None:
                repeated += 1
            else:
                gates.append(gate)
        _report(name, gates)
        if repeated:
            print(f"{name}: {repeated} more whose driver was stopped too early by this machine: raise --slower")


def _report(name: str, gates: list[Gate]) -> None:
    assert all(gate.target == STOP and gate.target_after_ms >= 0 for gate in gates)
    targets, outputs = [gate.target_after_ms for gate in gates], [gate.output_after_ms for gate in gates]
    print(
        f"{name}: zero target after {statistics.median(targets):.0f} ms (median), {max(targets)} ms at most; "
        f"zero output after {max(outputs)} ms at most; of {len(gates)}",
        flush=True,
    )


def silences(tries: int) -> None:
    for name in ("silent", "cut in a frame"):
        rng, gates = random.Random(1), []
        with uno_behind_its_driver(MS) as bench:
            bench.open(**UNO_SETTINGS)
            for _ in range(tries):
                bench.pass_time(rng.uniform(0.25, 0.35), FASTEST)
                assert bench.firmware.gate.target == FASTEST
                bench.let_pass(0.01 + rng.randrange(10) / 1000)
                if name != "silent":
                    bench.driver.write(WheelSpeeds(8.0, 9.0))
                    line = bench.line.read()
                    bench.say(bench.firmware.receive(line[: rng.randrange(len(line))], bench.now_ns))
                bench.let_pass(0.3)
                gates.append(bench.firmware.gate)
                bench.driver.read()
        _report(name, gates)


def images(tries: int) -> None:
    for host in (Pico(), Teensy()):
        rng, gates = random.Random(1), []
        for _ in range(tries):
            host.drive(*FASTEST)
            host.pass_ms(rng.randrange(20))
            host.commands = None
            host.pass_ms(330)
            assert host.board.voltages == (0, 0)
            health = host.health
            gates.append(Gate(host.status.latch, STOP, health.target_after_ms, health.output_after_ms))
        _report(type(host).__name__, gates)


def _death(number: signal.Signals | None, rng: random.Random, clock: SlowClock) -> Gate | None:
    """Let a driver drive at full speed in a process of its own, and die; return the gate when its wheels stand.

    None: it did not drive when it was to die, since this machine is too slow.
    """
    with tempfile.TemporaryDirectory() as folder:
        stand = TwinStand(uno_configured(), Path(folder), clock)
        firmware = stand.twin._firmware  # what the binary knows of its stop
        assert isinstance(firmware, ArduinoUnoFirmware)
        with stand.running():
            driver = os.fork()
            if driver == 0:
                _drive_for_ever(stand)
            _wait(lambda: firmware.gate.target != STOP, clock)
            stand.clock.sleep_until(stand.clock.now_ns() + round(rng.uniform(0.2, 0.3) * S))
            drives = firmware.gate.target != STOP
            if number is None:
                stand.unplugged.set()
            else:
                os.kill(driver, number)
            stands = not drives or _wait(
                lambda: firmware.gate.target == STOP and firmware.gate.output_after_ms >= 0, clock
            )
            os.kill(driver, signal.SIGKILL)
            os.waitpid(driver, 0)
        stand.twin.close()
        assert stands, "it drives on"
        return firmware.gate if drives else None


def _drive_for_ever(stand: TwinStand) -> None:
    """Be a driver's process: read a hundred times a second, write every third time."""
    try:
        driver = Rfp(stand.context(Rfp.Settings(port=str(stand.port), **UNO_SETTINGS)))
        while True:
            for k in range(3):
                driver.read()
                if k == 0:
                    driver.write(FASTEST)
                stand.clock.sleep_until(stand.clock.now_ns() + 10 * MS)
    finally:
        traceback.print_exc()
        os._exit(1)


def _wait(condition: Callable[[], bool], clock: SlowClock) -> bool:
    """Wait until a condition holds, or patience ends; return whether it holds."""
    until_ns = clock.now_ns() + _PATIENCE_NS
    while not (met := condition()) and clock.now_ns() < until_ns:
        WALL.sleep_until(WALL.now_ns() + 5 * MS)
    return met


# --- noise ---


class Noise:
    """One direction of a line; late lines are handed to ``deliver`` when it is asked."""

    def __init__(self, share: float, rng: random.Random, now_ns: Callable[[], int]) -> None:
        self.struck = 0
        self._share, self._rng, self._now_ns = share, rng, now_ns
        self._late: deque[tuple[int, bytes]] = deque()

    def __call__(self, line: bytes) -> bytes:
        rng, arrived = self._rng, bytearray(line)
        for k in range(len(arrived)):
            if rng.random() < self._share:
                arrived[k] ^= rng.randrange(1, 256)
        if rng.random() < self._share:
            del arrived[rng.randrange(len(arrived) + 1) :]
        if rng.random() < self._share:
            arrived *= 2
        late = rng.random() < self._share
        self.struck += late or bytes(arrived) != line
        if late:
            self._late.append((self._now_ns() + round(rng.uniform(0.0, _LATEST_S) * S), bytes(arrived)))
            return b""
        return bytes(arrived)

    def due(self) -> bytes:
        """Return what was late, and comes now."""
        lines = [line for at_ns, line in self._late if at_ns <= self._now_ns()]
        self._late = deque((at_ns, line) for at_ns, line in self._late if at_ns > self._now_ns())
        return b"".join(lines)


def _bench(board: str) -> tuple[LineBench, dict[str, Any]]:
    """Return a bench with this board, and its driver's settings."""
    if board == "uno":
        return uno_behind_its_driver(MS), UNO_SETTINGS
    return rfp(), {"counts_per_turn": COUNTS_PER_TURN}


class Watch:
    """Looks at a gate's target after each loop of its robot, and whenever that has received something.

    Attributes:
        commanded: What was written to the robot, and when; whoever writes fills it.
    """

    def __init__(self, bench: LineBench) -> None:
        self.commanded: deque[tuple[int, WheelSpeeds]] = deque()
        self._firmware, self._loop, self._looked_ns = bench.firmware, bench.firmware.loop, bench.now_ns
        self._wrong = self._moving_ns = self._standing_ns = 0
        bench.firmware.loop = self._looked_at

    def _looked_at(self, now_ns: int) -> bytes:
        answer: bytes = self._loop(now_ns)
        target, passed_ns = self._firmware.target, now_ns - self._looked_ns
        self._looked_ns = now_ns
        while self.commanded and self.commanded[0][0] < now_ns - REMEMBERED_NS:
            self.commanded.popleft()
        if target == STOP:
            self._standing_ns += passed_ns
        else:
            self._moving_ns += passed_ns
            if self._is_wrong(target) and isinstance(self._firmware, ArduinoUnoFirmware):
                self._firmware.board.run(BETWEEN_WRITES_CYCLES)
                target = self._firmware.target
            self._wrong += self._is_wrong(target)
        return answer

    def _is_wrong(self, target: WheelSpeeds) -> bool:
        return target != STOP and all(target != wheels for _, wheels in self.commanded)

    def __str__(self) -> str:
        times = f"moving {self._moving_ns / S:.0f} s, standing {self._standing_ns / S:.0f} s"
        return f"{self._wrong} looks at a wrong motion; {times}"


def noise(minutes: float, share: float, seed: int, board: str) -> None:
    rng = random.Random(seed)
    failures = k = 0
    made, settings = _bench(board)
    with made as bench:
        driver = bench.open(**settings)
        to_robot, to_driver = (Noise(share, rng, lambda: bench.now_ns) for _ in range(2))
        bench.to_robot, bench.to_driver = to_robot, to_driver
        watch = Watch(bench)
        reported_ns = bench.now_ns
        end_ns = bench.now_ns + round(minutes * 60 * S)

        def report() -> None:
            print(
                f"{board}, share {share:g}, seed {seed}: {to_robot.struck} lines to the robot "
                f"and {to_driver.struck} to the driver struck; {watch}; {failures} new drivers",
                flush=True,
            )

        while bench.now_ns < end_ns:
            if bench.now_ns >= reported_ns + 60 * S:
                reported_ns = bench.now_ns
                report()
            try:
                if driver is None:
                    driver = bench.open(**settings)
                if k % 3 == 0:
                    wheels = WheelSpeeds(*(rng.randrange(-2000, 4600) / 512.0 for _ in range(2)))
                    watch.commanded.append((bench.now_ns, wheels))
                    bench.write(*wheels)
                bench.read()
            except DriverError:
                failures += 1
                bench.driver.close()
                bench.driver = driver = None
            k += 1
            bench.let_pass(0.01)
            if late := to_robot.due():
                bench.say(bench.firmware.receive(late, bench.now_ns))
            if late := to_driver.due():
                bench.line.write(late)
    report()


# --- latency ---


def latency(tries: int) -> None:
    rng, step_ns, turn = random.Random(1), MS // 10, WheelSpeeds(5.0, 3.0)
    with uno_behind_its_driver(step_ns) as bench:
        bench.open(**UNO_SETTINGS)

        def took_ms(wheels: WheelSpeeds, arrived: Callable[[], bool]) -> float:
            bench.let_pass(rng.randrange(100) * step_ns / S)
            begin_ns = bench.now_ns
            bench.write(*wheels)
            while not arrived():
                bench.let_pass(step_ns / S)
            return (bench.now_ns - begin_ns) / MS

        pins, targets = [], []
        for _ in range(tries):
            bench.pass_time(0.2, STOP)
            pins.append(took_ms(WheelSpeeds(4.0, 4.0), lambda: bench.firmware.board.voltages != (0, 0)))
            bench.pass_time(0.05, WheelSpeeds(4.0, 4.0))
            targets.append(took_ms(turn, lambda: bench.firmware.gate.target == turn))
    for name, times in (("from rest, to the pins", pins), ("in motion, to the gate's target", targets)):
        cuts = statistics.quantiles(times, n=100)
        print(f"{name}: median {cuts[49]:.1f} ms, p99 {cuts[98]:.1f} ms, worst {max(times):.1f} ms")


# --- resets ---


def resets(tries: int) -> None:
    lost, moved, causes = [], 0, {Reset.BROWN_OUT: 0, Reset.WATCHDOG: 0}
    for k in range(tries):
        after_ms = k * 100 // tries
        uno = Uno()
        uno.drive(9.0, 9.0)
        latched_by_an_emergency_stop(uno)
        uno.pass_ms(8)  # it hears of it
        uno.pass_ms(after_ms)
        uno.board.reset(Reset.BROWN_OUT, seed=k)
        moved += _moves(uno)
        causes[Reset.BROWN_OUT] += uno.health.reset == Reset.BROWN_OUT
        if uno.status.latch == 0:
            lost.append(after_ms)
        uno = Uno()
        uno.drive(9.0, 9.0)
        uno.pass_ms(k % 20)
        where = hang(uno)
        uno.commands = None
        uno.pass_ms(200)
        uno.board.flash[where] = SLEEP
        moved += _moves(uno) or uno.status.gate != NO_LEASE
        causes[Reset.WATCHDOG] += uno.health.reset == Reset.WATCHDOG
    print(f"power failed {tries} times in the 100 ms after an emergency stop: {len(lost)} latches lost {lost}")
    reasons = ", ".join(f"{cause.name}: {count} of {tries}" for cause, count in causes.items())
    print(f"moved after a reset: {moved}; said why: {reasons}")


def _moves(uno: Uno) -> bool:
    """Let it start, while the host commands as before; returns whether it moved."""
    voltages = set()
    uno.commands = 9.0, 9.0
    uno.pass_ms(400, lambda: voltages.add(uno.board.voltages))
    return voltages != {(0, 0)}


def main() -> None:
    parser = program(__doc__, tries=100, slower=1.0, minutes=10.0, share=0.01, seed=1)
    parser.add_argument("what", choices=("deaths", "silences", "images", "noise", "latency", "resets"))
    parser.add_argument("--board", choices=("uno", "host"), default="uno")
    arguments = parser.parse_args()
    if arguments.what == "deaths":
        deaths(arguments.tries, arguments.slower)
    elif arguments.what == "noise":
        noise(arguments.minutes, arguments.share, arguments.seed, arguments.board)
    else:
        {"silences": silences, "images": images, "latency": latency, "resets": resets}[arguments.what](arguments.tries)


if __name__ == "__main__":
    main()
