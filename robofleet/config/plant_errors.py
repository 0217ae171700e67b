"""How a simulated robot differs from an ideal one."""

from typing import Annotated

from pydantic import Field

from robofleet.core.settings import Delay, Fraction, Lag, Model, within
from robofleet.vehicles.interface import Wiring

Error = Annotated[float, Field(gt=-1, lt=1)]


class PlantErrors(Model):
    """How a simulated robot differs from an ideal one. Each run draws the spreads once, uniformly, between minus and
    plus the value."""

    motor_lag_s: Lag
    """Time constant of the wheel-speed loop."""
    stop_lag_s: Lag | None = None
    """The same when commanded to stand; null: ``motor_lag_s``."""
    speed_quantum_rad_s: Annotated[float, within(0, 100)]
    """Speed of one encoder count in one period of the loop; 0: the speed is continuous."""
    loop_period_s: Annotated[float, within(1e-4, 1)]
    """Period of the robot's own wheel-speed loop."""
    deadband_rad_s: Annotated[float, within(0, 100)]
    """A turning wheel stops when commanded less."""
    breakaway_rad_s: Annotated[float, within(0, 100)]
    """A wheel at rest starts when commanded so much."""
    actuation_delay_s: Delay = 0.0
    """Time from a command's arrival until the wheels follow it."""
    wheel_gain_error: Error = 0.0
    """Relative error of both wheels' travel."""
    wheel_gain_difference: Error = 0.0
    """The right wheel's relative travel minus the left one's."""
    wheel_base_error: Error = 0.0
    """Relative error of the wheel base."""
    top_speed_error: Error = 0.0
    """Relative error of a wheel's top speed."""
    wiring: Wiring = "straight"
    """How motors and encoders are connected; all but ``straight`` are mistakes."""
    wheel_gain_spread: Fraction
    """Relative spread of each wheel's travel."""
    wheel_base_spread: Fraction
    """Relative spread of the wheel base."""
    slip_s_per_rad: Annotated[float, within(0, 10)]
    """Share of a wheel's travel that slips at 1 rad/s of yaw."""
    slip_noise: Annotated[float, within(0, 10)]
    """Relative standard deviation of the slip."""
    top_speed_sag: Fraction
    """Share of the top speed that an empty battery takes."""
    battery_life_s: Annotated[float, within(1, 1e10)]
    """Time from a full battery to an empty one."""


NO_ERRORS = PlantErrors(  # an ideal robot
    motor_lag_s=0.0, speed_quantum_rad_s=0.0, loop_period_s=0.01, deadband_rad_s=0.0, breakaway_rad_s=0.0,
    wheel_gain_spread=0.0, wheel_base_spread=0.0, slip_s_per_rad=0.0, slip_noise=0.0, top_speed_sag=0.0,
    battery_life_s=1e9,
)  # fmt: skip
