"""The gate with one of its constants changed, which mutmut leaves alone, and its own tests: they must notice.

python -m tests.safety.sabotage_gate      prints which test notices which sabotage
"""

import inspect
from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

from robofleet.safety import gate
from tests.safety import test_gate, test_gate_latches, test_gate_stopping
from tests.safety.gated import Step, plain

_TESTS = (test_gate, test_gate_stopping, test_gate_latches)

# What is changed: a piece of the gate's source, and what stands there instead.
SABOTAGES: dict[str, tuple[str, str]] = {
    "1 %": ("TOLERANCE = 1.01", "TOLERANCE = 1.02"),
    "1 % is allowed": ("TOLERANCE = 1.01", "TOLERANCE = 1.0"),
    "a process that was held up": ("LONGEST_RAMP_NS = 20_000_000", "LONGEST_RAMP_NS = 2_000_000_000"),
    "catching up": ("LONGEST_RAMP_NS = 20_000_000", "LONGEST_RAMP_NS = 5_000_000"),
    "steps of the ramp": ("RAMP_NS = 5_000_000", "RAMP_NS = 50_000_000"),
}


def sabotaged(old: str, new: str) -> Step:
    """Return the gate's step, with every place of ``old`` in its source replaced."""
    source = inspect.getsource(gate)
    assert old in source, f"the gate has no {old!r} any more"
    module: dict[str, Any] = {"__name__": gate.__name__}
    exec(compile(source.replace(old, new), gate.__name__, "exec"), module)
    types = {name: kind for name, kind in vars(gate).items() if isinstance(kind, type)}
    module.update(types)  # an IntEnum's member is compared by identity
    return plain(module["step"])


def cases() -> Iterator[tuple[str, Callable[[Step], None]]]:
    """Yield the name of every test of the gate, with each of its parameters, and what runs it."""
    functions = [item for module in _TESTS for item in vars(module).items()]
    for name, function in functions:
        if not name.startswith("test_") or "step" not in inspect.signature(function).parameters:
            continue
        marks = [mark.args for mark in getattr(function, "pytestmark", []) if mark.name == "parametrize"]
        sets = [[_named(names, values) for values in rows] for names, rows in marks]
        for chosen in product(*sets):
            arguments = {key: value for part in chosen for key, value in part.items()}
            yield name, lambda step, run=function, given=arguments: run(step=step, **given)


def _named(names: str | tuple[str, ...], values: Any) -> dict[str, Any]:
    return {names: values} if isinstance(names, str) else dict(zip(names, values, strict=True))


def noticed_by(step: Step) -> str | None:
    """Return the first test that fails with this gate."""
    for name, run in cases():
        try:
            run(step)
        except Exception:  # noqa: BLE001 - however it fails, it noticed
            return name
    return None


if __name__ == "__main__":
    for what, (old, new) in SABOTAGES.items():
        print(f"{what:<42} {noticed_by(sabotaged(old, new)) or 'NOT NOTICED'}")
