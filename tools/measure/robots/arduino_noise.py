"""What bad lines make an Arduino do: ``python -m tools.measure.robots.arduino_noise [--runs N] [--share S] [KIND]...``

20 s a run, on the test's clock; of each kind of trouble (``line_cut line_garbage line_late``: all of them) a share of
the lines each way. A wrong motion is a target that was not commanded in the last 0.3 s.
"""

import math
from typing import Literal, get_args

from robofleet.config.troubles import LineFault
from robofleet.testing import DriverBench
from robofleet.vehicles.interface import STOP, DriverError, WheelSpeeds
from tests.drivers.test_contract import TestArduinoBridge
from tools.measure.program import program

_Kind = Literal["line_cut", "line_garbage", "line_late"]
_KINDS: tuple[_Kind, ...] = get_args(_Kind)
_COMMANDS, _PERIOD_S = 667, 0.03


def drive(seed: int, faults: list[LineFault]) -> tuple[str, int, float, float]:
    """Drive for 20 s; returns why it ended before, wrong motions, the furthest [rad/s] and the longest [ms] of them."""
    bench = DriverBench(TestArduinoBridge.subject, *faults)
    run = bench.config.run.model_copy(update={"seed": seed})
    bench.config = bench.config.model_copy(update={"run": run})
    with bench:
        bench.make()
        bench.drive(STOP, 0.1)
        bench.strike()
        why = ""
        try:
            for k in range(_COMMANDS):
                t = _PERIOD_S * k
                bench.drive(WheelSpeeds(5.0 + 2.0 * math.sin(t), 5.0 + 2.0 * math.cos(0.7 * t)), _PERIOD_S)
        except DriverError as error:
            why = f"run {seed}: {error}"
        assert bench.twin is not None
        assert bench.twin.ledger is not None
        ledger = bench.twin.ledger
        return why, ledger.wrong, ledger.furthest, ledger.longest_ns * 1e-6


def main() -> None:
    parser = program(__doc__, runs=20, share=0.01)
    parser.add_argument("kinds", nargs="*", choices=[[], *_KINDS], metavar="KIND")
    arguments = parser.parse_args()
    faults = [LineFault(kind=kind, at_s=0.0, share=arguments.share) for kind in arguments.kinds or _KINDS]
    ends, wrong, furthest, longest = zip(*(drive(seed, faults) for seed in range(arguments.runs)), strict=True)
    ended = [why for why in ends if why]
    print(f"{arguments.runs - len(ended)} of {arguments.runs} runs went on to their end", *ended, sep="\n")
    print(f"{sum(wrong)} wrong motions, at most {max(furthest):.1f} rad/s off and {max(longest):.0f} ms long")


if __name__ == "__main__":
    main()
