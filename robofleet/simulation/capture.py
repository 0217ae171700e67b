"""A simulated motion-capture system: it measures simulated robots, and is read as the real ones are.

Its frames are its own: ``tracker.mocap.rate_hz`` in a second, each ``latency_s`` late, with the noise that the settings
give, in the axes, units and frame that they say. ``camera.simulated.tag_offsets`` say where the bodies sit.
"""

import math

import numpy as np

from robofleet.bus.bus import Bus
from robofleet.config.mocap import MocapSettings
from robofleet.config.tree import Config
from robofleet.core.clock import Clock, S
from robofleet.simulation.arena import World
from robofleet.simulation.scene import true_offsets
from robofleet.tracking.bodies import Body
from robofleet.tracking.capture import CaptureFrame
from robofleet.tracking.offset import tag_from_centre


class SimulatedCapture:
    """Sends the bodies of the robots that stand in the arena."""

    def __init__(self, config: Config, bus: Bus, clock: Clock, rng: np.random.Generator) -> None:
        self._settings = s = config.tracker.mocap
        self._clock, self._rng = clock, rng
        self._robots = config.seen
        self._world = World(config, self._robots, bus)
        self._offsets = true_offsets(config)
        self._sigma = np.array([s.position_sigma_m, s.position_sigma_m, s.heading_sigma_rad])
        self._period_ns, self._latency_ns = round(S / s.rate_hz), round(s.latency_s * S)
        self._exposure_ns = clock.now_ns() + self._period_ns  # of the next frame

    def ready_ns(self) -> int:
        return self._exposure_ns + self._latency_ns

    def read(self) -> CaptureFrame:
        """Wait for the next frame; frames that were not waited for in time are lost."""
        now_ns = self._clock.now_ns()
        self._exposure_ns += max(0, (now_ns - self.ready_ns()) // self._period_ns) * self._period_ns
        self._clock.sleep_until(self.ready_ns())
        self._world.update()
        true = self._world.reported_at(self._exposure_ns)
        robots = zip(true.tolist(), self._offsets, strict=True)
        measured = np.array([tag_from_centre(x, y, psi, offset) for (x, y, psi), offset in robots]).reshape(-1, 3)
        measured += self._sigma * self._rng.standard_normal(measured.shape)
        rows = zip(self._robots, measured.tolist(), strict=True)
        bodies = {
            robot.body_name: body_of(x, y, psi, self._settings) for robot, (x, y, psi) in rows if not math.isnan(x)
        }
        self._exposure_ns += self._period_ns
        return CaptureFrame(bodies, self._clock.now_ns())

    def close(self) -> None:
        """Nothing to let go of."""


def body_of(x: float, y: float, psi: float, settings: MocapSettings) -> Body:
    """Return a body that lies flat at a pose [m, rad; world], in a system's own axes, units and frame."""
    origin = settings.origin
    c, s = math.cos(origin.psi), math.sin(origin.psi)
    dx, dy = (x - origin.x_m) / settings.unit_m, (y - origin.y_m) / settings.unit_m
    ahead, left = c * dx + s * dy, c * dy - s * dx
    half = (psi - origin.psi) / 2.0
    if settings.up == "y":
        return Body(ahead, 0.0, -left, 0.0, math.sin(half), 0.0, math.cos(half))
    return Body(ahead, left, 0.0, 0.0, 0.0, math.sin(half), math.cos(half))
