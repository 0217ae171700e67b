"""Robots to test with: GTernal's geometry and limits, without any of a robot's errors and with all of them."""

from dataclasses import replace

from robofleet.testing.behaviours import GTERNAL
from robofleet.vehicles.differential_drive import DifferentialDrive
from robofleet.vehicles.interface import Imperfections

__all__ = ["CREATE2", "CREATE2_IDEAL", "GTERNAL", "IDEAL", "WORN", "stalls"]

IDEAL = Imperfections(
    motor_lag=0.0, speed_quantum=0.0, loop_period=0.01, deadband=0.0, breakaway=0.0, wheel_gain_spread=0.0,
    wheel_base_spread=0.0, slip=0.0, slip_noise=0.0, top_speed_sag=0.0, battery_life=1e9,
)  # fmt: skip
WORN = Imperfections(
    motor_lag=0.08, speed_quantum=0.2244, loop_period=0.01, deadband=0.5, breakaway=0.7, wheel_gain_spread=0.03,
    wheel_base_spread=0.01, slip=0.02, slip_noise=0.2, top_speed_sag=0.1, battery_life=2400.0,
)  # fmt: skip
CREATE2 = DifferentialDrive(
    wheel_radius=0.036,
    wheel_base=0.235,
    max_wheel_speed=13.8,
    max_speed=0.3,
    motor_lag=0.1,
    max_wheel_acceleration=60.0,
)
CREATE2_IDEAL = replace(IDEAL, speed_quantum=0.8233, loop_period=0.015)


def stalls(robot: str, from_s: int, until_s: int) -> str:
    """Return a setting by which a robot stands again and again, each time for less than what holds the run."""
    each = (f"{{kind: motor_stuck, robot: {robot}, at_s: {at_s}, duration_s: 0.85}}" for at_s in range(from_s, until_s))
    return f"faults=[{', '.join(each)}]"
