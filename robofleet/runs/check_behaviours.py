"""What is wrong with the behaviours' classes: whether they can be made, and what they return before anything moves."""

from collections.abc import Iterator, Sequence
from typing import Any

from robofleet.behaviours.interface import Behaviour, Bound, Dots, Figure, Line, Refusal, Start
from robofleet.config import groups
from robofleet.config.faults import Complaint
from robofleet.config.tree import Config
from robofleet.core.plugins import blamed


def complaints(config: Config) -> Iterator[Complaint]:
    """Yield what cannot be made; of a class of the user's also what a run could not use of it."""
    for i, group in enumerate(config.groups):
        made = False
        try:
            behaviour = groups.behaviour(config, group)
            made = True
            if ":" in group.behaviour:
                for words in _unusable(behaviour):
                    yield f"groups.{i}.behaviour", f"{group.behaviour}: {words}"
        except Exception as error:  # noqa: BLE001 - a class of the user's raises anything
            if isinstance(error, ValueError) and not made:
                yield f"groups.{i}.settings", f"{group.behaviour} cannot be made of them: {error}"
            else:
                yield f"groups.{i}.behaviour", f"{group.behaviour} {blamed(error)}"


def _unusable(behaviour: Behaviour) -> Iterator[str]:
    if not hasattr(behaviour, "team"):
        yield "its `__init__` must call `super().__init__(settings, team)`"
        return
    behaviour.places()
    bounds, refusals = [*behaviour.bounds()], [*behaviour.refusals()]
    starts = [pose for pose in behaviour.team.starts if pose is not None]
    holds = not refusals and all(getattr(bound, "holds", False) for bound in bounds)
    returned: dict[str, tuple[Sequence[Any], tuple[type, ...]]] = {
        "figures": (behaviour.figures, (Figure,)),
        "shapes": (behaviour.shapes(), (Line, Dots)),
        "bounds": (bounds, (Bound,)),
        "refusals": (refusals, (Refusal,)),
        "start": ([behaviour.start(starts)] if holds and len(starts) == len(behaviour.team) else [], (Start,)),
    }
    for name, (values, kinds) in returned.items():
        for value in values:
            if not isinstance(value, kinds):
                yield f"`{name}` gives {value!r}: it must be a {' or '.join(kind.__name__ for kind in kinds)}"
                break
