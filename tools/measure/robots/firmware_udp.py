"""What rfp/1 over UDP takes and stands: the firmware compiled for this computer, on real sockets.

    python -m tools.measure.robots.firmware_udp lines [--tries 2000]
    python -m tools.measure.robots.firmware_udp deaths [--tries 20]
    python -m tools.measure.robots.firmware_udp noise [--minutes 10] [--share 0.05] [--seed 1]

lines: real time: from a driver's write until the robot's end has its command, and back; on loopback and on a
  pseudo-terminal, without a baud rate.
deaths: real time: robot and driver are processes; the driver is killed (``kill -9``) at full speed. Times are the
  firmware's own: from the issue of the newest nonce on.
noise: virtual time. Of the datagrams that share each is lost, doubled, up to 0.5 s late and struck, both ways. A motion
  is wrong if the gate's target is neither zero nor one that was commanded in the last 125 ms, in that order.
"""

import os
import select
import signal
import statistics
import tempfile
from collections import deque
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

from robofleet.core.clock import MS, WallClock
from robofleet.drivers.serial_port import SerialPort
from robofleet.drivers.udp_port import UdpPort
from robofleet.simulation.serial_line import SerialLine
from robofleet.simulation.udp_line import UdpLine
from robofleet.vehicles.interface import STOP, WheelSpeeds
from tests.drivers.network_bench import NetworkBench
from tests.drivers.test_rfp import driven
from tests.drivers.test_rfp_udp import Disturbed, Robot, until
from tests.endpoints import free_port
from tools.measure.program import program

_COMMAND = b"\0" + b"\x06\x10\xe9\xff\xb5\xcf\x00" + bytes(50)  # a frame of a host, and as long as a command
_STATUS = b"\x01" * 35 + b"\0"
_WALL = WallClock()


def lines(tries: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        pty = SerialLine(Path(folder) / "pty")
        url = f"udp://127.0.0.1:{free_port()}"
        udp = UdpLine(url, lambda: _WALL.now_ns() // 1000 % 2**32)
        for name, port, line in (
            ("pseudo-terminal", SerialPort(str(Path(folder) / "pty"), 57600), pty), ("UDP", UdpPort(url), udp)
        ):  # fmt: skip
            _measure(name, port, line, tries)
            port.close()
            line.unplug()


def _measure(name: str, port: Any, line: Any, tries: int) -> None:
    out, back = [], []
    for _ in range(tries):
        out.append(_took_us(lambda: port.write(_COMMAND), line.read, lambda: line.descriptor))
        back.append(_took_us(lambda: line.write(_STATUS), port.read, lambda: port.descriptor))
    for way, times in (("to the robot", out), ("from the robot", back)):
        cuts = statistics.quantiles(times, n=100)
        print(f"{name}, {way}: median {cuts[49]:.0f} us, p99 {cuts[98]:.0f} us")


def _took_us(send: Callable[[], None], read: Callable[[], bytes], descriptor: Callable[[], Any]) -> float:
    begin_ns = _WALL.now_ns()
    send()
    while not read():
        if descriptor() is not None:
            select.select([descriptor()], [], [], 1.0)
    return (_WALL.now_ns() - begin_ns) * 1e-3


def deaths(tries: int) -> None:
    after = []
    with tempfile.TemporaryDirectory() as folder:
        robot = Robot(Path(folder))
        try:
            for _ in range(tries):
                child = os.fork()
                if child == 0:
                    driver = robot.driver()
                    while True:
                        driver.write(WheelSpeeds(9.0, 9.0))
                        driver.read()
                        _WALL.sleep_until(_WALL.now_ns() + 5 * MS)
                until(lambda: robot.pins.duty[0] > 600)
                os.kill(child, signal.SIGKILL)
                os.waitpid(child, 0)
                until(lambda: list(robot.pins.duty) == [0, 0])
                driver = robot.driver()
                assert driver._health is not None
                after.append((driver._health.target_after_ms, driver._health.output_after_ms))
                driver.close()
        finally:
            robot.close()
    for name, times in zip(("target", "output"), zip(*after, strict=True), strict=True):
        print(f"zero {name}: {min(times)} to {max(times)} ms after the newest nonce, {tries} tries")


def noise(minutes: float, share: float, seed: int) -> None:
    random = Random(seed)
    steps = moved = wrong = 0
    with NetworkBench() as bench:
        driven(bench)
        bench.fate = Disturbed(random, share)
        given = deque([(bench.now_ns, STOP)])
        gate = bench.firmware.robot.gate
        while steps < minutes * 12000:
            steps += 1
            wheels = WheelSpeeds(*(random.randrange(-2500, 2500) / 512 for _ in range(2)))
            given.append((bench.now_ns, wheels))
            bench.write(*wheels)
            bench.let_pass(0.005)
            bench.read()
            target = WheelSpeeds(gate.target_left / 512, gate.target_right / 512)
            if target == STOP:
                continue
            moved += 1
            commanded = [k for k, (_, wheels) in enumerate(given) if wheels == target]
            if not commanded or bench.now_ns - given[commanded[0]][0] > 125 * MS:
                wrong += 1
            else:
                for _ in range(commanded[0]):
                    given.popleft()
        struck = bench.firmware.robot.receiver.struck
    print(
        f"{steps} steps, {struck} struck frames at the robot, {wrong} wrong motions; stood for {1 - moved / steps:.1%}"
    )


def main() -> None:
    parser = program(__doc__, tries=20, minutes=10.0, share=0.05, seed=1)
    parser.add_argument("what", choices=("lines", "deaths", "noise"))
    arguments = parser.parse_args()
    if arguments.what == "noise":
        noise(arguments.minutes, arguments.share, arguments.seed)
    else:
        {"lines": lines, "deaths": deaths}[arguments.what](arguments.tries)


if __name__ == "__main__":
    main()
