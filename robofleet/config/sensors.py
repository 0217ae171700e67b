"""The sensors of a kind of robot beside its wheels' encoders: what it has, and the errors of simulated ones."""

from typing import Annotated

from pydantic import Field

from robofleet.core.settings import Coordinate, Degrees, Fraction, Length, Model, NonNegative, within
from robofleet.vehicles.sensors import MOST_DISTANCES

Microtesla = Annotated[float, within(-1e6, 1e6)]
Axes = Annotated[tuple[NonNegative, NonNegative, NonNegative], Field(strict=False)]
Period = Annotated[float, within(0.01, 10)]


class Gyro(Model):
    """A sensor of the robot's turning about its x, y and z axis."""

    noise_rad_s: Axes
    """Standard deviation of one reading of each axis."""
    bias_rad_s: NonNegative = 0.0
    """Largest constant error of each axis."""


class Accelerometer(Model):
    """A sensor of the specific force along the robot's x, y and z axis: at rest z is 9.8 m/s^2."""

    noise_m_s2: Axes
    """Standard deviation of one reading of each axis."""
    bias_m_s2: NonNegative = 0.0
    """Largest constant error of each axis."""
    x_m: Coordinate = 0.0
    """Place of the sensor ahead of the middle of the axle."""
    y_m: Coordinate = 0.0
    """Place of the sensor to the left of the middle of the axle."""


class Magnetometer(Model):
    """A sensor of the magnetic field along the robot's x, y and z axis."""

    field_ut: Annotated[tuple[Microtesla, Microtesla, Microtesla], Field(strict=False)]
    """Magnetic field of the laboratory along the world's x, y and z axis."""
    noise_ut: Axes
    """Standard deviation of one reading of each axis."""
    bias_ut: NonNegative = 0.0
    """Largest constant error of each axis."""


class Heading(Model):
    """The robot's own measurement of its heading."""

    noise_rad: Annotated[float, within(0, 10)]
    """Standard deviation of one reading."""
    bias_rad: Annotated[float, within(0, 10)] = 0.0
    """Largest constant error."""


class DistancePlace(Model):
    """Place and direction of a distance sensor on the robot."""

    x_m: Coordinate
    """Place ahead of the middle of the axle."""
    y_m: Coordinate
    """Place to the left of the middle of the axle."""
    heading_deg: Degrees
    """Direction in which it looks, from straight ahead, counter-clockwise."""


class Distances(Model):
    """Sensors of the distance to what is first on a ray: an arena's wall, an obstacle, or another robot's body."""

    range_m: Length
    """Farthest distance that is seen."""
    noise: Fraction = 0.0
    """Standard deviation of one reading, relative to the distance."""
    dropout: Fraction = 0.0
    """Share of the readings that see nothing although something is in range."""
    outliers: Fraction = 0.0
    """Share of the other readings that are anything between 0 and the range."""
    places: Annotated[tuple[DistancePlace, ...], Field(min_length=1, max_length=MOST_DISTANCES, strict=False)]
    """Places and directions, in the order of the readings."""


class SensorSettings(Model):
    """Sensors of a kind of robot beside its wheels' encoders; null: it has none. The errors are those of simulated
    robots and twins; each run draws a constant error once, uniformly, between minus and plus the given value."""

    period_s: Period
    """Time between two readings on the bus. A driver looks every 10 ms."""
    gyro: Gyro | None = None
    """Sensor of the turning."""
    accelerometer: Accelerometer | None = None
    """Sensor of the acceleration."""
    magnetometer: Magnetometer | None = None
    """Sensor of the magnetic field."""
    heading: Heading | None = None
    """The robot's own heading."""
    distances: Distances | None = None
    """Distance sensors."""
