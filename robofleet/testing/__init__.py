"""What tests of your own need: contracts of drivers, cameras and pose sources, a fake driver, a clock, lockstep.

``__all__`` is public. Each name is loaded when it is first used. The contracts need pytest, the rest does not.
"""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robofleet.core.clock import SimulatedClock
    from robofleet.testing.behaviours import drive, make, refusals, situation, team
    from robofleet.testing.camera_contract import CameraContract
    from robofleet.testing.driver_bench import DriverBench, DriverSubject
    from robofleet.testing.driver_contract import DriverContract
    from robofleet.testing.fake_driver import FakeDriver
    from robofleet.testing.lockstep import LockstepRun, run_lockstep
    from robofleet.testing.pose_contract import PoseBench, PoseContract

__all__ = [
    "CameraContract", "DriverBench", "DriverContract", "DriverSubject", "FakeDriver", "LockstepRun", "PoseBench",
    "PoseContract", "SimulatedClock", "drive", "make", "refusals", "run_lockstep", "situation", "team",
]  # fmt: skip

_FILES = {
    "robofleet.core.clock": "SimulatedClock",
    "robofleet.testing.behaviours": "drive make refusals situation team",
    "robofleet.testing.camera_contract": "CameraContract",
    "robofleet.testing.driver_bench": "DriverBench DriverSubject",
    "robofleet.testing.driver_contract": "DriverContract",
    "robofleet.testing.fake_driver": "FakeDriver",
    "robofleet.testing.lockstep": "LockstepRun run_lockstep",
    "robofleet.testing.pose_contract": "PoseBench PoseContract",
}
_MODULES = {name: module for module, names in _FILES.items() for name in names.split()}
_CHECKS = {
    f"robofleet.testing.{file}"
    for file in ("camera_contract", "driver_cost", "driver_lines", "driver_motion", "driver_port", "pose_contract")
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module 'robofleet.testing' has no attribute {name!r}")
    if name.endswith("Contract") and _CHECKS.isdisjoint(sys.modules):
        import pytest  # noqa: PLC0415 - only contracts need it

        pytest.register_assert_rewrite(*_CHECKS)  # then a check that fails shows the values that it compared
    return getattr(import_module(_MODULES[name]), name)
