"""What a check says: one finding a line, with a mark and, where something is wrong, how to mend it."""

from enum import StrEnum
from typing import Any, NamedTuple


class Mark(StrEnum):
    """How grave a finding is."""

    OK = "ok"
    WARN = "warn"  # a run works, and something is worse than it could be
    MISSING = "missing"  # a run does not work without it


class Paste(NamedTuple):
    """A line for a file of the system, ready to paste."""

    file: str
    line: str


class Finding(NamedTuple):
    """One thing that was looked at."""

    name: str
    mark: Mark
    says: str
    cure: str = ""  # empty: nothing has to be mended
    pastes: tuple[Paste, ...] = ()

    def as_json(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "mark": self.mark.value,
            "says": self.says,
            "cure": self.cure,
            "paste": [paste._asdict() for paste in self.pastes],
        }


def ok(name: str, says: str, *pastes: Paste) -> Finding:
    return Finding(name, Mark.OK, says, pastes=pastes)
