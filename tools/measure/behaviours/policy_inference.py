"""How long a policy takes in the ticks of a real run: four robots, a network of 2 x 64 units, real processes.

    python -m tools.measure.behaviours.policy_inference --seconds 30

``inference`` is the network with its normalisation; ``deciding`` is that, and the observation, the reward and the rest
of the behaviour.
"""

import itertools
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from robofleet.behaviours.interface import Decision, Figure, Situation
from robofleet.core.arrays import Array, Array32
from robofleet.core.clock import S, stopwatch_ns
from robofleet.policies import described
from robofleet.policies.policy import PolicyBehaviour
from robofleet.recording.reading import imported, read
from robofleet.recording.run import Run
from tests.policies.small_policies import go_to, laboratory, network, saved
from tools.measure.program import program

HIDDEN = 64


class Timed(PolicyBehaviour):
    """The behaviour ``policy``, with a stopwatch."""

    figures = (*PolicyBehaviour.figures, Figure("inference", "s"), Figure("deciding", "s"))

    def decide(self, now: Situation) -> Decision:
        act, took_ns = self.policy.act, 0

        def timed(observations: Array32) -> Array:
            nonlocal took_ns
            began_ns = stopwatch_ns()
            actions = act(observations)
            took_ns = stopwatch_ns() - began_ns
            return actions

        self.policy.act = timed  # type: ignore[method-assign]
        began_ns = stopwatch_ns()
        decision = super().decide(now)
        deciding_ns = stopwatch_ns() - began_ns
        del self.policy.act
        return decision._replace(figures={**decision.figures, "inference": took_ns / S, "deciding": deciding_ns / S})


def main() -> None:
    arguments = program(__doc__, seconds=(30.0, "of the run")).parse_args()
    task, rng = go_to(), np.random.default_rng(1)
    inputs = sum(term.size for term in task.terms)
    sizes = (inputs, HIDDEN, HIDDEN, 2)
    layers = [rng.normal(0.0, 0.7 / np.sqrt(m), (m, n)) for m, n in itertools.pairwise(sizes)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        saved(folder / "go_to.onnx", network(*layers), described(task, mean=np.zeros(inputs), variance=np.ones(inputs)))
        changes = f"groups.0.behaviour={__spec__.name}:Timed", f"run.duration_s={arguments.seconds}"
        options = [word for change in changes for word in ("--set", change)]
        command = [sys.executable, "-m", "robofleet", "run", str(laboratory(folder)), "--out", str(folder / "run")]
        subprocess.run([*command, *options], check=True)
        (group,) = Run(read(folder / "run", lambda behaviour: imported(Path.cwd(), behaviour))).parts
    for figure in ("inference", "deciding"):
        took_us = 1e6 * group.past.figures[figure][:, 0]
        p50, p99, most = np.nanpercentile(took_us, (50, 99, 100))
        print(f"{figure:<10} p50 {p50:6.0f}  p99 {p99:6.0f}  max {most:6.0f} us of {np.isfinite(took_us).sum()} ticks")


if __name__ == "__main__":
    main()
