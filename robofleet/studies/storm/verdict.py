"""A violated invariant of a storm."""

from typing import NamedTuple


class Violation(NamedTuple):
    """One invariant that did not hold."""

    invariant: str
    at_s: float  # simulated time since the lockstep began
    robot: str  # "" where it is not about one
    numbers: str

    def __str__(self) -> str:
        who = f"{self.robot}: " if self.robot else ""
        return f"{self.at_s:.4f} s: {who}{self.invariant}: {self.numbers}"
