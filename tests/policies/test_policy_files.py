"""A policy's two files: what they hold, what acts by them, and which are refused by a line."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import numpy as np
import onnx
import pytest
from onnx.external_data_helper import convert_model_to_external_data

from robofleet.policies import PolicyError, Task, described, export_torch, load_policy, save_policy
from robofleet.policies.interface import width
from tests.policies.small_policies import column, go_to, network, saved, to_goal

F = width(go_to())


@pytest.mark.parametrize("form", ["robot", "group"])
def test_it_acts_as_its_network_on_normalised_observations(form: Literal["robot", "group"], tmp_path: Path) -> None:
    rng, n = np.random.default_rng(1), 4
    inputs, outputs = (F, 2) if form == "robot" else (n * F, 2 * n)
    mean, variance = rng.normal(size=inputs), rng.uniform(0.01, 2.0, inputs)
    first, second = rng.normal(0.0, 0.3, (inputs, 8)), rng.normal(0.0, 0.3, (8, outputs))
    description = described(go_to(n), form=form, mean=mean, variance=variance, clip=2.0)
    save_policy(tmp_path / "p.onnx", network(first, second), description)
    policy = load_policy(tmp_path / "p.onnx")
    observations = rng.normal(0.0, 3.0, (3, n, F)).astype(np.float32)
    rows = np.clip((observations.reshape(-1, inputs) - mean) / np.sqrt(variance), -2.0, 2.0)
    expected = (np.tanh(rows @ first) @ second).reshape(3, n, 2)
    np.testing.assert_allclose(policy.act(observations), expected, atol=1e-5)
    assert policy.description == description


def test_what_is_not_finite_is_nan(tmp_path: Path) -> None:
    weights = to_goal(go_to())
    weights[column("speed"), 1] = np.inf
    policy = load_policy(saved(tmp_path / "p.onnx", network(weights)))
    observations = np.zeros((1, 2, F), dtype=np.float32)
    observations[0, 1, column("speed")] = 1.0
    assert np.isnan(policy.act(observations)[0, 1, 1])


def test_another_number_of_robots_or_of_observations_is_an_error(tmp_path: Path) -> None:
    policy = load_policy(saved(tmp_path / "p.onnx"))
    assert policy.act(np.zeros((2, 7, F), dtype=np.float32)).shape == (2, 7, 2)  # of the form robot: any number
    with pytest.raises(ValueError, match=f"a row needs {F} numbers"):
        policy.act(np.zeros((2, 4, F + 1), dtype=np.float32))


def test_a_content_that_a_name_is_pinned_to_must_be_there(tmp_path: Path) -> None:
    file = saved(tmp_path / "p.onnx")
    description = file.with_suffix(".json")
    with pytest.raises(PolicyError, match="is not what it was"):
        load_policy(f"{file}#sha256={'0' * 64}")
    description.write_text(description.read_text().replace('"clip"', '"clip" '))
    load_policy(file)


def _without_json(file: Path) -> None:
    file.with_suffix(".json").unlink()


def _gigabyte(file: Path) -> None:
    with file.open("wb") as stream:
        stream.truncate(1 << 30)  # of a sparse file: no disk is filled


def _weights_elsewhere(file: Path) -> None:
    model = onnx.load(str(file))
    convert_model_to_external_data(model, location="weights.data", size_threshold=0)
    onnx.save(model, str(file))


def _described_as(**changes: object) -> Callable[[Path], None]:
    def change(file: Path) -> None:
        description = file.with_suffix(".json")
        description.write_text(json.dumps(json.loads(description.read_text()) | changes))

    return change


def _rewritten(content: bytes) -> Callable[[Path], None]:
    def change(file: Path) -> None:
        file.write_bytes(content)

    return change


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (Path.unlink, "p.onnx: there is no such file"),
        (_without_json, "p.json: there is no such file: a policy's JSON stands beside it: copy both files"),
        (_gigabyte, "p.onnx: has 1,073,741,824 bytes, and a policy's may have 100,000,000 at most"),
        (_rewritten(b"no network"), "p.onnx: is no ONNX file, or damaged: export it again"),
        (_rewritten(b""), "p.onnx: is no ONNX file, or damaged"),
        (_rewritten(network(to_goal(go_to()), opset=99)), "Opset 99 is under development"),
        (_rewritten(network(to_goal(go_to()), ir=99)), "Unsupported model IR version: 99"),
        (_weights_elsewhere, "its weights are in another file"),
        (_rewritten(network(np.zeros((F + 1, 2)))), f"its input is tensor(float) ['batch', {F + 1}]"),
        (_rewritten(network(np.zeros((F, 3)))), "its output is tensor(float) ['batch', 3]"),
        (_rewritten(network(to_goal(go_to()), batch=4)), "and a first axis of any length"),
        (lambda file: file.with_suffix(".json").write_text("{"), "p.json: is no JSON"),
        (lambda file: file.with_suffix(".json").write_text("[]"), "p.json: does not describe a policy"),
        (_described_as(format=2, robofleet="9.0"), "is of format 2, and this robofleet"),
        (_described_as(tick_s=-1), "p.json: tick_s: Input should be greater than"),
        (_described_as(form="group"), "a network of the form group needs the number of robots"),
        (_described_as(normalisation={"mean": [0], "variance": [1]}), f"mean and variance need {F} numbers each"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_by_a_line(
    spoil: Callable[[Path], None], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # where onnxruntime looks for further files
    file = saved(tmp_path / "p.onnx")
    spoil(file)
    with pytest.raises(PolicyError) as caught:
        load_policy(file)
    (line,) = str(caught.value).splitlines()
    assert line.startswith(str(file.parent))
    assert words in line


def test_a_description_names_a_task_that_others_can_find() -> None:
    kind = type("Mine", (type(go_to()),), {"__module__": "my_tasks"})
    mine: Task = kind(go_to().settings, go_to().team, 1)
    assert described(mine).task.name == "my_tasks:Mine"
    assert described(go_to()).task.name == "go_to"
    kind.__module__ = "__main__"
    with pytest.raises(PolicyError, match="put it in a file of its own"):
        described(mine)


def test_a_name_without_its_suffix_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match=r"ends in \.onnx"):
        save_policy(tmp_path / "p.pt", network(to_goal(go_to())), described(go_to()))


def test_a_torch_module_is_exported(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="NO TORCH: the exporter is tested where it is installed")
    module = torch.nn.Sequential(torch.nn.Linear(F, 8), torch.nn.Tanh(), torch.nn.Linear(8, 2))
    export_torch(module, tmp_path / "p.onnx", described(go_to()))
    observations = np.random.default_rng(1).normal(size=(3, 4, F)).astype(np.float32)
    expected = module(torch.tensor(observations)).detach().numpy()
    np.testing.assert_allclose(load_policy(tmp_path / "p.onnx").act(observations), expected, atol=1e-6)
