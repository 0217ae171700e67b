"""Timed faults that are refused before a run: those that only a simulation, a twin or lockstep can have."""

from collections.abc import Iterator

from robofleet.config.faults import Complaint, did_you_mean
from robofleet.config.robots import Robot
from robofleet.config.tree import OWN_PLANT, Config
from robofleet.config.troubles import (
    BodyFault,
    ClockStep,
    LineFault,
    LinkFault,
    NetworkCut,
    ProcessFault,
    Push,
    RunawayFault,
    TouchFault,
)
from robofleet.core.plugins import PluginError, load
from robofleet.runs import table
from robofleet.simulation.faulty_line import TOUCHES
from robofleet.vehicles.interface import RobotFault, SimulatedDriver


def complaints(config: Config, *, lockstep: bool) -> Iterator[Complaint]:
    """Return what cannot be done to these robots: (dotted path, what is wrong and how to mend it)."""
    twins = [robot.id for robot in config.twins]
    known = table.injectable(config)
    for i, fault in enumerate(config.faults):
        if isinstance(fault, ProcessFault | ClockStep) and fault.process not in known:
            yield f"faults.{i}.process", _no_process(fault.process, known)
        if isinstance(fault, NetworkCut):
            strangers = ((k, name) for k, name in enumerate(fault.processes) if name not in known)
            yield from ((f"faults.{i}.processes.{k}", _no_process(name, known)) for k, name in strangers)
        if not lockstep and fault.kind in ("clock_step", "second_controller"):
            yield f"faults.{i}.kind", f"{fault.kind} is for lockstep alone: add --lockstep, or remove it"
        if isinstance(fault, BodyFault | RunawayFault | Push) and (
            why := _obeys_no_body_fault(config.robot(fault.robot))
        ):
            yield f"faults.{i}.robot", f"{fault.robot} {why}"
        if fault.kind in ("slip", "pushed") and config.plant.model != OWN_PLANT:
            own = (
                f"only plant.model {OWN_PLANT!r} has it: {config.plant.model!r} has a contact of its own, so remove it"
            )
            yield f"faults.{i}.kind", own
        if isinstance(fault, TouchFault | LinkFault | LineFault):
            if not twins:
                yield f"faults.{i}.kind", f"no robot has a twin: {fault.kind} is for one, so remove it"
            elif fault.robot is not None and fault.robot not in twins:
                yield f"faults.{i}.robot", f"{fault.robot} has no twin: {fault.kind} is for {', '.join(twins)}"
            elif isinstance(fault, TouchFault) and not _feels(config.robot(fault.robot), fault.kind):
                twin = config.robot(fault.robot).twin
                yield f"faults.{i}.kind", f"{twin!r} has no such sensor, so nothing would happen: remove it"


def _no_process(name: str, known: tuple[str, ...]) -> str:
    return f"there is no process '{name}': {did_you_mean(name, known)}"


def _obeys_no_body_fault(robot: Robot) -> str:
    """Return why a body's fault does nothing to a robot; nothing where it does."""
    if robot.twin is not None:
        return ""
    try:
        kind = load("robofleet.drivers", robot.driver)
    except PluginError:
        return ""  # said already
    if not issubclass(kind, SimulatedDriver):
        return "is real: name a simulated robot"
    if getattr(kind, "body_faults", False) is not True:
        return (
            f"would not obey it, {robot.driver!r} has faults of its own or none: remove it, or let the driver take "
            "context.simulation.trouble and say body_faults = True"
        )
    return ""


def _feels(robot: Robot, touch: str) -> bool:
    try:
        reports = getattr(load("robofleet.twins", robot.twin or ""), "reports", RobotFault(0))
    except PluginError:
        return True  # said already
    return TOUCHES[touch] in reports
