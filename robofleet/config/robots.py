"""The robots of a configuration: what the controller believes of a kind of robot, and what a simulated one is like."""

import math
from typing import Annotated, Literal

from pydantic import Field, JsonValue

from robofleet.config.calibrated import RobotCalibration
from robofleet.config.model import (
    LAST_TAG,
    MANY,
    Coordinate,
    Degrees,
    Delay,
    Fraction,
    Height,
    Lag,
    Length,
    Model,
    Name,
    Named,
    Text,
    within,
)
from robofleet.vehicles.interface import Wiring


class PlantErrors(Model):
    """How far a simulated robot is from ideal. Spreads are half widths of a uniform draw, one a run."""

    motor_lag_s: Lag
    """Time constant of the wheel-speed loop."""
    speed_quantum_rad_s: Annotated[float, within(0, 100)]
    """One encoder count in one period of the loop; 0: continuous."""
    loop_period_s: Annotated[float, within(1e-4, 1)]
    """Of the robot's own wheel-speed loop."""
    deadband_rad_s: Annotated[float, within(0, 100)]
    """A turning wheel stops when less is commanded."""
    breakaway_rad_s: Annotated[float, within(0, 100)]
    """A wheel at rest stays there when less is commanded."""
    actuation_delay_s: Delay = 0.0
    """From a command's arrival to the moment when the wheels begin to follow it."""
    wheel_gain_error: Annotated[float, Field(gt=-1, lt=1)] = 0.0
    """Of both wheels' travel, relative."""
    wiring: Wiring = "straight"
    """Of motors and encoders together."""
    wheel_gain_spread: Fraction
    """Of each wheel's travel, relative."""
    wheel_base_spread: Fraction
    """Of the wheel base, relative."""
    slip_s_per_rad: Annotated[float, within(0, 10)]
    """Share of a wheel's travel that is lost at a yaw rate of 1 rad/s."""
    slip_noise: Annotated[float, within(0, 10)]
    """Standard deviation of the slip, relative to it."""
    top_speed_sag: Fraction
    """Share of the top speed that is lost when the battery is empty."""
    battery_life_s: Annotated[float, within(1, 1e10)]
    """From full to empty."""


class Vehicle(Model):
    """A kind of robot (a file of ``configs/robots``): what the controller believes, and the errors."""

    wheel_radius_m: Length
    """As believed."""
    wheel_base_m: Length
    """Between the wheels' points of contact."""
    body_radius_m: Length
    """Of the smallest disc around everything that can touch, about the middle of the axle."""
    max_wheel_speed_rad_s: Annotated[float, within(1e-2, 1e4)]
    """No wheel is asked for more."""
    max_speed_m_s: Annotated[float, within(1e-3, 1000)]
    """The robot is asked for no more."""
    max_wheel_acceleration_rad_s2: Annotated[float, within(1e-2, 1e6)]
    """The fastest change of a wheel's speed that the gate asks for."""
    motor_lag_s: Lag
    """Time constant of the wheel-speed loop, as believed."""
    simulated: PlantErrors
    """What a simulated robot of this kind is like."""


class StartPose(Model):
    """Where a simulated robot's centre stands at first [world frame]."""

    x_m: Coordinate
    """From the arena's centre, along its long side."""
    y_m: Coordinate
    """To the left of it."""
    heading_deg: Degrees
    """From the x axis, counter-clockwise."""

    @property
    def psi(self) -> float:
        """Heading in (-pi, pi] [rad]."""
        return math.remainder(math.radians(self.heading_deg), math.tau)


class Robot(Model):
    """One robot of the fleet."""

    id: Name
    """Its name on the bus, in messages and in the summary."""
    tag: Annotated[int, Field(ge=0, le=LAST_TAG)]
    """The id of its AprilTag, of the family 36h11."""
    tag_height_m: Height | None = None
    """Of its tag above the floor; null: ``tracker.tag_height_m``."""
    driver: Named = "simulated"
    """What moves it: an entry point of ``robofleet.drivers``, or a class, ``module:Class``."""
    settings: Annotated[dict[Text, JsonValue], Field(max_length=MANY)] = Field(default={})
    """Of its driver, as ``drivers/README.md`` lists them: its serial port, for example."""
    twin: Named | None = None
    """What answers on its serial port in the robot's place: an entry point of ``robofleet.twins``, or a class,
    ``module:Class``; its port is made, and goes before ``settings.port``. null: a robot that exists, or a
    ``simulated`` one."""
    reality: Literal["real", "simulated"] = "real"
    """``real``: the camera sees it; ``simulated``: it stands in no arena, and its pose is merged with what the camera
    sees of the others."""
    vehicle: Vehicle
    """The kind of robot that it is."""
    calibration: RobotCalibration | None = None
    """What ``tools/calibrate.py`` measured of it; null: nothing was."""
    start: StartPose
    """Where it stands at first, if it or its body is simulated."""
