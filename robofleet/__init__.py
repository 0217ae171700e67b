"""robofleet: deployment of differential-drive fleets under an overhead camera. The rooms are explained in README.md.

What programs of your own import stands in ``__all__``. Each name is loaded when it is first used: a robot's own
computer, which has the base install, needs no numba to write a driver.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robofleet.config.load import ConfigError, load_config
    from robofleet.config.tree import Config
    from robofleet.control.flow import FlowSettings, MemorylessFlow, NewtonRaphsonFlow
    from robofleet.control.prediction import Plant
    from robofleet.scripts.fleet import Fleet, FleetError
    from robofleet.tracking.sources import Camera
    from robofleet.vehicles.interface import Driver, DriverContext, DriverError, DriverReading, WheelSpeeds

    __version__: str

__all__ = [
    "Camera",
    "Config",
    "ConfigError",
    "Driver",
    "DriverContext",
    "DriverError",
    "DriverReading",
    "Fleet",
    "FleetError",
    "FlowSettings",
    "MemorylessFlow",
    "NewtonRaphsonFlow",
    "Plant",
    "WheelSpeeds",
    "__version__",
    "load_config",
]

_ROOMS = {
    "robofleet.config.load": ("ConfigError", "load_config"),
    "robofleet.config.tree": ("Config",),
    "robofleet.control.flow": ("FlowSettings", "MemorylessFlow", "NewtonRaphsonFlow"),
    "robofleet.control.prediction": ("Plant",),
    "robofleet.scripts.fleet": ("Fleet", "FleetError"),
    "robofleet.tracking.sources": ("Camera",),
    "robofleet.vehicles.interface": ("Driver", "DriverContext", "DriverError", "DriverReading", "WheelSpeeds"),
}
_MODULES = {name: module for module, names in _ROOMS.items() for name in names}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version  # noqa: PLC0415 - slow to load

        return version("robofleet")
    if name not in _MODULES:
        raise AttributeError(f"module 'robofleet' has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)
