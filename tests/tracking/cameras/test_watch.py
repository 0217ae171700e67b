"""What a camera's images, or their absence, are called."""

from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from robofleet.core.clock import MS, S
from robofleet.tracking.cameras.watch import CameraWatch
from robofleet.tracking.events import Notice, TrackerEvent

WIDTH, HEIGHT = 160, 120
PERIOD_NS = 33 * MS
E = TrackerEvent


class Sight:
    """A watch, and a camera with noise that gives an image a period."""

    def __init__(self, *, noisy: bool = True) -> None:
        self.now_ns = S
        self.watch = CameraWatch((WIDTH, HEIGHT), PERIOD_NS, noisy, self.now_ns)
        self.rng = np.random.default_rng(3)
        self.scene = self.rng.integers(40, 200, (HEIGHT, WIDTH))
        self.newest = self.image()

    def image(self, sigma: float = 3.0) -> NDArray[np.uint8]:
        return np.clip(self.scene + self.rng.normal(0, sigma, self.scene.shape), 0, 255).astype(np.uint8)

    def look(self, image: NDArray[np.uint8] | None = None, exposure_ns: int | None = None) -> bool:
        """Take an image (default: a good one) a period after the last thing that happened."""
        self.now_ns += PERIOD_NS
        self.newest = self.image() if image is None else image
        return self.watch.look(self.newest, self.now_ns - 5 * MS if exposure_ns is None else exposure_ns, self.now_ns)

    def stamped(self, ahead_ns: int) -> int | None:
        """Take a good image of a camera whose clock is ahead; return when it is believed to have been exposed."""
        stamp_ns = self.now_ns + PERIOD_NS - 5 * MS + ahead_ns
        return self.watch.exposed_ns if self.look(exposure_ns=stamp_ns) else None

    def wait(self, ns: int, *, expected: bool = True) -> None:
        """Let time pass without an image, a millisecond a step."""
        for _ in range(ns // MS):
            self.now_ns += MS
            self.watch.wait(self.now_ns, expected=expected)

    def events(self) -> list[TrackerEvent]:
        return [happening.event for happening in self.watch.news()]


def test_the_same_picture_again_is_never_believed_and_soon_has_a_name() -> None:
    sight = Sight()
    sight.look()
    assert not any(sight.look(sight.newest.copy()) for _ in range(2))
    assert sight.events() == [], "a driver may hand a buffer out twice"
    assert not any(sight.look(sight.newest.copy()) for _ in range(50))
    ((event, _, repeats),) = sight.watch.news()
    assert (event, repeats) == (E.CAMERA_FROZEN, 3)
    assert sight.look()
    assert sight.watch.news() == (Notice(E.CAMERA_BACK, value=pytest.approx(53 * PERIOD_NS / S)),)


def test_pictures_that_come_twice_are_not_frozen() -> None:
    sight = Sight()
    for _ in range(10):
        assert sight.look()
        assert not any(sight.look(sight.newest.copy()) for _ in range(2))
    assert sight.events() == []


def test_an_image_that_is_not_later_than_the_last_is_the_same_again() -> None:
    sight = Sight()
    sight.look(exposure_ns=S)
    assert not sight.look(exposure_ns=S)
    assert not sight.look(exposure_ns=S - 1)
    assert sight.look(exposure_ns=S + 1)


def test_one_stamp_from_the_future_does_not_make_the_next_images_old() -> None:
    sight = Sight()
    assert sight.look()
    assert not sight.look(exposure_ns=sight.now_ns + 10 * S)
    assert all(sight.look() for _ in range(10))
    assert sight.events() == []


@pytest.mark.parametrize("jump_ns", [-S // 2, 5 * S, -3600 * S])
def test_a_clock_that_jumps_is_told_and_its_images_are_put_on_this_hosts_clock(jump_ns: int) -> None:
    sight = Sight()
    assert all(sight.look() for _ in range(10))
    for ahead_ns in (jump_ns, 0, jump_ns):  # it jumps back, too
        believed = [sight.stamped(ahead_ns) for _ in range(10)]
        assert believed == [None, None] + [sight.now_ns - 5 * MS - k * PERIOD_NS for k in range(7, -1, -1)]
    events = sight.watch.news()
    assert [event for event, _, _ in events] == [E.CLOCK_JUMPED] * 3
    assert [value for _, _, value in events] == pytest.approx([jump_ns / S, -jump_ns / S, jump_ns / S])


def test_late_images_are_no_jump_of_the_clock() -> None:
    sight = Sight()
    assert all(sight.look() for _ in range(10))
    sight.wait(S)
    sight.watch.news()
    for k in range(20):  # those that were waiting, all at once
        sight.now_ns -= PERIOD_NS - MS
        sight.look(exposure_ns=sight.now_ns - S + k * PERIOD_NS)
    assert E.CLOCK_JUMPED not in sight.events()
    sight.now_ns += S
    assert all(sight.stamped(0) == sight.now_ns - 5 * MS for _ in range(10))
    assert E.CLOCK_JUMPED not in sight.events()


def test_a_camera_that_becomes_slow_for_good_is_believed_to_be_as_late_as_it_says() -> None:
    sight = Sight()
    assert all(sight.look(exposure_ns=sight.now_ns + PERIOD_NS - 20 * MS) for _ in range(10))
    sight.now_ns += 280 * MS
    for _ in range(20):
        assert sight.look(exposure_ns=sight.now_ns + PERIOD_NS - 300 * MS)
        assert sight.watch.exposed_ns == sight.now_ns - 300 * MS
    assert sight.events() == []


def test_of_a_camera_whose_clock_was_never_right_nothing_is_believed() -> None:
    sight = Sight()
    assert not any(sight.look(exposure_ns=sight.now_ns + 10 * S) for _ in range(20))
    assert sight.events() == [E.CAMERA_FROZEN]


def test_a_camera_without_noise_may_give_equal_pictures() -> None:
    sight = Sight(noisy=False)
    assert all(sight.look(np.zeros((HEIGHT, WIDTH), np.uint8)) for _ in range(20))
    assert sight.events() == []


@pytest.mark.parametrize("quality", [95, 60])
def test_noise_tells_pictures_of_a_scene_at_rest_apart_even_through_jpeg(quality: int) -> None:
    sight = Sight()
    sight.scene = cv2.GaussianBlur(sight.scene.astype(np.float32), (0, 0), 3)
    for _ in range(300):
        jpeg = cv2.imencode(".jpg", sight.image(2.0), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        assert sight.look(cv2.imdecode(jpeg, cv2.IMREAD_GRAYSCALE))


@pytest.mark.parametrize(
    ("image", "width"),
    [
        (np.zeros((HEIGHT, WIDTH // 2), np.uint8), WIDTH // 2),
        (np.zeros((WIDTH, HEIGHT), np.uint8), HEIGHT),
        (np.zeros((HEIGHT, WIDTH, 3), np.uint8), WIDTH),
        (np.zeros((HEIGHT, WIDTH), np.uint16), WIDTH),
        (np.zeros(HEIGHT * WIDTH, np.uint8), 0),
        (np.zeros((0, 0), np.uint8), 0),
    ],
)
def test_an_image_of_another_size_or_kind(image: NDArray[np.uint8], width: int) -> None:
    sight = Sight()
    sight.look()
    assert not any(sight.look(image) for _ in range(20))
    assert sight.watch.news() == (Notice(E.CAMERA_RESIZED, value=width),)
    assert sight.look()
    assert sight.events() == [E.CAMERA_BACK]


def test_a_camera_that_stalls_is_told_at_the_deadline_and_once() -> None:
    sight = Sight()
    sight.look()
    seen_ns, deadline_ns = sight.now_ns, sight.watch.deadline_ns
    assert 5 * PERIOD_NS <= deadline_ns - seen_ns < S // 2, "sooner than a robot is lost"
    sight.wait(deadline_ns - seen_ns - MS)
    assert sight.events() == []
    sight.wait(10 * S)
    ((event, _, seconds),) = sight.watch.news()
    assert (event, seconds) == (E.CAMERA_STALLED, pytest.approx((deadline_ns - seen_ns) / S))
    assert sight.watch.deadline_ns is None
    assert sight.look()
    ((event, _, seconds),) = sight.watch.news()
    assert event is E.CAMERA_BACK
    assert seconds > 10
    sight.wait(S)
    assert sight.events() == [E.CAMERA_STALLED], "and the next time again"


def test_a_camera_that_was_just_opened_has_time_for_its_first_image() -> None:
    sight = Sight()
    sight.wait(2 * S)
    assert sight.events() == []
    sight.wait(2 * S)
    assert sight.events() == [E.CAMERA_STALLED]


def test_a_camera_that_nobody_triggers_does_not_stall() -> None:
    sight = Sight()
    sight.look()
    sight.wait(10 * S, expected=False)
    assert sight.events() == []
    assert sight.watch.deadline_ns is None
    sight.wait(200 * MS)
    assert sight.events() == [], "it is waited for from now on"
    sight.wait(200 * MS)
    assert sight.events() == [E.CAMERA_STALLED]


@pytest.mark.parametrize("event", [E.CAMERA_UNPLUGGED, E.CAMERA_STRANGE, E.CAMERA_ENDED])
def test_a_camera_that_is_gone_is_told_once_and_not_waited_for(event: TrackerEvent) -> None:
    sight = Sight()
    for _ in range(7):
        sight.look()
    for _ in range(5):
        sight.watch.lose(event)
        sight.wait(S)
    assert sight.watch.news() == (Notice(event, value=7 if event is E.CAMERA_ENDED else 0),)
    assert sight.watch.deadline_ns is None
    sight.look()
    assert sight.events() == [E.CAMERA_BACK]
    sight.wait(S)
    assert sight.events() == [E.CAMERA_STALLED], "and is waited for again"


WAYS = st.lists(st.sampled_from(["good", "again", "small", "wait", "untriggered", "unplugged", "strange"]), max_size=40)


def played(ways: list[str]) -> Iterator[tuple[str, bool | None, tuple[Notice, ...]]]:
    """Play what a camera may do, and give what was made of it."""
    sight = Sight()
    sight.look()
    for way in ways:
        believed = None
        match way:
            case "good":
                believed = sight.look()
            case "again":
                believed = sight.look(sight.newest.copy())
            case "small":
                believed = sight.look(np.zeros((8, 8), np.uint8))
            case "wait" | "untriggered":
                sight.wait(S, expected=way == "wait")
            case "unplugged":
                sight.watch.lose(E.CAMERA_UNPLUGGED)
            case "strange":
                sight.watch.lose(E.CAMERA_STRANGE)
        yield way, believed, sight.watch.news()


@given(WAYS)
@settings(deadline=None, derandomize=True, max_examples=60)
def test_every_trouble_is_said_once_and_ends_with_the_next_good_image(ways: list[str]) -> None:
    troubles: set[TrackerEvent] = set()
    for way, believed, news in played(ways):
        assert believed in (None, way == "good")
        for event, _, value in news:
            assert value >= 0
            if event is E.CAMERA_BACK:
                assert way == "good"
                assert troubles
                troubles.clear()
            else:
                assert event not in troubles
                troubles.add(event)
        if way == "good":
            assert not troubles
        if way in ("small", "unplugged", "strange"):
            assert troubles
