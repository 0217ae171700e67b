"""What a driver process loads: a robot's small computer has the base install and no more."""

import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, packages_distributions, requires

import pytest

PROCESS = (
    "robofleet.cli", "robofleet.comms.zenoh_bus", "robofleet.processes.check_drivers", "robofleet.processes.child",
    "robofleet.processes.driver", "robofleet.processes.keeping",
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


def loaded(driver: str) -> set[str]:
    """Return the top-level modules of a driver process that are not Python's own."""
    modules = "{name.partition('.')[0] for name in sys.modules} - set(sys.stdlib_module_names)"
    code = f"import sys, {', '.join(PROCESS)}, {driver}; print(*sorted({modules}))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return {name for name in done.stdout.split() if not name.startswith("_")}


@pytest.mark.parametrize("driver", ["simulated", "gternal", "arduino_bridge", "create2"])
def test_a_driver_process_loads_the_base_install_alone(driver: str) -> None:
    base, owners = base_install(), packages_distributions()
    modules = loaded(f"drivers.{driver}")
    assert {"zenoh", "numpy", "pydantic"} <= modules
    strangers = {
        module
        for module in modules - {"robofleet", "drivers", "cython_runtime"}
        if not base & {re.sub(r"[-_.]+", "-", owner).lower() for owner in owners.get(module, [])}
    }
    assert strangers == set()
    assert not modules & {"numba", "cv2", "scipy", "mcap", "matplotlib", "rich"}
    assert ("serial" in modules) == (driver != "simulated")
