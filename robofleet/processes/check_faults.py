"""Timed faults that are refused before a run: those that only a simulation, a twin or lockstep can have."""

from collections.abc import Iterator

from robofleet.config.faults import Complaint
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.config.troubles import BodyFault, LineFault, LinkFault, Push, TouchFault
from robofleet.plugins import PluginError, load
from robofleet.vehicles.interface import SimulatedDriver


def complaints(config: Config, *, lockstep: bool) -> Iterator[Complaint]:
    """Return what cannot be done to these robots: (dotted path, what is wrong and how to mend it)."""
    twins = [robot.id for robot in config.twins]
    for i, fault in enumerate(config.faults):
        if not lockstep and fault.kind in ("clock_step", "second_controller"):
            yield f"faults.{i}.kind", f"{fault.kind} is for lockstep alone: add --lockstep, or remove it"
        if isinstance(fault, BodyFault | Push) and not _has_a_simulated_body(config.robot(fault.robot)):
            yield f"faults.{i}.robot", f"{fault.robot} is real: {fault.kind} is for a simulated robot"
        if isinstance(fault, TouchFault | LinkFault | LineFault):
            if not twins:
                yield f"faults.{i}.kind", f"no robot has a twin: {fault.kind} is for one, so remove it"
            elif fault.robot is not None and fault.robot not in twins:
                yield f"faults.{i}.robot", f"{fault.robot} has no twin: {fault.kind} is for {', '.join(twins)}"


def _has_a_simulated_body(robot: Robot) -> bool:
    try:
        return robot.twin is not None or issubclass(load("robofleet.drivers", robot.driver), SimulatedDriver)
    except PluginError:
        return True  # said already
