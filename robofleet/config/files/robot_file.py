"""``robot.yaml`` on a robot's own computer: whose robot it is, where its router is, and what a run may ask of it."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from robofleet.config.files.parameters import Parameters, load_placed
from robofleet.core import folders
from robofleet.core.patterns import NETWORK_PATTERN
from robofleet.core.settings import Model, Name

FILE = "robot.yaml"
Routers = Annotated[
    tuple[Annotated[str, Field(pattern=NETWORK_PATTERN)], ...], Field(min_length=1, max_length=8, strict=False)
]


class Allowed(Model):
    """What a run may ask of this robot, whatever its configuration says."""

    drivers: Annotated[tuple[str, ...], Field(min_length=1, strict=False)] | None = None
    """Kinds of ``robots[].driver``; null: any."""
    ports: Annotated[tuple[str, ...], Field(min_length=1, strict=False)] | None = None
    """Ports of ``robots[].settings.port``; null: any."""
    max_wheel_speed_rad_s: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = None
    """Fastest wheel; null: any."""


class RobotFile(Parameters):
    """The file."""

    arena: Name
    """The arena that this robot has joined."""
    unit: Name
    """The name by which a configuration's ``robots[].unit`` calls this computer."""
    router: Routers
    """Addresses of the laboratory's router, the first one that answers is taken."""
    allows: Allowed = Allowed()
    """What a run may ask; what is not named is allowed."""

    def refusal(self, driver: str, port: object, max_wheel_speed_rad_s: float) -> str | None:
        """Return what a run asks of a robot and this file does not allow; None where it is allowed."""
        allows = self.allows
        if allows.drivers is not None and driver not in allows.drivers:
            return f"the driver {driver} (allowed: {', '.join(allows.drivers)})"
        if allows.ports is not None and port not in allows.ports:
            return f"the port {port} (allowed: {', '.join(allows.ports)})"
        most = allows.max_wheel_speed_rad_s
        if most is not None and max_wheel_speed_rad_s > most:
            return f"wheels of {max_wheel_speed_rad_s:g} rad/s (allowed: {most:g})"
        return None


def robot_file() -> Path:
    """Return the file of this computer: /etc/robofleet's where it is there, else this user's."""
    system = folders.SYSTEM / FILE
    return system if system.exists() else folders.own_settings() / FILE


def load_robot_file(file: Path) -> RobotFile:
    """Read the file; ConfigError with everything that is wrong."""
    absent = "no such file: `robofleet join FILE` writes it from what `robofleet keys bundle` made"
    return load_placed(RobotFile, file, absent)[0]
