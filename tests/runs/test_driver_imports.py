"""What a driver process loads: a robot's small computer has the base install and no more."""

import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path

import pytest

CONFIGS = Path(__file__).parents[2] / "configs"
PROCESS = (
    "robofleet.cli", "robofleet.bus.zenoh_bus", "robofleet.runs.check_drivers", "robofleet.runs.child",
    "robofleet.nodes.unit.driver", "robofleet.nodes.unit.drivers", "robofleet.nodes.unit.state_store",
    "robofleet.simulation.faulty_bus", "robofleet.simulation.faulty_disk", "robofleet.simulation.faulty_driver",
)  # fmt: skip


def base_install() -> set[str]:
    """Return every distribution that ``pip install robofleet`` brings, by its normal name."""
    found, waiting = set[str](), ["robofleet"]
    while waiting:
        name = re.sub(r"[-_.]+", "-", waiting.pop()).lower()
        if name in found:
            continue
        found.add(name)
        try:
            needed = requires(name) or []
        except PackageNotFoundError:  # on another system
            continue
        waiting += [re.match(r"[\w.-]+", line)[0] for line in needed if "extra ==" not in line]  # type: ignore[index]
    return found


def loaded(drivers: str) -> set[str]:
    """Return the top-level modules of a driver process that has read its configuration, but Python's own.

    What a package loads in every Python of its environment is not the process's.
    """
    modules = "{name.partition('.')[0] for name in set(sys.modules) - began} - set(sys.stdlib_module_names)"
    read = f"[robofleet.config.load.load_config(file) for file in pathlib.Path({str(CONFIGS)!r}).glob('*.yaml')]"
    own = f"robofleet.config.load, {', '.join(PROCESS)}, {drivers}; {read}; print(*{modules})"
    code = f"import pathlib, sys; began = set(sys.modules); import {own}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return {name for name in done.stdout.split() if not name.startswith("_")}


@pytest.mark.slow
@pytest.mark.parametrize("drivers", [("simulated",), ("gternal", "arduino_bridge", "create2", "rfp")], ids=" ".join)
def test_a_driver_process_loads_the_base_install_alone(drivers: tuple[str, ...]) -> None:
    base, owners = base_install(), packages_distributions()
    modules = loaded(", ".join(f"robofleet.drivers.{driver}" for driver in drivers))
    assert {"zenoh", "numpy", "pydantic"} <= modules
    strangers = {
        module
        for module in modules - {"robofleet", "cython_runtime", "mylab"}  # the last: a shipped example
        if not base & {re.sub(r"[-_.]+", "-", owner).lower() for owner in owners.get(module, [])}
    }
    assert strangers == set()
    assert not modules & {"numba", "cv2", "scipy", "mcap", "matplotlib", "rich"}
    assert ("serial" in modules) == (drivers != ("simulated",))
