"""The Robotarium's own simulator, with its barrier: prints its CPU time for a simulated second [s].

    ROBOTARIUM=CHECKOUT .venv/bin/python tools/bench.py

runs this with CHECKOUT/.venv/bin/python where there is one, since the simulator needs packages that this project does
not need (cvxopt, matplotlib). It breaks beyond 22 robots. Poses are exact there: it has no camera, filter or gates.
"""

import sys
import time  # noqa: TID251 - this project is not installed where the simulator is

import numpy as np
from rps.robotarium import Robotarium
from rps.utilities.barrier_certificates import create_uni_barrier_certificate_with_boundary

_STEP_S = 0.033
_WARM, _STEPS = 30, 150


def main(count: int) -> None:
    """Let so many robots drive circles."""
    columns = int(np.ceil(np.sqrt(count * 1.6)))
    row, column = np.divmod(np.arange(count), columns)
    starts = np.vstack([column * 2.4 / max(1, columns - 1) - 1.2, row * 0.38 - 0.6, np.zeros(count)])
    simulator = Robotarium(
        number_of_robots=count, show_figure=False, sim_in_real_time=False, skip_initialization=True,
        initial_conditions=starts,
    )  # fmt: skip
    barrier = create_uni_barrier_certificate_with_boundary()
    circles = np.vstack([np.full(count, 0.08), np.full(count, 0.4)])
    began_s = 0.0
    for step in range(_WARM + _STEPS):
        if step == _WARM:
            began_s = time.process_time()
        simulator.set_velocities(np.arange(count), barrier(circles, simulator.get_poses()))
        simulator.step()
    print((time.process_time() - began_s) / (_STEPS * _STEP_S))


main(int(sys.argv[1]))  # nobody imports it: bench_scale.py runs it
