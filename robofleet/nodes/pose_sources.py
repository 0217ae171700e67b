"""Where the tracker's poses come from: the images of a camera, the truth of a simulation, or another source."""

import sys
from contextlib import AbstractContextManager
from functools import partial

from robofleet.bus.bus import Wake
from robofleet.bus.messages import TagPose
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.core.compiling import Say, told
from robofleet.core.plugins import load
from robofleet.simulation import arena
from robofleet.simulation.sources import Trigger, VirtualPoses
from robofleet.tracking.cameras.exposure import exposure_controller
from robofleet.tracking.cameras.watch import CameraWatch
from robofleet.tracking.events import Notice
from robofleet.tracking.sight import FleetSight
from robofleet.tracking.sources import (
    CameraContext,
    Feed,
    Lost,
    Observation,
    Poller,
    PoseContext,
    PoseSource,
    Reader,
    ReopenedCamera,
    ScheduledCamera,
)

POSES = "robofleet.poses"


def camera_feed(context: CameraContext, wake: Wake) -> Feed:
    """Open the configured camera; CameraError, or what else it raises, where it cannot be opened."""
    camera = context.config.camera
    open_camera = partial(load("robofleet.cameras", camera.source), context)
    first = open_camera()
    device = ReopenedCamera(first, open_camera, camera.model.camera)
    return Poller(device) if isinstance(first, ScheduledCamera) else Reader(device, wake)


def pose_source(context: PoseContext) -> PoseSource:
    """Open the configured source; CameraError, or what else it raises, where it cannot be opened."""
    source: PoseSource = load(POSES, context.config.tracker.source)(context)
    return source


def compiling(config: Config, say: Say) -> AbstractContextManager[None]:
    """Tell ``say`` of the kernels that are compiled while the source of a tracker's poses is made here."""
    if config.tracker.source != "camera":
        return told(arena.KERNELS, say)
    from robofleet.simulation import draw  # noqa: PLC0415 - these load OpenCV
    from robofleet.tracking.tags import fit as tag_fit  # noqa: PLC0415
    from robofleet.tracking.tags import motion  # noqa: PLC0415

    simulated = draw.KERNELS if config.camera.rendered else ()
    return told((*arena.KERNELS, *simulated, *motion.KERNELS, *tag_fit.KERNELS), say)


class CameraPoses:
    """A camera's images through the detector, those that can be believed, and beside each the robots that stand in no
    arena: without an image they are gone too."""

    def __init__(self, context: PoseContext) -> None:
        config, camera = context.config, context.config.camera
        self._feed = feed = context.around(camera_feed(context, context.wake))
        self._ticks = context.ticks
        self._free, self._scheduled = camera.trigger == "free", isinstance(feed.device.camera, ScheduledCamera)
        period_s = 1 / camera.rate_hz if self._free else config.controller.tick_s
        self._watch = CameraWatch(
            (camera.width, camera.height), round(period_s * S), camera.noise_gray > 0, context.clock.now_ns()
        )
        self._seen_tick = 0  # the newest one when something came last
        self._why = ""
        self._seen: list[Notice] = []
        self._sight = FleetSight(config)
        self._virtual = VirtualPoses(config, config.virtual, context.bus, context.rng)
        self._exposure = exposure_controller(config, feed.device.exposure_limits()) if camera.adjusts_exposure else None

    def next_ns(self) -> int | None:
        times = [at_ns for at_ns in (self._feed.next_ns(), self._watch.deadline_ns) if at_ns is not None]
        return min(times, default=None)

    def observe(self, now_ns: int) -> Observation | None:
        taken = self._feed.take(now_ns)
        tick = self._ticks.newest
        if taken is None:
            # One tick without its image may be the last one before the controller stopped. A camera that knows when
            # its images come, and does not know the next one's time, waits for the run.
            waits = self._scheduled and self._feed.next_ns() is None
            expected = not waits if self._free else tick not in (self._seen_tick, self._seen_tick + 1)
            self._watch.wait(now_ns, expected=expected)
            return None
        self._seen_tick = tick
        if isinstance(taken, Lost):
            self._watch.lose(taken.event)
            self._report(taken.why)
            return None
        if not self._watch.look(taken.image, taken.exposure_ns, now_ns):
            return None
        exposed_ns = self._watch.exposed_ns
        assert exposed_ns is not None
        sight = self._sight.see(taken.image, exposed_ns)
        self._seen += sight.happenings
        if self._exposure is not None and taken.exposure is not None:
            exposure = self._exposure.look(self._sight.light(taken.image), taken.exposure)
            if exposure is not None:
                self._feed.device.adjust(exposure)
            self._seen += self._exposure.news()
        poses = tuple(TagPose(r.tag, r.after_ns, r.coasted_ns, r.x, r.y, r.psi, *r.covariance) for r in sight.poses)
        poses += self._virtual.at(exposed_ns)
        return Observation(exposed_ns, poses, sight.refused, taken.image)

    def news(self) -> tuple[Notice, ...]:
        seen = tuple(self._seen)
        self._seen.clear()
        return self._watch.news() + seen

    def close(self) -> None:
        self._feed.close()

    def _report(self, why: str) -> None:
        """Write to the process's log what an event has no room for."""
        if why and why != self._why:
            print(f"camera: {why}", file=sys.stderr)
        self._why = why


class TruthPoses:
    """The truth in an image's place: poses without pixels of a whole fleet, with a delay and its jitter."""

    def __init__(self, context: PoseContext) -> None:
        config = context.config
        self._settings, self._rng = config.tracker.truth, context.rng
        self._poses = VirtualPoses(config, config.robots, context.bus, context.rng)
        self._trigger = Trigger(config, context.ticks, context.clock)
        self._delay_ns = self._draw_delay()

    @staticmethod
    def works_in_lockstep(_config: Config) -> bool:
        return True

    def next_ns(self) -> int | None:
        """Return when the next observation will be ready; None: a message or an image will wake the process."""
        exposure_ns = self._trigger.next_ns()
        return None if exposure_ns is None else exposure_ns + self._delay_ns

    def observe(self, now_ns: int) -> Observation | None:
        """Return the observation that is ready, or None."""
        exposure_ns = self._trigger.next_ns()
        if exposure_ns is None or exposure_ns + self._delay_ns > now_ns:
            return None
        self._trigger.fire(now_ns)
        self._delay_ns = self._draw_delay()
        return Observation(exposure_ns, self._poses.at(exposure_ns), 0)

    def news(self) -> tuple[Notice, ...]:
        return ()

    def close(self) -> None:
        """Let go of the device."""

    def _draw_delay(self) -> int:
        p = self._settings
        return round((p.delay_s + p.jitter_s * self._rng.random()) * S)
