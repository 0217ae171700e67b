"""robofleet: deployment of differential-drive fleets under an overhead camera. The rooms are explained in README.md.

``__all__`` is the public interface: all that scripts, behaviours, drivers, cameras and pose sources of your own import.
Every other name is internal. Each name is loaded when it is first used: a robot's own computer, which has the base
install, needs no numba to write a driver.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robofleet.behaviours import Settings
    from robofleet.behaviours.interface import (
        Behaviour,
        Bound,
        Decision,
        Dots,
        Figure,
        Flow,
        Line,
        Measure,
        Past,
        Refusal,
        Shape,
        Situation,
        Start,
        Team,
        Wish,
        WishKind,
    )
    from robofleet.bus.messages import TagPose
    from robofleet.config.load import ConfigError, load_config
    from robofleet.config.tree import Config
    from robofleet.control.flow import FlowError, FlowSettings, MemorylessFlow, NewtonRaphsonFlow
    from robofleet.control.prediction import Plant
    from robofleet.core.errors import RobofleetError
    from robofleet.drivers.serial_port import SerialPort
    from robofleet.reports.recorded_run import RecordedImage, RecordedRun, load
    from robofleet.safety.supervisor import Event
    from robofleet.scripts.fleet import Fleet
    from robofleet.scripts.script_link import FleetError
    from robofleet.tracking.events import Notice, TrackerEvent
    from robofleet.tracking.sources import (
        AdjustableCamera,
        Camera,
        CameraContext,
        CameraError,
        Exposure,
        ExposureLimits,
        Frame,
        Observation,
        PoseContext,
        PoseSource,
        ScheduledCamera,
    )
    from robofleet.vehicles.differential_drive import DifferentialDrive
    from robofleet.vehicles.interface import (
        STOP,
        Driver,
        DriverContext,
        DriverError,
        DriverReading,
        RobotFault,
        SimulatedDriver,
        WheelSpeeds,
        World,
        WorldObstacle,
        WorldRobot,
    )
    from robofleet.vehicles.readings import SensorReading, TruePose

    __version__: str

__all__ = [
    "STOP", "AdjustableCamera", "Behaviour", "Bound", "Camera", "CameraContext", "CameraError", "Config",
    "ConfigError", "Decision", "DifferentialDrive", "Dots", "Driver", "DriverContext", "DriverError",
    "DriverReading", "Event", "Exposure", "ExposureLimits", "Figure", "Fleet", "FleetError", "Flow", "FlowError",
    "FlowSettings", "Frame", "Line", "Measure", "MemorylessFlow", "NewtonRaphsonFlow", "Notice", "Observation",
    "Past", "Plant", "PoseContext", "PoseSource", "RecordedImage", "RecordedRun", "Refusal", "RobofleetError",
    "RobotFault", "ScheduledCamera", "SensorReading", "SerialPort", "Settings", "Shape", "SimulatedDriver",
    "Situation", "Start", "TagPose", "Team", "TrackerEvent", "TruePose", "WheelSpeeds", "Wish", "WishKind", "World",
    "WorldObstacle", "WorldRobot", "__version__", "load", "load_config",
]  # fmt: skip

_ROOMS = {
    "robofleet.behaviours.interface": (
        "Behaviour Bound Decision Dots Figure Flow Line Measure Past Refusal Shape Situation Start Team Wish WishKind"
    ),
    "robofleet.bus.messages": "TagPose",
    "robofleet.config.load": "ConfigError load_config",
    "robofleet.config.tree": "Config",
    "robofleet.control.flow": "FlowError FlowSettings MemorylessFlow NewtonRaphsonFlow",
    "robofleet.control.prediction": "Plant",
    "robofleet.core.errors": "RobofleetError",
    "robofleet.behaviours": "Settings",
    "robofleet.drivers.serial_port": "SerialPort",
    "robofleet.reports.recorded_run": "RecordedImage RecordedRun load",
    "robofleet.safety.supervisor": "Event",
    "robofleet.scripts.fleet": "Fleet",
    "robofleet.scripts.script_link": "FleetError",
    "robofleet.tracking.events": "Notice TrackerEvent",
    "robofleet.tracking.sources": (
        "AdjustableCamera Camera CameraContext CameraError Exposure ExposureLimits Frame Observation PoseContext "
        "PoseSource ScheduledCamera"
    ),
    "robofleet.vehicles.differential_drive": "DifferentialDrive",
    "robofleet.vehicles.interface": (
        "STOP Driver DriverContext DriverError DriverReading RobotFault SimulatedDriver WheelSpeeds World "
        "WorldObstacle WorldRobot"
    ),
    "robofleet.vehicles.readings": "SensorReading TruePose",
}
_MODULES = {name: module for module, names in _ROOMS.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version  # noqa: PLC0415 - slow to load

        return version("robofleet")
    if name not in _MODULES:
        raise AttributeError(f"module 'robofleet' has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)
