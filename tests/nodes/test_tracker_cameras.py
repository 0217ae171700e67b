"""Any camera through the tracker. Its troubles are news, with an image or without, and a bad one gives no pose."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import SimpleQueue
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from robofleet.bus.keys import CAMERA, NEWS, POSES, TICK, key
from robofleet.bus.messages import TRACKER_NEWS, FleetPoses, TickRecord
from robofleet.core.clock import MS, S
from robofleet.runs import table
from robofleet.runs.check import refusals
from robofleet.simulation.camera import SceneRenderer
from robofleet.simulation.scene import scene_renderer
from robofleet.tracking.events import TrackerEvent
from robofleet.tracking.sources import CameraContext, CameraError, Frame

Make = Callable[..., Any]
E = TrackerEvent
PERIOD_NS = 33 * MS


class Plugged:
    """A camera that gives what the test feeds it; an error is raised, and told from the outside when it is opened."""

    feed: ClassVar["SimpleQueue[Frame | Exception]"]
    openings: ClassVar[list[Exception]]
    opened: ClassVar[int]
    closed: ClassVar[int]
    context: ClassVar[CameraContext]
    identity = "plugged 1"

    def __init__(self, context: CameraContext) -> None:
        type(self).opened += 1
        type(self).context = context
        if self.openings:
            raise self.openings.pop(0)

    def read(self) -> Frame:
        what = self.feed.get(timeout=10)
        if isinstance(what, Exception):
            raise what
        return what

    def close(self) -> None:
        type(self).closed += 1


class Stand:
    """A tracker with a camera, and what it says."""

    def __init__(self, bench: Any, renderer: SceneRenderer) -> None:
        self.bench = bench
        self.woken = threading.Semaphore(0)
        self._messages: list[tuple[str, bytes]] = []
        bench.bus.tap(self._messages.append)
        self.node = bench.made(table.TRACKER, self._wake)
        self._renderer = renderer

    def _wake(self, _instant_ns: int) -> None:
        self.woken.release()

    def image(self) -> NDArray[np.uint8]:
        """Return what a camera would see of the robots at their start."""
        poses = [[robot.start.x_m, robot.start.y_m, robot.start.psi] for robot in self.bench.config.robots]
        return self._renderer.render(np.array(poses))

    def give(self, what: NDArray[np.uint8] | Exception) -> None:
        """Let the camera give this a period later, and step the tracker that it wakes."""
        self.bench.wait(PERIOD_NS)
        Plugged.feed.put(what if isinstance(what, Exception) else Frame(what, self.bench.now_ns - 5 * MS))
        assert self.woken.acquire(timeout=10)
        self.node.step(self.bench.now_ns)

    @property
    def news(self) -> list[tuple[TrackerEvent, float]]:
        """Every event of the camera so far, with its value."""
        wanted = key(self.bench.config.arena.name, NEWS, CAMERA)
        messages = [TRACKER_NEWS.decode(payload) for full, payload in self._messages if full == wanted]
        assert [message.seq for message in messages] == list(range(1, len(messages) + 1))
        return [(TrackerEvent(m.event), m.value) for m in messages if m.event >= TrackerEvent.CAMERA_STALLED]

    @property
    def events(self) -> list[TrackerEvent]:
        return [event for event, _ in self.news]

    @property
    def frames(self) -> int:
        return len(self.bench.heard(POSES, CAMERA))


@pytest.fixture(scope="module")
def renderer(platoon_of: Make) -> SceneRenderer:
    return scene_renderer(platoon_of(), np.random.default_rng(5))


@pytest.fixture
def plugged(bench_of: Make, platoon_of: Make, renderer: SceneRenderer) -> Iterator[Make]:
    Plugged.feed, Plugged.openings, Plugged.opened, Plugged.closed = SimpleQueue(), [], 0, 0
    stands = []

    def make(*overrides: str) -> Stand:
        source = f"camera.source='{__name__}:Plugged'"
        stands.append(Stand(bench_of(platoon_of(source, "camera.trigger=free", *overrides)), renderer))
        return stands[-1]

    yield make
    for stand in stands:
        Plugged.feed.put(EOFError())
        stand.node.close()


def test_any_camera_is_read_in_a_thread_of_its_own(plugged: Make) -> None:
    stand = plugged()
    assert Plugged.context.config is stand.bench.config
    assert Plugged.context.clock is stand.bench.clock
    stand.bench.run(stand.node, S // 10)
    assert stand.frames == 0, "a camera that has no image holds nobody up"
    stand.give(stand.image())
    (frame,) = stand.bench.heard(POSES, CAMERA)
    assert frame.exposure_ns == stand.bench.now_ns - 5 * MS
    are_at_their_start(stand, frame)
    stand.node.step(stand.bench.now_ns)
    assert stand.frames == 1, "an image is used once"


def are_at_their_start(stand: Stand, frame: FleetPoses) -> None:
    for robot, pose in zip(stand.bench.config.robots, sorted(frame.poses), strict=True):
        assert pose.tag == robot.tag
        assert np.hypot(pose.x_m - robot.start.x_m, pose.y_m - robot.start.y_m) < 1e-3


def test_a_camera_that_ends_ends_quietly(plugged: Make) -> None:
    stand = plugged()
    Plugged.feed.put(EOFError())
    stand.bench.run(stand.node, S // 2)
    assert stand.frames == 0
    stand.node.close()
    assert Plugged.closed == 1


def test_an_unplugged_camera_is_news_without_an_image_and_comes_back(
    plugged: Make, capfd: pytest.CaptureFixture[str]
) -> None:
    stand = plugged()
    stand.give(stand.image())
    Plugged.openings.append(OSError("no such device"))
    stand.give(OSError("the cable"))
    assert stand.events == [E.CAMERA_UNPLUGGED]
    assert stand.frames == 1
    assert stand.woken.acquire(timeout=10)
    stand.node.step(stand.bench.now_ns)
    assert stand.events == [E.CAMERA_UNPLUGGED], "said once"
    stand.give(stand.image())
    assert [event for event, _ in stand.news] == [E.CAMERA_UNPLUGGED, E.CAMERA_BACK]
    assert stand.news[-1][1] == pytest.approx(2 * PERIOD_NS / S)
    assert stand.frames == 2
    assert Plugged.opened == 3
    stderr = capfd.readouterr().err
    assert "camera: the cable" in stderr
    assert "camera: no such device" in stderr


def test_bad_images_give_no_poses_and_are_named(plugged: Make) -> None:
    stand = plugged()
    frozen = stand.image()
    for _ in range(6):
        stand.give(frozen)
    assert stand.news == [(E.CAMERA_FROZEN, 3.0)]
    assert stand.frames == 1
    stand.give(stand.image()[:-1])
    stand.give(stand.image())
    assert stand.events == [E.CAMERA_FROZEN, E.CAMERA_RESIZED, E.CAMERA_BACK]
    assert stand.frames == 2
    are_at_their_start(stand, stand.bench.heard(POSES, CAMERA)[-1])


def test_a_camera_that_stalls_wakes_the_tracker_at_its_deadline(plugged: Make) -> None:
    stand = plugged()
    stand.give(stand.image())
    start_ns = stand.bench.now_ns
    stand.bench.run(stand.node, S)
    ((event, seconds),) = stand.news
    assert event is E.CAMERA_STALLED
    assert seconds == pytest.approx(0.25, abs=1e-6), "to the deadline, not to whatever woke it next"
    assert stand.bench.now_ns == start_ns + S
    stand.give(stand.image())
    assert stand.events == [E.CAMERA_STALLED, E.CAMERA_BACK]


def test_a_camera_that_waits_for_ticks_stalls_only_while_they_come(plugged: Make) -> None:
    stand = plugged("camera.trigger=tick")
    stand.bench.run(stand.node, 5 * S)
    ticks = iter(range(1, 1000))

    def tick() -> None:
        stand.bench.say(TICK, TickRecord(1, 1, next(ticks), -1, stand.bench.now_ns, *[0] * 11, (), ()))
        assert stand.woken.acquire(timeout=10)

    tick()
    stand.give(stand.image())
    tick()
    stand.bench.run(stand.node, 5 * S)
    assert stand.events == [], "the controller stopped"
    stand.bench.run(stand.node, 400 * MS, (PERIOD_NS, tick))
    assert stand.events == [E.CAMERA_STALLED]


@pytest.mark.parametrize(("calibrated", "good"), [("plugged 1", True), ("", True), ("plugged 2", False)])
def test_only_the_calibrated_camera_gives_poses(plugged: Make, calibrated: str, good: bool) -> None:
    stand = plugged(f"camera.model.camera='{calibrated}'")
    if good:
        stand.give(stand.image())
    else:
        assert stand.woken.acquire(timeout=10)
        stand.node.step(stand.bench.now_ns)
        Plugged.feed.put(Frame(stand.image(), stand.bench.now_ns))
        assert stand.woken.acquire(timeout=10), "it is looked at again"
        stand.bench.run(stand.node, S)
    assert stand.events == ([] if good else [E.CAMERA_STRANGE])
    assert stand.frames == int(good)


def test_a_camera_that_cannot_be_opened_at_the_start_ends_the_process(plugged: Make) -> None:
    Plugged.openings.append(CameraError("camera.width is refused"))
    with pytest.raises(CameraError, match=r"camera\.width is refused"):
        plugged()


def test_a_recording_runs_through_the_tracker_and_the_process_outlives_it(
    bench_of: Make, platoon_of: Make, renderer: SceneRenderer, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    tree = platoon_of("camera.source=files", "camera.trigger=free", f"camera.files={{path: '{tmp_path}'}}")
    stand_still = np.array([[robot.start.x_m, robot.start.y_m, robot.start.psi] for robot in tree.robots])
    for k in range(5):
        assert cv2.imwrite(str(tmp_path / f"{k * PERIOD_NS}.bmp"), renderer.render(stand_still))
    assert refusals(tree) == []
    stand = Stand(bench_of(tree), renderer)
    stand.bench.run(stand.node, 10 * S)
    assert stand.news == [], "it waits for the run"
    stand.bench.say(TICK, TickRecord(1, 1, 1, -1, stand.bench.now_ns, *[0] * 11, (), ()))
    stand.bench.run(stand.node, 10 * S)
    frames = stand.bench.heard(POSES, CAMERA)
    assert set(np.diff([frame.exposure_ns for frame in frames])) == {PERIOD_NS}
    assert len(frames) == 5
    for frame in frames:
        are_at_their_start(stand, frame)
    assert stand.news == [(E.CAMERA_ENDED, 5.0)]
    assert "all of its 5 images" in capfd.readouterr().err


def test_check_asks_the_camera(platoon_of: Make) -> None:
    def why(*overrides: str) -> dict[str, str]:
        return dict(refusals(platoon_of("camera.trigger=free", *overrides)))

    assert (
        "there is no camera /dev/none"
        in why("camera.source=v4l2", "camera.v4l2.device=/dev/none")["camera.v4l2.device"]
    )
    assert "/none.avi: No such file" in why("camera.source=files", "camera.files={path: /none.avi}")["camera.files"]
    assert why("tracker.source=truth", "camera.source=v4l2", "camera.v4l2.device=/dev/none") == {}
    assert why() == {}
