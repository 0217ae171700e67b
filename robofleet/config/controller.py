"""The controller of a configuration: the NR flow and its tick, the fleet filter, the barrier."""

from typing import Annotated, Literal

from robofleet.config.model import Delay, Fraction, Model, Noise, within


class FilterSettings(Model):
    """The fleet filter: standard deviations of a pose measurement, and the prediction's loss of certainty."""

    position_noise_m: Noise = 0.0004
    """Of a measured position, along each axis."""
    heading_noise_rad: Noise = 0.006
    """Of a measured heading."""
    position_drift_m: Noise = 0.0015
    """What a prediction is off after one second; it grows with the root of the time."""
    heading_drift_rad: Noise = 0.06
    """The same of the heading."""
    efficiency_sigma: Fraction = 0.15
    """Of a wheel's true travel over the believed one, in the long run."""
    efficiency_time_s: Annotated[float, within(1e-3, 1e6)] = 20.0
    """In which it is forgotten."""
    gate_sigma: Annotated[float, within(0.1, 1e6)] = 5.0
    """A measurement further off than so many standard deviations is an outlier."""
    lost_after_s: Annotated[float, within(1e-3, 100)] = 0.5
    """Without a measurement for so long, a robot is lost and stands still."""


class BarrierSettings(Model):
    """The barrier between robots: distances follow from these, the bodies and what is believed of the drives."""

    gap_m: Annotated[float, within(0, 10)] = 0.01
    """What two bodies keep at the worst."""
    age_s: Annotated[float, within(0, 10)] = 0.133
    """Of the newest image at a tick, at most: 100 ms of delay, and a tick."""
    rate_per_s: Annotated[float, within(1e-3, 1e4)] = 10.0
    """How fast a distance may be used up (gamma of the barrier)."""
    ahead_m: Annotated[float, within(1e-4, 10)] = 0.01
    """Of the axle: the point that is kept apart."""


class ControllerSettings(Model):
    """The NR flow and its tick."""

    tick_s: Annotated[float, within(1e-3, 1)]
    """From one control step to the next."""
    alpha: Annotated[float, within(1e-3, 1e6)]
    """Speed-up of the flow [1/s]."""
    horizon_s: Annotated[float, within(1e-3, 100)]
    """How far ahead is predicted (T)."""
    point_ahead_m: Annotated[float, within(1e-4, 10)]
    """Of the axle: the point p that is controlled (l)."""
    integrator: Literal["exact", "euler"] = "exact"
    """Of the flow over a tick; ``euler`` is the paper's."""
    disturbance: Literal["estimated", "none"] = "none"
    """What the law knows of wheels that do not do as asked; ``estimated``: offset-free."""
    command_delay_s: Delay = 0.002
    """From the tick to the moment when its commands act."""
    filter: FilterSettings = FilterSettings()
    """Where each robot is, from its poses and its commands."""
    barrier: BarrierSettings = BarrierSettings()
    """What keeps robots apart and inside the arena."""
