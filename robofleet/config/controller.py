"""The controller of a configuration: the NR flow and its tick, the fleet filter, the barrier."""

from typing import Annotated, Literal

from robofleet.core.settings import Delay, Fraction, Model, Noise, within


class FilterSettings(Model):
    """The fleet filter, which estimates each robot's pose: noise of the measurements, and growth of the uncertainty
    between them."""

    position_noise_m: Noise = 0.0004
    """Standard deviation of a measured position along each axis."""
    heading_noise_rad: Noise = 0.006
    """Standard deviation of a measured heading."""
    position_drift_m: Noise = 0.0015
    """Standard deviation of a predicted position after one second. It grows with the square root of the time."""
    heading_drift_rad: Noise = 0.06
    """Standard deviation of a predicted heading after one second. It grows with the square root of the time."""
    efficiency_sigma: Fraction = 0.15
    """Standard deviation, over a long time, of a wheel's efficiency: its true travel divided by the expected travel."""
    efficiency_time_s: Annotated[float, within(1e-3, 1e6)] = 20.0
    """Time constant with which the filter forgets a wheel's efficiency."""
    gate_sigma: Annotated[float, within(0.1, 1e6)] = 5.0
    """A measurement that is off by more standard deviations than this is rejected as an outlier."""
    lost_after_s: Annotated[float, within(1e-3, 100)] = 0.5
    """A robot without a measurement for this long is lost: it stands still."""


class BarrierSettings(Model):
    """The control barrier function (CBF), which keeps robots apart. Its distances follow from these values, the
    robots' bodies and the uncertainty of their drives."""

    gap_m: Annotated[float, within(0, 10)] = 0.01
    """Smallest gap between two bodies in the worst case."""
    age_s: Annotated[float, within(0, 10)] = 0.133
    """Largest age of the newest image at a tick: a delay of 100 ms, and one tick."""
    rate_per_s: Annotated[float, within(1e-3, 1e4)] = 10.0
    """Rate at which two robots may use up the distance between them (gamma of the barrier)."""
    ahead_m: Annotated[float, within(1e-4, 10)] = 0.01
    """Distance ahead of the axle of the point that the barrier keeps apart from others."""


class ControllerSettings(Model):
    """The Newton-Raphson flow and its tick."""

    tick_s: Annotated[float, within(1e-3, 1)]
    """Time from one control step to the next."""
    alpha: Annotated[float, within(1e-3, 1e6)]
    """Gain of the flow [1/s]: the higher, the faster the error decays."""
    horizon_s: Annotated[float, within(1e-3, 100)]
    """Prediction horizon (T in the paper)."""
    point_ahead_m: Annotated[float, within(1e-4, 10)]
    """Distance ahead of the axle of the controlled point p (l in the paper)."""
    integrator: Literal["exact", "euler"] = "exact"
    """How the flow is integrated over a tick: ``exact``, or ``euler`` as in the paper."""
    disturbance: Literal["estimated", "none"] = "none"
    """``estimated``: the controller compensates the wheels' deviations that the filter estimates, without a remaining
    offset. ``none``: it trusts the wheels."""
    command_delay_s: Delay = 0.002
    """Time from the tick until its commands act on the wheels."""
    filter: FilterSettings = FilterSettings()
    """Filter that estimates each robot's pose from its measured poses and its commands."""
    barrier: BarrierSettings = BarrierSettings()
    """Barrier that keeps robots apart and inside the arena."""

    @property
    def filter_in_force(self) -> FilterSettings:
        """The filter's settings: where no disturbance is estimated, every wheel travels as believed."""
        changes = {} if self.disturbance == "estimated" else {"efficiency_sigma": 0.0}
        return self.filter.model_copy(update=changes)
