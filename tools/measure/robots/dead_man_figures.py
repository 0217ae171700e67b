"""How soon a dead man stops a robot, and its cost: ``python -m tools.measure.robots.dead_man_figures [--times N]``."""

import select
import signal
import statistics

from robofleet.core.clock import S, WallClock
from tests.drivers.test_dead_man import STOP, Bench
from tools.measure.program import program

_COST_S = 10.0


def main() -> None:
    times = program(__doc__, times=20).parse_args().times
    for name, number in (("killed", signal.SIGKILL), ("stopped", signal.SIGSTOP)):
        took_ms = sorted(_took_ms(number) for _ in range(times))
        median, worst = statistics.median(took_ms), took_ms[-1]
        print(f"driver {name}: stop after {median:.0f} ms (median), {worst:.0f} ms (of {times})")
    bench = Bench("for ever")
    try:
        bench.hear(b".....")
        before = sum(bench.dead_man.cpu_times()[:2])
        began_ns = WallClock().now_ns()
        while WallClock().now_ns() - began_ns < _COST_S * S:
            bench.hear(b".....")
        share = (sum(bench.dead_man.cpu_times()[:2]) - before) / _COST_S
        memory = bench.dead_man.memory_full_info()
        print(f"cost: {share:.2%} of a core, {memory.rss / 1e6:.1f} MB resident, {memory.uss / 1e6:.1f} MB its own")
    finally:
        bench.close()


def _took_ms(number: signal.Signals) -> float:
    bench = Bench("for ever")
    try:
        bench.hear(b".....")
        select.select([], [], [], 0.3)
        began_ns = WallClock().now_ns()
        bench.driver.send_signal(number)
        bench.hear(STOP)
        return (WallClock().now_ns() - began_ns) * 1e-6
    finally:
        bench.close()


if __name__ == "__main__":
    main()
