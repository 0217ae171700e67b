"""What a bad line makes a Create 2 do: ``python -m tools.measure.robots.create2_noise [--runs N] [--share S]``.

20 s a run, on the test's clock; a share of the lines each way is cut, and a share garbled. Wrong is a motion that was
not commanded in the last 0.3 s.
"""

import math

import numpy as np

from robofleet.core.clock import MS, S
from robofleet.simulation.faulty_line import cut, garbled
from robofleet.vehicles.interface import STOP, DriverError, WheelSpeeds
from tests.drivers.line_bench import MM_S, create2
from tools.measure.program import program

_STEP_NS = 11 * MS  # a third of a tick
_TICKS = 600
_REMEMBERED = 9  # ticks


class Count:
    """Wrong motions, each by how many steps it lasted."""

    def __init__(self) -> None:
        self.lasted: list[int] = []
        self._wrong = False

    def look(self, wrong: bool) -> None:
        if wrong and not self._wrong:
            self.lasted.append(0)
        if wrong:
            self.lasted[-1] += 1
        self._wrong = wrong


def drive(seed: int, share: float, count: Count) -> str:
    """Drive for 20 s; returns why it ended before, or nothing."""
    rng = np.random.default_rng(seed)

    def spoil(line: bytes) -> bytes:
        for trouble in (cut, garbled):
            if line and rng.random() < share:
                line = trouble(line, rng)
        return line

    with create2() as bench:
        bench.open()
        bench.to_robot = bench.to_driver = spoil
        commands: dict[tuple[int, int], int] = {}
        try:
            for tick in range(_TICKS):
                wheels = WheelSpeeds(5.0 + 2.0 * math.sin(0.033 * tick), 5.0 + 2.0 * math.cos(0.023 * tick))
                bench.write(*wheels)
                commands[_mm_s(wheels)] = tick
                for _ in range(3):
                    bench.let_pass(_STEP_NS / S)
                    if bench.read().faults:
                        return f"run {seed}: fault {bench.read().faults}"
                    now = bench.hardware.command
                    count.look(now != STOP and commands.get(_mm_s(now), -_REMEMBERED) <= tick - _REMEMBERED)
        except DriverError as error:
            return f"run {seed}: {error}"
    return ""


def _mm_s(wheels: WheelSpeeds) -> tuple[int, int]:
    return round(wheels.left / MM_S), round(wheels.right / MM_S)


def main() -> None:
    arguments, count = program(__doc__, runs=20, share=0.01).parse_args(), Count()
    ended = [why for why in (drive(seed, arguments.share, count) for seed in range(arguments.runs)) if why]
    print(f"{arguments.runs - len(ended)} of {arguments.runs} runs went on to their end", *ended, sep="\n")
    lasted_ms = [lasted * _STEP_NS / MS for lasted in count.lasted] or [0.0]
    print(f"{len(count.lasted)} wrong motions, of {np.mean(lasted_ms):.0f} ms, at most {max(lasted_ms):.0f} ms")


if __name__ == "__main__":
    main()
