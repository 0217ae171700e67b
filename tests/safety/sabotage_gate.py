"""The gate without one of its checks, and its own tests run against it: they must notice.

python -m tests.safety.sabotage_gate      prints which test notices which sabotage
"""

import inspect
from collections.abc import Callable, Iterator
from itertools import product
from typing import Any

from robofleet.safety import gate
from tests.safety import test_gate, test_gate_latches, test_gate_stopping
from tests.safety.gated import Step

_TESTS = (test_gate, test_gate_stopping, test_gate_latches)

# What is taken out: a piece of the gate's source, and what stands there instead.
SABOTAGES: dict[str, tuple[str, str]] = {
    "a clock that is set back": ("if now_ns < state.at_ns:", "if False:"),
    "another boot after that": ("boot_id=state.boot_id + 1, ", ""),
    "an old lease after that": ("heard_ns=now_ns, command_nonce=_NEVER, enabled", "command_nonce=_NEVER, enabled"),
    "an old command after that": ("command_nonce=_NEVER, enabled=(_NEVER, 0)", "enabled=(_NEVER, 0)"),
    "an old permission after that": ("enabled=(_NEVER, 0), moved_by=_NEVER", "moved_by=_NEVER"),
    "a stop's time after that": (", moved_by=_NEVER\n", "\n"),
    "being held up": ("now_ns - state.at_ns > VALID_NS and", "False and"),
    "being just held up": ("now_ns - state.at_ns > VALID_NS and", "now_ns - state.at_ns > VALID_NS + 1 and"),
    "an ordinary stop": ("now_ns - state.at_ns > VALID_NS and", "now_ns - state.at_ns >= VALID_NS and"),
    "held up on its way down": ("not state.output == STOP == state.target", "state.target != STOP"),
    "held up before it turned": ("not state.output == STOP == state.target", "state.output != STOP"),
    "standing is not being held up": (" and not state.output == STOP == state.target", ""),
    "no ramp for who was held up": ("STOP, math.inf, now_ns", "STOP, 1.0, now_ns"),
    "nonces in flight": ("now_ns)._replace(since_ns=now_ns)", "now_ns)"),
    "being held up in the future": ("forgetting._replace(since_ns=_NEVER)", "forgetting"),
    "the robot's own stop": ("if inputs.latch:", "if False:"),
    "the gravest latch": ("if latch <= state.latch else state._replace(latch", "if False else state._replace(latch"),
    "equally grave latches": ("latch <= state.latch else", "latch < state.latch else"),
    "a latch's own number": ("latch_id=state.latch_id + 1", "latch_id=state.latch_id"),
    "boot": ("message.boot_id == state.boot_id and ", ""),
    "a nonce of the future": (
        "message.nonce <= now_ns < message.nonce + VALID_NS",
        "now_ns < message.nonce + VALID_NS",
    ),
    "a nonce too old": ("message.nonce <= now_ns < message.nonce + VALID_NS", "message.nonce <= now_ns"),
    "a nonce just too old": ("now_ns < message.nonce + VALID_NS", "now_ns <= message.nonce + VALID_NS"),
    "a nonce just young enough": ("now_ns < message.nonce + VALID_NS", "now_ns < message.nonce + VALID_NS - 1"),
    "freshness of a permission": ("_fresh(state, permission, now_ns)\n", "True\n"),
    "freshness of a command": ("_fresh(state, command, now_ns)\n", "True\n"),
    "epoch of a permission": ("and (permission.epoch == state.epoch or permission.latch)", "and True"),
    "an e-stop without a lease": (
        "permission.epoch == state.epoch or permission.latch",
        "permission.epoch == state.epoch",
    ),
    "order of permissions": ("and (permission.nonce, permission.seq) > state.enabled", "and True"),
    "a permission twice": ("permission.seq) > state.enabled", "permission.seq) >= state.enabled"),
    "a refused permission is counted": (
        "and (permission.nonce, permission.seq) > state.enabled\n    )\n    if not accepted:\n"
        "        return state._replace(refused=state.refused + 1)",
        "and (permission.nonce, permission.seq) > state.enabled\n    )\n    if not accepted:\n        return state",
    ),
    "an e-stop from the bus": ("    if permission.latch:\n", "    if False:\n"),
    "an e-stop's permission": ("permission.latch)._replace(limit=0.0)", "permission.latch)"),
    "clearing at rest": ("if state.latch and clearable and ", "if state.latch and "),
    "clearing while a stop is pressed": ("at_rest and not inputs.latch", "at_rest"),
    "clearing while a wheel turns": ("state.output == STOP and not inputs.turning", "state.output == STOP"),
    "clearing on the way to rest": ("state.output == STOP and not inputs.turning", "not inputs.turning"),
    "a number that clears": ("permission.clear and permission.clear == state.latch_id", "permission.clear"),
    "no number clears nothing": ("and permission.clear and permission.clear", "and permission.clear"),
    "a reset moves nothing": ("latch=Latch.NONE, limit=0.0", "latch=Latch.NONE"),
    "nobody's lease": ("if session == 0:", "if False:"),
    "a release by a stranger": ("if session == state.session else (state, False)", ""),
    "a lease asked for again": ("    if session == state.session:\n        return state, True\n", ""),
    "a lease in motion": ("if not (at_rest and (", "if not (("),
    "a second controller": ("state.session == 0 or lapsed or action is LeaseAction.TAKE_OVER", "True"),
    "a lease that is free": ("state.session == 0 or lapsed or action", "lapsed or action"),
    "a lease that lapsed": ("state.session == 0 or lapsed or action", "state.session == 0 or action"),
    "a takeover": (" or action is LeaseAction.TAKE_OVER", ""),
    "when a lease lapses": (">= LAPSE_NS", "> LAPSE_NS"),
    "a new epoch": ("epoch=epoch, session", "session"),
    "the time of a grant": ("heard_ns=now_ns, seq=0", "seq=0"),
    "numbers from the start": ("seq=0, command_nonce=_NEVER, limit", "command_nonce=_NEVER, limit"),
    "the former holder's command": ("seq=0, command_nonce=_NEVER, limit=0.0", "seq=0, limit=0.0"),
    "the former permission": ("seq=0, command_nonce=_NEVER, limit=0.0", "seq=0, command_nonce=_NEVER"),
    "epoch of a command": ("and command.epoch == state.epoch", "and True"),
    "session of a command": ("and command.session == state.session != 0", "and state.session != 0"),
    "a session of nobody": ("command.session == state.session != 0", "command.session == state.session"),
    "a command's number": ("and command.seq > state.seq", "and True"),
    "a command twice": ("command.seq > state.seq", "command.seq >= state.seq"),
    "limits": ("and _within(drive, command.wheels)", "and True"),
    "a refused command is counted": (
        "and _within(drive, command.wheels)\n    )\n    if not accepted:\n"
        "        return state._replace(refused=state.refused + 1)",
        "and _within(drive, command.wheels)\n    )\n    if not accepted:\n        return state",
    ),
    "a command is heard of": (", heard_ns=now_ns)\n\n\ndef _fresh", ")\n\n\ndef _fresh"),
    "speed of the body": ("return body <= _TOLERANCE * drive.max_speed and ", "return "),
    "speed backwards": ("abs(wheels.left + wheels.right)", "(wheels.left + wheels.right)"),
    "speed of the left wheel": ("and abs(wheels.left) <= fastest ", ""),
    "speed of the right wheel": (" and abs(wheels.right) <= fastest", ""),
    "1 %": ("_TOLERANCE = 1.01", "_TOLERANCE = 1.02"),
    "1 % is allowed": ("_TOLERANCE = 1.01", "_TOLERANCE = 1.0"),
    "latch": ("if state.latch:\n        return STOP", "if False:\n        return STOP"),
    "lease": ("if state.session == 0:\n        return STOP", "if False:\n        return STOP"),
    "age of the permission": ("now_ns >= enabled_until_ns or not", "not"),
    "age of the permission, just": ("now_ns >= enabled_until_ns", "now_ns > enabled_until_ns"),
    "a permission to stand": ("or not state.limit > 0.0", ""),
    "age of the command": ("if now_ns >= command_until_ns:", "if False:"),
    "age of the command, just": ("if now_ns >= command_until_ns:", "if now_ns > command_until_ns:"),
    "the permission's end": ("GateStatus.NO_COMMAND, enabled_until_ns", "GateStatus.NO_COMMAND, None"),
    "the older of the two ends": ("min(enabled_until_ns, command_until_ns)", "max(enabled_until_ns, command_until_ns)"),
    "the permission's limit": ("> _TOLERANCE * state.limit", "> 1e9"),
    "the permission's limit of the left wheel": (
        "max(abs(state.wheels.left), abs(state.wheels.right)) > _T",
        "abs(state.wheels.right) > _T",
    ),
    "the permission's limit of the right wheel": (
        "max(abs(state.wheels.left), abs(state.wheels.right)) > _T",
        "abs(state.wheels.left) > _T",
    ),
    "acceleration": ("if furthest > reach:", "if False:"),
    "acceleration of the other wheel": ("furthest = max(abs(left), abs(right))", "furthest = abs(left)"),
    "one ratio for both wheels": ("state.output.right + ratio * right)", "target.right)"),
    "a step back in time": (
        "max(0, min(now_ns - state.at_ns, longest_ns))",
        "abs(min(now_ns - state.at_ns, longest_ns))",
    ),
    "a process that was held up": ("_LONGEST_RAMP_NS = 20_000_000", "_LONGEST_RAMP_NS = 2_000_000_000"),
    "catching up": ("_LONGEST_RAMP_NS = 20_000_000", "_LONGEST_RAMP_NS = 5_000_000"),
    "nothing to catch up with": ("RAMP_NS if state.output == state.target else _LONGEST_RAMP_NS", "_LONGEST_RAMP_NS"),
    "steps of the ramp": ("RAMP_NS = 5_000_000", "RAMP_NS = 50_000_000"),
    "the ramp's deadline": ("if state.output != target:", "if False:"),
    "the ramp's deadline when closed": (
        "now_ns + RAMP_NS if until_ns is None else min",
        "None if until_ns is None else min",
    ),
    "the end of validity on the way": ("else min(now_ns + RAMP_NS, until_ns)", "else now_ns + RAMP_NS"),
    "the older nonce times a stop": (
        "min(state.command_nonce, state.enabled[0])",
        "max(state.command_nonce, state.enabled[0])",
    ),
    "a stop is timed": ("if state.target != STOP:", "if False:"),
    "only a stop is timed": ("if state.target != STOP:", "if True:"),
    "a stop that is not over": ("target_after_ns=after_ns, output_after_ns=UNKNOWN", "target_after_ns=after_ns"),
    "the output's stop is timed": ("if output == STOP and not state.target == STOP == state.output:", "if False:"),
    "a stop is over once": (" and not state.target == STOP == state.output", ""),
    "an unknown time": ("UNKNOWN if state.moved_by == _NEVER else now_ns", "now_ns"),
}


def sabotaged(old: str, new: str) -> Step:
    """Return the gate's step, with every place of ``old`` in its source replaced."""
    source = inspect.getsource(gate)
    assert old in source, f"the gate has no {old!r} any more"
    module: dict[str, Any] = {"__name__": gate.__name__}
    exec(compile(source.replace(old, new), gate.__name__, "exec"), module)
    types = {name: kind for name, kind in vars(gate).items() if isinstance(kind, type)}
    module.update(types)  # an IntEnum's member is compared by identity
    step: Step = module["step"]
    return step


def cases() -> Iterator[tuple[str, Callable[[Step], None]]]:
    """Yield the name of every test of the gate, with each of its parameters, and what runs it."""
    functions = [item for module in _TESTS for item in vars(module).items()]
    for name, function in functions:
        if not name.startswith("test_") or "step" not in inspect.signature(function).parameters:
            continue
        marks = [mark.args for mark in getattr(function, "pytestmark", [])]
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
