"""Poses of a motion-capture system: its frames and the bodies in them, and the robots that stand in no arena."""

import sys
from collections.abc import Iterator
from functools import partial

from robofleet.config.faults import Complaint, did_you_mean
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.simulation.capture import SimulatedCapture
from robofleet.simulation.sources import VirtualPoses
from robofleet.tracking.bodies import FleetBodies
from robofleet.tracking.capture import CaptureFrame, bodies_there, open_capture
from robofleet.tracking.events import Notice
from robofleet.tracking.sources import (
    CameraError,
    Lost,
    Observation,
    Poller,
    PoseContext,
    Readable,
    Reader,
    ReopenedCamera,
)


class MocapPoses:
    """The robots' bodies, as the configured system measures them.

    The library tells no time of measurement, so a pose is true ``latency_s`` before its frame arrived here.
    """

    def __init__(self, context: PoseContext) -> None:
        config, settings = context.config, context.config.tracker.mocap
        self._latency_ns = round(settings.latency_s * S)
        self._bodies = FleetBodies(config)
        self._virtual = VirtualPoses(config, config.virtual, context.bus, context.rng)
        first: Readable[CaptureFrame]
        if settings.system == "simulated":
            first = SimulatedCapture(config, context.bus, context.clock, context.rng)
            device = ReopenedCamera(first, lambda: first, calibrated="")
        else:
            first = open_capture(settings, context.clock)
            device = ReopenedCamera(first, partial(open_capture, settings, context.clock), calibrated="")
        self._feed = Reader(device, context.wake) if context.real_time else Poller(device)
        self._failed = False

    @staticmethod
    def works_in_lockstep(config: Config) -> bool:
        return config.tracker.mocap.system == "simulated"

    @staticmethod
    def refusals(config: Config) -> Iterator[Complaint]:
        if not config.seen:
            yield "tracker.source", "there is no robot that it could measure, all are simulated: take truth"

    @staticmethod
    def unreachable(config: Config) -> Iterator[Complaint]:
        """Ask the system which bodies it tracks; returns that it does not answer, or whose body is not there."""
        settings = config.tracker.mocap
        if settings.system == "simulated":
            return
        try:
            bodies = bodies_there(settings)
        except CameraError as error:
            yield "tracker.mocap.host", str(error)
            return
        wanted = {robot.body_name for robot in config.seen}
        for i, robot in enumerate(config.robots):
            if robot.body_name in wanted and robot.body_name not in bodies:
                key, known = "body" if robot.body else "id", did_you_mean(robot.body_name, bodies)
                yield f"robots.{i}.{key}", f"{settings.system} tracks no body '{robot.body_name}': {known}"
        strange = [name for name in bodies if name not in wanted and name not in settings.others]
        if strange:
            names = ", ".join(strange)
            yield "tracker.mocap.others", f"the body of no robot: {names}: name the robot's body, or list it here"

    def next_ns(self) -> int | None:
        return self._feed.next_ns()

    def observe(self, now_ns: int) -> Observation | None:
        frame = self._feed.take(now_ns)
        if isinstance(frame, Lost):
            if not self._failed:
                print(f"motion capture: {frame.why}", file=sys.stderr)
            self._failed = True
            return None
        if frame is None:
            return None
        self._failed = False
        instant_ns = frame.arrival_ns - self._latency_ns
        poses, strange = self._bodies.poses(frame.bodies, instant_ns)
        return Observation(instant_ns, poses + self._virtual.at(instant_ns), strange)

    def news(self) -> tuple[Notice, ...]:
        return self._bodies.news()

    def close(self) -> None:
        self._feed.close()
