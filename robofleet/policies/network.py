"""A policy that acts: observations are normalised and go through its network, on one thread of the CPU."""

import re
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from robofleet.core.arrays import Array, Array32
from robofleet.core.clock import S, stopwatch_ns
from robofleet.core.refusal import need_extra
from robofleet.policies.description import Description, PolicyError, pinned, read_policy, split

if TYPE_CHECKING:
    from onnxruntime import InferenceSession

_EPSILON = 1e-8  # beside the variance, as stable-baselines3 has it
_RAISED_BY = re.compile(r"^\[ONNXRuntimeError\] : \d+ : \w+ : (/\S+:\d+ .*?\) (?=[A-Z]))?")  # a C++ function
_LONGEST = 300  # characters of a complaint
_TIMED = 5  # decisions
_NO_FOLDER = "/dev/null"  # weights in further files are looked for there: they are in no digest


class Policy:
    """A trained policy, in an environment and in a run. It has no state.

    Attributes:
        description: What it observes, and what its actions mean.
    """

    def __init__(self, description: Description, network: "InferenceSession") -> None:
        """Keep what ``load_policy`` found."""
        self.description, self._network = description, network
        self._name = network.get_inputs()[0].name
        normalisation = description.normalisation
        if normalisation is not None:
            self._mean, self._clip = np.array(normalisation.mean), normalisation.clip
            self._deviation = np.sqrt(np.array(normalisation.variance) + _EPSILON)

    def act(self, observations: Array32) -> Array:
        """Decide.

        Args:
            observations: (A, N, F) as ``observed`` returns them, of A arenas with N robots each.

        Returns:
            Actions (A, N, 2): v and omega as shares of the top speeds, which ``velocities`` takes. NaN where the
            network's are not finite.

        Raises:
            ValueError: The network is for other numbers of robots or of observations.
        """
        arenas, robots, _ = observations.shape
        rows = arenas if self.description.form == "group" else arenas * robots
        inputs = observations.reshape(rows, -1)
        if inputs.shape[1] != self.description.inputs:
            raise ValueError(f"observations {observations.shape}: a row needs {self.description.inputs} numbers")
        if self.description.normalisation is not None:
            inputs = np.clip((inputs - self._mean) / self._deviation, -self._clip, self._clip)
        found = self._network.run(None, {self._name: inputs.astype(np.float32)})[0]
        if found.shape != (rows, self.description.outputs):
            raise ValueError(f"the network returned {found.shape}, not {(rows, self.description.outputs)}")
        actions = found.astype(np.float64).reshape(arenas, robots, 2)
        return np.where(np.isfinite(actions), actions, np.nan)


def load_policy(file: Path | str) -> Policy:
    """Load a policy from its two files.

    Args:
        file: The network (.onnx); its JSON stands beside it. A name that is pinned must still have the same content.

    Returns:
        The policy. One of the same content is loaded once.

    Raises:
        PolicyError: A file is missing, damaged, too large, of another version, or not what the name is pinned to.
        RefusedError: ``onnxruntime`` is not installed.
    """
    return _loaded(pinned(str(file), Path()))


@lru_cache(maxsize=8)
def _loaded(name: str) -> Policy:
    need_extra("policy", "onnxruntime")
    contents, (path, _) = read_policy(name), split(name)
    network, d = _session(path, contents.network), contents.description
    for word, ends, size in (("input", network.get_inputs(), d.inputs), ("output", network.get_outputs(), d.outputs)):
        if len(ends) != 1 or ends[0].type != "tensor(float)" or not _fits(ends[0].shape, size):
            found = ", ".join(f"{end.type} {end.shape}" for end in ends) or "none"
            raise PolicyError(
                f"{path}: its {word} is {found}, and its JSON says tensor(float) (batch, {size}): export it with one "
                f"{word}, and a first axis of any length"
            )
    return Policy(d, network)


def inference_s(policy: Policy, robots: int) -> float:
    """Return how long a decision for so many robots takes at least [s]."""
    observations = np.zeros((1, robots, sum(term.size for term in policy.description.terms)), dtype=np.float32)
    took_ns = []
    for _ in range(_TIMED):
        began_ns = stopwatch_ns()
        policy.act(observations)
        took_ns.append(stopwatch_ns() - began_ns)
    return min(took_ns) / S


def _fits(shape: Sequence[int | str | None], size: int) -> bool:
    """Whether a tensor is (batch, size), as far as it says."""
    return len(shape) == 2 and not isinstance(shape[0], int) and (shape[1] == size or not isinstance(shape[1], int))


def _session(file: Path, network: bytes) -> "InferenceSession":
    import onnxruntime  # noqa: PLC0415 - it takes a tenth of a second to load

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4  # what is wrong is raised, too
    options.use_deterministic_compute = True
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", _NO_FOLDER)
    try:
        return onnxruntime.InferenceSession(network, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise PolicyError(f"{file}: {_what_is_wrong(str(error))}") from error


def _what_is_wrong(error: str) -> str:
    """Return onnxruntime's complaint in a line, with its cure."""
    import onnxruntime  # noqa: PLC0415

    if "protobuf" in error:
        return "is no ONNX file, or damaged: export it again"
    if "External data" in error:
        return "its weights are in another file: export it with all weights in one (external_data=False)"
    why = " ".join(_RAISED_BY.sub("", error).split())
    mend = "export it with an older opset, say 17"
    return f"onnxruntime {onnxruntime.__version__} cannot run it: {why[:_LONGEST]}: {mend}"
