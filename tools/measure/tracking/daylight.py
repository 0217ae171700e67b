"""A tracker under a simulated camera while daylight changes: what its images show, and what it makes of them.

python -m tools.measure.tracking.daylight                     a minute: the light falls to 20 %, rises to 300 %
python -m tools.measure.tracking.daylight camera.exposure_control=fixed
"""

import math
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import numpy as np

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import TRUTH
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S, SimulatedClock
from robofleet.nodes.pose_sources import CameraPoses
from robofleet.tracking.camera import CameraGeometry
from robofleet.tracking.cameras.light import TagLight
from robofleet.tracking.events import Notice
from robofleet.tracking.sources import Exposure, PoseContext
from robofleet.tracking.tags.targets import robot_targets
from robofleet.tracking.tags.tracker import TagSighting
from tests.bus.alone import TRUTH as TRUTH_LAYOUT
from tests.bus.alone import Truth

PLATOON = Path(__file__).parents[3] / "configs" / "platoon.yaml"
TICK_NS = 33 * MS
V, OMEGA = 0.2, 2.0  # of the robots: all drive circles [m/s, rad/s]
CENTRES = np.array([(-1.0, 0.6), (1.0, 0.6), (-1.0, -0.6), (1.0, -0.6)])
MINUTE = "[{at_s: 5, light: 1.0}, {at_s: 25, light: 0.2}, {at_s: 30, light: 0.2}, {at_s: 57, light: 3.0}]"


class Shown(NamedTuple):
    at_s: float
    white: float  # grey of the brightest robot's white cells
    measured: int  # robots
    error_mm: float  # rms of those
    ready_ns: int  # from mid-exposure until the image came
    exposure_ns: int
    exposure: Exposure


class Day:
    """Four robots below a camera that follows ticks, and the tracker's part from the camera to the poses."""

    def __init__(self, *overrides: str) -> None:
        self.config = load_config(PLATOON, ["drivers.robots_per_process=1", *overrides])
        self.clock = SimulatedClock()
        self.clock.advance_to(S)
        bus: Any = MemoryBus("platoon", self.clock, 0)
        self._publish = [bus.publisher(TRUTH, robot.id) for robot in self.config.robots]
        self.ticks = cast(Any, SimpleNamespace(began_ns=S, newest=0, newest_stamp_ns=0, update=lambda: None))
        self._taken: list[Any] = []
        context = PoseContext(
            config=self.config, clock=self.clock, bus=bus, ticks=self.ticks, rng=np.random.default_rng(1),
            extra_delay_ns=0, wake=lambda _: None, real_time=False, around=self._watched,
        )  # fmt: skip
        self.source = CameraPoses(context)
        self._light = TagLight(robot_targets(self.config))
        self._eye = CameraGeometry.from_model(self.config.camera.model)
        self.news: list[tuple[float, Notice]] = []

    def _watched(self, feed: Any) -> Any:
        """Note what a camera's feed gives."""
        self._feed, take = feed, feed.take

        def noted(now_ns: int) -> Any:
            self._taken.append(take(now_ns))
            return self._taken[-1]

        feed.take = noted
        return feed

    def where(self, row: int, instant_ns: float) -> tuple[float, float, float]:
        psi = OMEGA * (instant_ns - S) / S + row
        x, y = CENTRES[row] + V / OMEGA * np.array([math.sin(psi), -math.cos(psi)])
        return float(x), float(y), math.remainder(psi, math.tau)

    def tick(self) -> Shown:
        self.ticks.newest += 1
        self.ticks.newest_stamp_ns = self.clock.now_ns()
        end_ns = self.clock.now_ns() + TICK_NS
        seen = None
        while seen is None:
            ready_ns = self.source.next_ns()
            later_ns = self.clock.now_ns() + 10 * MS
            self._to(later_ns if ready_ns is None else min(max(ready_ns, self.clock.now_ns()), later_ns))
            seen = self.source.observe(self.clock.now_ns())
        came_ns = self.clock.now_ns()
        frame = self._taken[-1]
        at_s = (seen.exposure_ns - S) / S
        self.news += [(at_s, notice) for notice in self.source.news()]
        true = {robot.tag: self.where(row, seen.exposure_ns) for row, robot in enumerate(self.config.robots)}
        measured = [pose for pose in seen.poses if pose.coasted_ns == 0]
        errors = [math.dist((pose.x_m, pose.y_m), true[pose.tag][:2]) for pose in measured]
        light = self._light.of(frame.image, self._eye, [TagSighting(tag, *pose, 0, 0) for tag, pose in true.items()])
        rms = 1e3 * math.sqrt(sum(e * e for e in errors) / max(len(errors), 1))
        self._to(max(end_ns, came_ns))
        self._taken.clear()
        after_ns = came_ns - seen.exposure_ns
        return Shown(at_s, light.white, len(measured), rms, after_ns, seen.exposure_ns, frame.exposure)

    def run(self, seconds: float) -> list[Shown]:
        return [self.tick() for _ in range(math.ceil(seconds * S / TICK_NS))]

    def _to(self, instant_ns: int) -> None:
        while self.clock.now_ns() < instant_ns:
            now_ns = min(self.clock.now_ns() + 10 * MS, instant_ns)
            self.clock.advance_to(now_ns)
            for row, publish in enumerate(self._publish):
                publish(TRUTH_LAYOUT.encode(Truth(1, now_ns, *self.where(row, now_ns), V, OMEGA)))


def main(overrides: list[str]) -> None:
    day = Day("camera.exposure_control=auto", f"camera.simulated.daylight={MINUTE}", *overrides)
    shown = day.run(60.0)
    for shot in shown[:: len(shown) // 30]:
        print(
            f"{shot.at_s:5.1f} s  white {shot.white:5.1f}  measured {shot.measured}  error {shot.error_mm:.3f} mm  "
            f"exposure {1e3 * shot.exposure.time_s:.2f} ms  gain {shot.exposure.gain:.1f} dB"
        )
    tail = shown[30:]
    print(f"white: {min(s.white for s in tail):.0f} to {max(s.white for s in tail):.0f}")
    print(f"images with all robots measured: {sum(s.measured == 4 for s in tail)} of {len(tail)}")
    print(f"error: {math.sqrt(np.mean([s.error_mm**2 for s in tail])):.4f} mm rms")
    print(f"news: {[(round(at, 1), n.event.name, round(n.value, 1)) for at, n in day.news]}")


if __name__ == "__main__":
    main(sys.argv[1:])
