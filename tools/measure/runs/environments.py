"""How many robot-steps a second environments make, in turns with others, and how long a reset of one arena takes.

    python -m tools.measure.runs.environments [--arenas 1024] [--vmas PYTHON] [--jaxrobotarium PYTHON]

Random actions for four robots of the shipped platoon's configuration, of the task go_to. ``--vmas`` names the Python
of an environment in which VMAS and torch are installed (``pip install vmas``): its scenario ``navigation`` with as many
robots. ``--jaxrobotarium`` names one that finds ``jaxrobotarium`` and ``rps_jax`` (github.com/GT-STAR-Lab/JaxRobotarium
and its simulator), flax, chex, jaxopt and JAX 0.5: its ``navigation``, one step of the simulator at a time, without and
with its ``robust_barriers``. The numbers are of wall time, and of CPU time of one core.
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
_JAXROBOTARIUM = """
import sys, time, jax, jax.numpy as jnp
from jaxrobotarium.scenarios.navigation import Navigation
arenas, steps, barrier = map(int, sys.argv[1:])
controller = {"controller": None, "barrier_fn": "robust_barriers" if barrier else None}
env = Navigation(4, action_type="Continuous", max_steps=1000, update_frequency=1, controller=controller)
step, keys = jax.jit(jax.vmap(env.step)), jax.random.split(jax.random.key(0), arenas)
_, state = jax.jit(jax.vmap(env.reset))(keys)
actions = jax.random.uniform(jax.random.key(1), (8, 4, arenas, 2), minval=-1.0) * jnp.array([0.2, 3.8])
actions = [{f"agent_{i}": actions[k, i] for i in range(4)} for k in range(8)]
for k in range(5):
    state = jax.block_until_ready(step(keys, state, actions[k % 8])[1])
wall, cpu = time.perf_counter(), time.process_time()
for k in range(steps):
    state = step(keys, state, actions[k % 8])[1]
jax.block_until_ready(state)
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


def other(python: str, program: str, *numbers: int) -> Times:
    words = [python, "-c", program, *map(str, numbers)]
    done = subprocess.run(words, capture_output=True, text=True, check=True, env={**os.environ, "PYTHONPATH": ""})
    wall, cpu = map(float, done.stdout.split()[-2:])
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
    parser = program(
        __doc__, arenas=1024, steps=60, laps=5, vmas=("", "the Python that has VMAS"),
        jaxrobotarium=("", "the Python that has JaxRobotarium"),
    )  # fmt: skip
    given = parser.parse_args()
    rows: dict[str, Callable[[], Times]] = {
        "arenas, barrier": lambda: arenas(given.arenas, given.steps, barrier=True, whole=False),
        "arenas, no barrier": lambda: arenas(given.arenas, given.steps, barrier=False, whole=False),
        "environment, barrier": lambda: arenas(given.arenas, given.steps, barrier=True, whole=True),
        "environment, no barrier": lambda: arenas(given.arenas, given.steps, barrier=False, whole=True),
    }
    if given.vmas:
        cores = len(os.sched_getaffinity(0))
        rows["VMAS, 1 core"] = lambda: other(given.vmas, _VMAS, given.arenas, given.steps, 1)
        rows["VMAS"] = lambda: other(given.vmas, _VMAS, given.arenas, given.steps, cores)
    if given.jaxrobotarium:
        python = given.jaxrobotarium
        rows["JaxRobotarium, barrier"] = lambda: other(python, _JAXROBOTARIUM, given.arenas, given.steps, 1)
        rows["JaxRobotarium, no barrier"] = lambda: other(python, _JAXROBOTARIUM, given.arenas, given.steps, 0)
    found: dict[str, list[Times]] = {name: [] for name in rows}
    for lap in range(given.laps):
        for name, measure in rows.items():
            found[name].append(measure())
        print(f"lap {lap + 1} of {given.laps}", file=sys.stderr)
    done = given.arenas * _ROBOTS * given.steps
    print(f"{_ROBOTS} robots x {given.arenas} arenas, {os.cpu_count()} cores, {given.laps} laps in turns")
    print(f"{'':25s}  robot-steps a second (median, best)   a CPU second (median, best)")
    for name, times in found.items():
        wall, cpu = done / np.array(times).T
        print(f"{name:25s} {np.median(wall):12,.0f} {wall.max():12,.0f} {np.median(cpu):17,.0f} {cpu.max():12,.0f}")
    print(f"a reset of one arena among {given.arenas}: {resets(given.arenas, 200):.2f} ms (median)")


if __name__ == "__main__":
    main()
