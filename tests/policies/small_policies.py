"""Policies made by hand: networks of one layer, and a configuration of four robots that one of them drives to goals."""

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from onnx import TensorProto, helper, numpy_helper

from robofleet.core.arrays import Array
from robofleet.policies import Description, Task, described, save_policy
from robofleet.policies.interface import load_task, width
from robofleet.testing.behaviours import team

GOALS = {"r1": (0.8, 0.5), "r2": (0.8, -0.5), "r3": (-0.8, 0.5), "r4": (-0.8, -0.5)}
STARTS = {"r1": (-0.8, 0.6, 0), "r2": (-0.8, -0.6, 0), "r3": (0.2, 0.2, 180), "r4": (0.2, -0.2, 180)}
SETTINGS: dict[str, Any] = {"goals": {robot: {"x_m": x, "y_m": y, "heading_deg": 0} for robot, (x, y) in GOALS.items()}}


def go_to(robots: int = 4, **settings: Any) -> Task:
    kind = load_task("go_to")
    return kind(kind.Settings.model_validate(settings), team(robots), 1)


def network(*weights: Array, opset: int = 17, ir: int = 8, batch: str | int = "batch") -> bytes:
    """Return a network of layers x W with tanh between them, as ONNX."""
    nodes, value = [], "observation"
    for k in range(len(weights)):
        if k:
            nodes.append(helper.make_node("Tanh", [value], [value := f"tanh{k}"]))
        nodes.append(helper.make_node("MatMul", [value, f"W{k}"], [value := f"layer{k}"]))
    kept = [numpy_helper.from_array(each.astype(np.float32), f"W{k}") for k, each in enumerate(weights)]
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [batch, size])
        for name, size in (("observation", weights[0].shape[0]), (value, weights[-1].shape[1]))
    ]
    graph = helper.make_graph(nodes, "policy", ends[:1], ends[1:], kept)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)])
    model.ir_version = ir
    found: bytes = model.SerializeToString()
    return found


def column(name: str) -> int:
    """Return where a term of the task go_to begins in what a robot observes."""
    terms = go_to().terms
    return sum(term.size for term in terms[: [term.name for term in terms].index(name)])


def to_goal(task: Task) -> Array:
    """Return the weights of a proportional law: forwards by the goal's x, turning by its y, in the robot's frame."""
    weights = np.zeros((width(task), 2))
    weights[0, 0] = weights[1, 1] = 3.0
    return weights


def saved(file: Path, content: bytes | None = None, description: Description | None = None) -> Path:
    """Write a policy that drives to goals, or another one."""
    task = go_to()
    save_policy(file, content or network(to_goal(task)), description or described(task))
    return file


def laboratory(folder: Path, **settings: Any) -> Path:
    """Write a configuration of four robots that ``go_to.onnx`` beside it drives."""
    robots = [
        {"id": robot, "tag": k, "vehicle": "gternal", "start": {"x_m": x, "y_m": y, "heading_deg": heading}}
        for k, (robot, (x, y, heading)) in enumerate(STARTS.items())
    ]
    group = {
        "behaviour": "policy",
        "robots": [*STARTS],
        "settings": {"file": "go_to.onnx", "task": SETTINGS} | settings,
    }
    tree = {
        "arena": {"name": "policy", "size_m": [3.2, 2.0]}, "robots": robots, "groups": [group],
        "controller": {"tick_s": 0.033, "alpha": 45, "horizon_s": 0.6, "point_ahead_m": 0.08},
        "tracker": {"source": "truth", "tag_side_m": 0.07, "tag_height_m": 0.08},
        "camera": {"model": "overhead", "width": 1280, "height": 720, "rate_hz": 30, "trigger": "tick"},
        "run": {"duration_s": 30},
    }  # fmt: skip
    file = folder / "policy.yaml"
    file.write_text(yaml.safe_dump(tree, sort_keys=False))
    return file
