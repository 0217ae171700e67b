"""What a robot senses beside its wheels, and where a simulated one really is."""

from typing import NamedTuple


class SensorReading(NamedTuple):
    """What a robot senses beside its wheels; None of what it has not, or does not tell.

    Robot frame: origin at the middle of the axle, x ahead, y to the left, z up.

    Attributes:
        gyro: Rate about x, y, z [rad/s; CCW +].
        accelerometer: Specific force along x, y, z [m/s^2]. At rest z is +9.8.
        magnetometer: Magnetic field along x, y, z [T].
        heading: Heading by a compass or the like [rad; CCW +, in (-pi, pi], from a zero of its own].
        distances: Distances in the order of the kind's sensors [m]. NaN: that sensor sees nothing.
    """

    gyro: tuple[float, float, float] | None = None
    accelerometer: tuple[float, float, float] | None = None
    magnetometer: tuple[float, float, float] | None = None
    heading: float | None = None
    distances: tuple[float, ...] | None = None


class TruePose(NamedTuple):
    """Where a simulated robot really is [m, rad; world frame, CCW +] and how it moves [m/s, rad/s; body frame].

    Attributes:
        x: Position of the axle's middle along x [m; world].
        y: Position along y [m; world].
        psi: Heading [rad; world, CCW +].
        v: Speed ahead [m/s].
        omega: Yaw rate [rad/s; CCW +].
    """

    x: float
    y: float
    psi: float
    v: float
    omega: float
