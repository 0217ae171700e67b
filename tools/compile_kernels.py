"""Compile the kernels for the processor x86-64-v3 into the package, before a wheel is built.

They serve the Python, numba, llvmlite and numpy that run this program. Each Python that a wheel serves runs it once:

    python tools/compile_kernels.py && python -m pip wheel --no-deps --wheel-dir dist .
"""

import os
import sys
from pathlib import Path

os.environ |= {"NUMBA_CPU_NAME": "x86-64-v3", "NUMBA_CPU_FEATURES": ""}  # numba reads them where it is loaded

from packages import needing

with needing("lab"):
    import numba  # noqa: F401 - else the first of the modules below that is missing would be named

    from robofleet.config.load import load_config
    from robofleet.core.kernels import SHIPPED, store
    from robofleet.recording.measures import load_kernels
    from robofleet.runs.lockstep import Lockstep

CONFIGS = Path(__file__).parents[1] / "configs"
RUNS = (("platoon", ()), ("platoon", ("tracker.source=truth",)), ("obstacles", ()), ("mocap", ()))


def main() -> None:
    """Drive each of the configurations for two seconds; what numba compiles meanwhile is kept in the package."""
    store.folder = lambda: SHIPPED
    for name, changes in RUNS:
        config = load_config(CONFIGS / f"{name}.yaml", ["run.duration_s=2", *changes])
        load_kernels(config)
        outcome, cause = Lockstep(config).run()
        if outcome != "completed":
            sys.exit(f"{name}: {outcome}: {cause}")
    SHIPPED.chmod(0o755)
    files = [*SHIPPED.iterdir()]
    for file in files:
        file.chmod(0o644)
    print(f"{len(files)} kernels, {sum(file.stat().st_size for file in files) / 1e6:.1f} MB, in {SHIPPED}")


if __name__ == "__main__":
    main()
