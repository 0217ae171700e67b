"""A camera that fails is opened again, by a thread or between two steps."""

import threading
from queue import SimpleQueue

import numpy as np
import pytest

from robofleet.core.clock import MS, S
from robofleet.tracking.events import TrackerEvent
from robofleet.tracking.sources import Frame, Lost, Poller, Reader, ReopenedCamera

IMAGE = np.zeros((4, 4), np.uint8)
E = TrackerEvent


class Scripted:
    """A camera that does what it is told next: an instant is an image of it, an error is raised."""

    identity = "scripted 1"

    def __init__(self, script: "SimpleQueue[int | Exception]") -> None:
        self.script = script
        self.closed = 0

    def read(self) -> Frame:
        what = self.script.get(timeout=10)
        if isinstance(what, Exception):
            raise what
        return Frame(IMAGE, what)

    def close(self) -> None:
        self.closed += 1
        self.script.put(EOFError())  # as a device that lets a waiting read fail


class Scheduled(Scripted):
    """The same without waiting: its next image is there at ``due_ns``."""

    due_ns = 0

    def ready_ns(self) -> int:
        return self.due_ns


def script(*whats: int | Exception) -> "SimpleQueue[int | Exception]":
    queue: SimpleQueue[int | Exception] = SimpleQueue()
    for what in whats:
        queue.put(what)
    return queue


def of(*openings: Scripted | Exception, calibrated: str = "") -> ReopenedCamera:
    """Return a camera that is these, one opening after the other."""
    waiting = iter(openings[1:])

    def open_again() -> Scripted:
        opening = next(waiting)
        if isinstance(opening, Exception):
            raise opening
        return opening

    return ReopenedCamera(openings[0], open_again, calibrated)


def wait(wakes: "SimpleQueue[int]", count: int) -> None:
    for _ in range(count):
        wakes.get(timeout=10)


@pytest.mark.parametrize("error", [OSError("gone"), RuntimeError(), ValueError("x"), ZeroDivisionError("y")])
def test_whatever_a_camera_raises_it_is_closed_and_opened_again(error: Exception) -> None:
    first, second = Scripted(script(1, error)), Scripted(script(2))
    camera = of(first, OSError("not yet"), second)
    assert camera.read() == Frame(IMAGE, 1)
    assert camera.read() == Lost(E.CAMERA_UNPLUGGED, str(error) or type(error).__name__)
    assert first.closed == 1
    assert camera.read() == Lost(E.CAMERA_UNPLUGGED, "not yet")
    assert camera.read() is None, "opened: ask again"
    assert camera.read() == Frame(IMAGE, 2)
    assert second.closed == 0


def test_a_camera_that_cannot_even_be_closed_is_opened_again() -> None:
    first = Scripted(script(OSError("gone")))
    first.close = lambda: 1 / 0  # type: ignore[assignment, return-value, method-assign]
    camera = of(first, Scripted(script(2)))
    assert isinstance(camera.read(), Lost)
    assert camera.read() is None
    assert camera.read() == Frame(IMAGE, 2)


def test_patience_grows_until_there_is_an_image_not_until_a_camera_can_be_opened() -> None:
    broken = [Scripted(script(OSError("gone"))) for _ in range(6)]
    camera = of(*broken, Scripted(script(1, OSError("gone"))))
    pauses = []
    while len(pauses) < 7:
        if isinstance(camera.read(), Lost):
            pauses.append(camera.pause_s())
    assert pauses == [0.2, 0.4, 0.8, 1.6, 2.0, 2.0, 0.2]


def test_a_camera_that_was_not_calibrated_is_not_read_until_it_is_the_right_one() -> None:
    strange, right = Scripted(script(1)), Scripted(script(2))
    strange.identity = "scripted 2"
    camera = of(strange, right, calibrated="scripted 1")
    lost = camera.read()
    assert isinstance(lost, Lost)
    assert lost.event is E.CAMERA_STRANGE
    assert "'scripted 2'" in lost.why
    assert "'scripted 1'" in lost.why
    assert strange.closed == 1
    assert camera.read() is None
    assert camera.read() == Frame(IMAGE, 2)


