"""No kernel is compiled once a run is under way."""

from collections.abc import Callable
from typing import Any

import pytest

from robofleet.config.tree import Config
from robofleet.control import platoon
from robofleet.kernels import Kernel
from robofleet.processes.lockstep import Lockstep
from robofleet.safety import barrier
from robofleet.tracking import estimator

MODULES = (platoon, estimator, barrier)
KERNELS = [value for module in MODULES for value in vars(module).values() if isinstance(value, Kernel)]


@pytest.mark.parametrize("disturbance", ["none", "estimated"])
def test_what_the_launcher_compiles_is_all_that_a_run_needs(
    disturbance: str, platoon_of: Callable[..., Config]
) -> None:
    config = platoon_of("tracker.source=truth", "run.duration_s=2", f"controller.disturbance={disturbance}")
    run = Lockstep(config)
    before: list[Any] = [list(kernel.compiled.signatures) for kernel in KERNELS]
    assert any(before)
    assert run.run() == ("completed", None)
    assert [list(kernel.compiled.signatures) for kernel in KERNELS] == before
