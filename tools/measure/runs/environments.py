"""How many robot-steps a second environments make, in turns with VMAS, and how long a reset of one arena takes.

    python -m tools.measure.runs.environments [--arenas 1024] [--vmas PYTHON]

Random actions for four robots of the shipped platoon's configuration, of the task go_to. ``--vmas`` names the Python
of an environment in which VMAS and torch are installed (``pip install vmas``): its scenario ``navigation`` with as many
robots. The numbers are of wall time, and of CPU time of one core.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import numpy as np

from robofleet.config.load import load_config
from robofleet.core.clock import S, cpu_ns, stopwatch_ns
from robofleet.envs import Episodes, vector_env
from tools.measure.program import program

_PLATOON = Path(__file__).parents[3] / "configs" / "platoon.yaml"
_ROBOTS = 4
_WARM = 5  # steps before the clock runs
_VMAS = """
import sys, time, torch, vmas
arenas, steps, threads = map(int, sys.argv[1:])
torch.set_num_threads(threads)
env = vmas.make_env("navigation", num_envs=arenas, n_agents=4, device="cpu", continuous_actions=True, seed=0)
env.reset()
actions = [[torch.rand(arenas, 2) * 2 - 1 for _ in range(4)] for _ in range(8)]
for k in range(5):
    env.step(actions[k % 8])
wall, cpu = time.perf_counter(), time.process_time()
for k in range(steps):
    env.step(actions[k % 8])
print(time.perf_counter() - wall, time.process_time() - cpu)
"""

Times = tuple[float, float]  # wall, and of the CPU [s]


def timed(step: Callable[[int], object], steps: int) -> Times:
    for k in range(_WARM):
        step(k)
    wall_ns, began_ns = stopwatch_ns(), cpu_ns()
    for k in range(steps):
        step(k)
    return (stopwatch_ns() - wall_ns) / S, (cpu_ns() - began_ns) / S


def arenas(count: int, steps: int, *, barrier: bool, whole: bool) -> Times:
    """Return the times of steps: of the arenas alone, or of the vectorised environment with all that it does."""
    rng, config = np.random.default_rng(0), load_config(_PLATOON)
    actions = rng.uniform(-1.0, 1.0, (8, count * _ROBOTS, 2)).astype(np.float32)
    if whole:
        with closing(vector_env(config, "go_to", arenas=count, barrier=barrier)) as env:
            env.reset(seed=1)
            return timed(lambda k: env.step(actions[k % 8]), steps)
    episodes = Episodes(config, "go_to", arenas=count, barrier=barrier)
    with closing(episodes):
        episodes.reset()
        commands = actions.reshape(8, count, _ROBOTS, 2) * np.array([0.2, 3.8])
        of_body = np.ones(_ROBOTS, dtype=np.bool_)
        return timed(lambda k: episodes.arenas.step(commands[k % 8], of_body), steps)


def vmas(python: str, count: int, steps: int, threads: int) -> Times:
    words = [python, "-c", _VMAS, str(count), str(steps), str(threads)]
    done = subprocess.run(words, capture_output=True, text=True, check=True, env={**os.environ, "PYTHONPATH": ""})
    wall, cpu = map(float, done.stdout.split())
    return wall, cpu


def resets(count: int, times: int) -> float:
    """Return the median time of a reset of one arena among many [ms]."""
    with closing(Episodes(_PLATOON, "go_to", arenas=count)) as episodes:
        episodes.reset()
        took = []
        for k in range(times):
            began_ns = stopwatch_ns()
            episodes.begin(np.array([k % count]))
            took.append(stopwatch_ns() - began_ns)
    return float(np.median(took)) / 1e6


def main() -> None:
    parser = program(__doc__, arenas=1024, steps=60, laps=5, vmas=("", "the Python that has VMAS"))
    given = parser.parse_args()
    rows: dict[str, Callable[[], Times]] = {
        "arenas, barrier": lambda: arenas(given.arenas, given.steps, barrier=True, whole=False),
        "arenas, no barrier": lambda: arenas(given.arenas, given.steps, barrier=False, whole=False),
        "environment, barrier": lambda: arenas(given.arenas, given.steps, barrier=True, whole=True),
        "environment, no barrier": lambda: arenas(given.arenas, given.steps, barrier=False, whole=True),
    }
    if given.vmas:
        rows["VMAS, navigation, 1 core"] = lambda: vmas(given.vmas, given.arenas, given.steps, 1)
        rows["VMAS, navigation"] = lambda: vmas(given.vmas, given.arenas, given.steps, len(os.sched_getaffinity(0)))
    found: dict[str, list[Times]] = {name: [] for name in rows}
    for lap in range(given.laps):
        for name, measure in rows.items():
            found[name].append(measure())
        print(f"lap {lap + 1} of {given.laps}", file=sys.stderr)
    done = given.arenas * _ROBOTS * given.steps
    print(f"{_ROBOTS} robots x {given.arenas} arenas, {os.cpu_count()} cores, {given.laps} laps in turns")
    print(f"{'':24s}  robot-steps a second (median, best)   a CPU second (median, best)")
    for name, times in found.items():
        wall, cpu = done / np.array(times).T
        print(f"{name:24s} {np.median(wall):12,.0f} {wall.max():12,.0f} {np.median(cpu):17,.0f} {cpu.max():12,.0f}")
    print(f"a reset of one arena among {given.arenas}: {resets(given.arenas, 200):.2f} ms (median)")


if __name__ == "__main__":
    main()
