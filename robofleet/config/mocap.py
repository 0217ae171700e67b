"""Motion capture: which system measures the poses, where it is, and how its frame lies in the arena."""

import math
from typing import Annotated, Literal

from pydantic import Field

from robofleet.core.settings import MANY, Coordinate, Degrees, Model, Text, within

System = Literal["optitrack", "vicon", "qualisys", "vrpn", "nokov", "mock", "simulated"]
Name = Annotated[str, Field(min_length=1, max_length=100)]


class CaptureFrame(Model):
    """Where the capture system's origin lies in the arena [world frame]."""

    x_m: Coordinate = 0.0
    """Position along the arena's long side, from its centre."""
    y_m: Coordinate = 0.0
    """Position to the left of the long axis, from the arena's centre."""
    heading_deg: Degrees = 0.0
    """Heading of the system's x axis from the world's, counter-clockwise."""

    @property
    def psi(self) -> float:
        """Heading [rad]."""
        return math.radians(self.heading_deg)


class MocapSettings(Model):
    """A motion-capture system, by the library ``motioncapture`` (``pip install 'robofleet[mocap]'``)."""

    system: System = "simulated"
    """The system, as the library calls it. ``mock`` is the library's own: bodies that stand still. ``simulated`` needs
    no library: it measures simulated robots."""
    host: Annotated[str, Field(min_length=1, max_length=300)] = "localhost"
    """Address of the computer that sends the poses."""
    options: Annotated[dict[Text, Text], Field(max_length=MANY)] = Field(default={})
    """Further settings of the library for this system, for example ``interface_ip`` of ``optitrack``."""
    up: Literal["y", "z"] = "z"
    """The system's axis that points up."""
    unit_m: Annotated[float, within(1e-6, 1000)] = 1.0
    """Length of a unit of the system's positions. The library gives metres for all systems but VRPN, whose server
    decides."""
    origin: CaptureFrame = CaptureFrame()
    """Where the system's origin lies in the arena."""
    latency_s: Annotated[float, Field(ge=0, le=0.25)] = 0.01
    """Time from the instant at which a pose is true to its arrival here. The system's own program shows it."""
    rate_hz: Annotated[float, within(10, 1000)] = 100.0
    """Frames in a second that the ``simulated`` system sends. The other systems keep their own rate."""
    position_sigma_m: Annotated[float, within(0, 1)] = 0.0002
    """Standard deviation of a measured position along each axis; 0: nobody knows it. The ``simulated`` system makes
    such noise. If it is not 0, a body whose pose does not change by a single bit is not tracked."""
    heading_sigma_rad: Annotated[float, within(0, 1)] = 0.002
    """Standard deviation of a measured heading; 0: nobody knows it."""
    others: Annotated[tuple[Name, ...], Field(max_length=MANY, strict=False)] = ()
    """Bodies of the system that are no robots. A body that is neither here nor a robot's is refused before a run."""
