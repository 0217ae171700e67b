"""What a person should know of a completed run beside its figures: a sentence each."""

from collections.abc import Iterator, Mapping
from typing import Any

from robofleet.config.tree import Config

_TIMED_ERROR_MM = 3.0  # more than a healthy robot has
_LAW_SHARE = 0.2  # of the timed error: a smaller control error is not its reason


def remarks(config: Config, groups: Mapping[str, Any]) -> list[str]:
    """Return the remarks on all groups' figures."""
    return [line for name, figures in groups.items() for line in (*_goals(name, figures), *_estimate(config, figures))]


def _goals(name: str, figures: Mapping[str, Any]) -> Iterator[str]:
    """Yield which robots of ``go_to`` are not at their goals."""
    ends = (figures.get("not_at_goal") or {}).items()
    if ends:
        off = ", ".join(
            f"{robot} {end['distance_to_goal_mm']:.1f} mm and {end['heading_error_deg']:.1f} degrees"
            for robot, end in ends
        )
        yield f"{name}: not within the accuracy of their goals: {off}"


def _estimate(config: Config, figures: Mapping[str, Any]) -> Iterator[str]:
    """Yield that the estimate of a disturbance would help: the law does what it must, and the robot is elsewhere."""
    timed, control = figures.get("timed_error_mm"), figures.get("control_error_mm")
    if config.controller.disturbance == "estimated" or not timed or not control:
        return
    if timed["mean"] > _TIMED_ERROR_MM and control["mean"] < _LAW_SHARE * timed["mean"]:
        yield (
            f"the timed error is {timed['mean']:.1f} mm, the control error {control['mean']:.1f} mm: the wheels move"
            " the robot otherwise than commanded (slip, wear); `controller.disturbance: estimated` corrects that"
        )
