"""The robots of a configuration: what the controller believes of a kind of robot, and what a simulated one is like."""

import math
from typing import Annotated, Literal

from pydantic import Field, JsonValue

from robofleet.config.calibrated import RobotCalibration, TagOffset
from robofleet.config.plant_errors import PlantErrors
from robofleet.config.sensors import SensorSettings
from robofleet.core.settings import (
    MANY,
    Coordinate,
    Degrees,
    Height,
    Lag,
    Length,
    Model,
    Name,
    Named,
    Text,
    within,
)


class Vehicle(Model):
    """A kind of robot (a file of ``configs/robots``): the values that the controller uses, and the errors of a
    simulated robot."""

    wheel_radius_m: Length
    """Radius of a wheel that the controller uses."""
    wheel_base_m: Length
    """Distance between the points where the wheels touch the floor."""
    body_radius_m: Length
    """Radius of the smallest disc, about the middle of the axle, that covers the whole robot."""
    max_wheel_speed_rad_s: Annotated[float, within(1e-2, 1e4)]
    """Highest speed that the controller commands of a wheel."""
    max_speed_m_s: Annotated[float, within(1e-3, 1000)]
    """Highest speed that the controller commands of the robot."""
    max_wheel_acceleration_rad_s2: Annotated[float, within(1e-2, 1e6)]
    """Fastest change of a wheel's speed that the gate passes."""
    motor_lag_s: Lag
    """Time constant of the wheel-speed loop that the controller uses."""
    sensors: SensorSettings | None = None
    """Sensors of robots of this kind. A run reads them of the robots with ``robots[].sensors: true``."""
    simulated: PlantErrors | None = None
    """Errors of a simulated robot of this kind. null: only a real robot can be of this kind."""


class StartPose(Model):
    """Where a robot's centre stands at first [world frame]."""

    x_m: Coordinate
    """Position along the arena's long side, from its centre."""
    y_m: Coordinate
    """Position to the left of the long axis, from the arena's centre."""
    heading_deg: Degrees
    """Heading from the x axis, counter-clockwise."""

    @property
    def psi(self) -> float:
        """Heading in (-pi, pi] [rad]."""
        return math.remainder(math.radians(self.heading_deg), math.tau)


UNTAGGED = 0xFFFF  # as a tag: none


class Robot(Model):
    """A robot of the fleet."""

    id: Name
    """Name of the robot on the bus, in messages and in the summary."""
    tag: Annotated[int, Field(ge=0, le=UNTAGGED)] = UNTAGGED
    """Id of its AprilTag, of the family ``tracker.family``, where a camera must see it. 65535: it has none; messages
    then use the lowest free number."""
    body: Annotated[str, Field(min_length=1, max_length=100)] | None = None
    """Name of its body in the motion capture (``tracker.source: mocap``); null: its id."""
    unit: Name | None = None
    """Name of the driver process that drives it, with all robots of the same unit; null: see ``drivers``."""
    tag_height_m: Height | None = None
    """Height of its tag above the floor; null: ``tracker.tag_height_m``."""
    driver: Named = "simulated"
    """Its driver: an entry point of ``robofleet.drivers``, or ``module:Class``."""
    settings: Annotated[dict[Text, JsonValue], Field(max_length=MANY)] = Field(default={})
    """Settings of its driver, for example the serial port. ``drivers/README.md`` lists them."""
    twin: Named | None = None
    """Firmware twin that answers in the robot's place: an entry point of ``robofleet.twins``, or ``module:Class``. The
    run makes its port, unless ``settings.port`` is ``udp://127.0.0.1:PORT``. null: none."""
    reality: Literal["real", "simulated"] = "real"
    """``real``: the robot stands in the arena, and the camera sees it. ``simulated``: no camera sees it; the tracker
    adds its pose to those of the others."""
    vehicle: Vehicle
    """Kind of the robot."""
    sensors: bool = False
    """``true``: its driver reads its sensors (``vehicle.sensors``). The law does not use them."""
    calibration: RobotCalibration | None = None
    """What ``robofleet calibrate`` measured of the robot; null: nothing was measured."""
    park: StartPose | None = None
    """Where the robot is parked after a run with ``run.end: park``, and by ``robofleet park``."""
    start: StartPose | None = None
    """Where the robot's centre is at first. A simulated robot begins there. Somebody puts a real robot there by hand.
    null: on the group's path, each robot ``spacing_m`` behind the other; one in no group needs a start."""

    @property
    def body_name(self) -> str:
        """The name of its body in the motion capture."""
        return self.body or self.id

    @property
    def tag_offset(self) -> TagOffset:
        """Where its tag, or its body, sits, as it was measured; else at its centre."""
        return TagOffset() if self.calibration is None else self.calibration.tag_offset