def test_a_camera_without_an_identity_is_not_the_one_that_was_calibrated() -> None:
    class Nameless:
        def read(self) -> Frame:
            return Frame(IMAGE, 1)

        def close(self) -> None:
            pass

    lost = ReopenedCamera(Nameless(), Nameless, "scripted 1").read()  # type: ignore[arg-type]
    assert isinstance(lost, Lost)
    assert lost.event is E.CAMERA_STRANGE


def test_a_reader_keeps_the_newest_image() -> None:
    queue, woken = script(), SimpleQueue()
    reader = Reader(of(Scripted(queue)), woken.put)
    assert reader.take(0) is None
    for exposure_ns in (1, 2, 3):
        queue.put(exposure_ns)
    wait(woken, 3)
    assert reader.take(0) == Frame(IMAGE, 3)
    assert reader.take(0) is None
    reader.close()


def test_a_reader_loses_neither_the_last_image_nor_why_it_was_the_last() -> None:
    queue, woken = script(1, 2, EOFError("all shown")), SimpleQueue()
    before = set(threading.enumerate())
    reader = Reader(of(Scripted(queue)), woken.put)
    wait(woken, 3)
    assert reader.take(0) == Frame(IMAGE, 2)
    assert reader.take(0) == Lost(E.CAMERA_ENDED, "all shown")
    assert reader.take(0) is None
    for thread in set(threading.enumerate()) - before:
        thread.join(5)
        assert not thread.is_alive(), "there is nothing left to read"
    reader.close()


def test_closing_a_reader_ends_its_thread_even_while_it_waits() -> None:
    before = set(threading.enumerate())
    camera = Scripted(script())
    reader = Reader(of(camera), SimpleQueue().put)
    (thread,) = set(threading.enumerate()) - before
    reader.close()
    reader.close()
    thread.join(5)
    assert not thread.is_alive()
    assert camera.closed == 1


def test_closing_a_reader_ends_one_that_gives_image_after_image() -> None:
    class Running(Scripted):
        def read(self) -> Frame:
            threading.Event().wait(0.002)
            return Frame(IMAGE, 1)

    before, woken = set(threading.enumerate()), SimpleQueue()
    camera = Running(script())
    reader = Reader(of(camera), woken.put)
    (thread,) = set(threading.enumerate()) - before
    wait(woken, 3)
    reader.close()
    assert not thread.is_alive(), "it is not closed under a read"
    assert camera.closed == 1


def test_a_poller_reads_when_the_image_is_there_and_not_before() -> None:
    camera = Scheduled(script(1, 2))
    camera.due_ns = 50 * MS
    poller = Poller(of(camera))
    assert poller.next_ns() == 50 * MS
    assert poller.take(49 * MS) is None
    assert poller.take(50 * MS) == Frame(IMAGE, 1)
    camera.due_ns = 90 * MS
    assert poller.take(89 * MS) is None
    assert poller.take(100 * MS) == Frame(IMAGE, 2)


def test_a_poller_opens_again_with_the_same_patience() -> None:
    second = Scheduled(script(7))
    second.due_ns = 5 * S
    poller = Poller(of(Scheduled(script(OSError("gone"))), OSError("a"), OSError("b"), second))
    now_ns, losses = S, []
    while len(losses) < 3:
        if isinstance(taken := poller.take(now_ns), Lost):
            losses.append((now_ns, taken.why))
        next_ns = poller.next_ns()
        now_ns = next_ns
    assert losses == [(S, "gone"), (S + 200 * MS, "a"), (S + 600 * MS, "b")]
    assert now_ns == S + 1400 * MS
    assert poller.take(now_ns) is None, "opened: its image is not there yet"
    assert poller.next_ns() == 5 * S
    assert poller.take(5 * S) == Frame(IMAGE, 7)
