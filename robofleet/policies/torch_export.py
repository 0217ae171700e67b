"""From a torch module to a policy's two files."""

import warnings
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from robofleet.policies.description import Description, save_policy

if TYPE_CHECKING:
    import torch

_OPSET = 17


def export_torch(module: "torch.nn.Module", file: Path, description: Description) -> None:
    """Write a policy's two files from a torch module.

    Args:
        module: Maps inputs (B, I) to actions (B, O), float32, for any B: the mean of a stochastic policy. Actions
            beyond -1 and 1 are cut off when the policy drives.
        file: Of the network; it ends in .onnx.
        description: What it observes, by ``described``: I and O are its ``inputs`` and ``outputs``.

    Raises:
        PolicyError: The files cannot be written.
    """
    import torch  # noqa: PLC0415 - whoever has a module has it

    written, names = BytesIO(), {"input_names": ["observation"], "output_names": ["action"]}
    with warnings.catch_warnings():
        # The exporter of TorchScript: the newer one needs a package more, and puts weights into a second file.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            module.eval().cpu(), (torch.zeros(1, description.inputs),), written, dynamo=False, opset_version=_OPSET,
            dynamic_axes={"observation": {0: "batch"}, "action": {0: "batch"}}, **names,
        )  # fmt: skip
    save_policy(file, written.getvalue(), description)
