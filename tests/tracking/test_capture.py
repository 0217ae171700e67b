"""Motion-capture systems through their library: its own mock, and systems that do not answer."""

import itertools
import math
import threading
from collections.abc import Iterator
from queue import SimpleQueue
from typing import Any

import pytest
from typer.testing import CliRunner

from robofleet.cli import app
from robofleet.config.files.names import SHIPPED
from robofleet.config.mocap import MocapSettings
from robofleet.core.clock import MS, S, WallClock
from robofleet.tracking import capture
from robofleet.tracking.bodies import Body
from robofleet.tracking.capture import CaptureFrame, CaptureReader, bodies_there, open_capture
from robofleet.tracking.sources import CameraError

MOCAP = SHIPPED / "mocap.yaml"
LIBRARY = pytest.importorskip("motioncapture", reason="NO MOTIONCAPTURE: pip install 'robofleet[mocap]'")
BODIES = "r1(0.5,-0.25,0.1,0,0,0,1);r2(1,0,0,1,0,0,0)"  # the mock's: name(x, y, z, qw, qx, qy, qz)
MOCK = MocapSettings(system="mock", options={"rigid_bodies": BODIES, "frequency": "100"})
NINE = ["robots.0.id=r9", "robots.0.body=box", "groups.0.robots=[r9, r2, r3, r4]"]
CLOCK = WallClock()


def taken(reader: CaptureReader, woken: threading.Event) -> CaptureFrame:
    """Return the next frame that a reader has."""
    while True:
        assert woken.wait(10)
        woken.clear()
        if (frame := reader.take(CLOCK.now_ns())) is not None:
            return frame


def test_the_librarys_own_mock_is_asked_for_its_bodies_and_read_by_a_thread() -> None:
    assert bodies_there(MOCK) == ["r1", "r2"]
    woken = threading.Event()
    reader = CaptureReader(lambda: open_capture(MOCK), CLOCK, lambda _: woken.set())
    frames = [taken(reader, woken) for _ in range(5)]
    reader.close()
    assert frames[-1].bodies == {
        "r1": Body(0.5, -0.25, pytest.approx(0.1), 0, 0, 1, 0),
        "r2": Body(1, 0, 0, 0, 0, 0, 1),
    }
    arrivals = [frame.arrival_ns for frame in frames]
    assert all(other - before > 5 * MS for before, other in itertools.pairwise(arrivals))
    assert CLOCK.now_ns() - arrivals[-1] < 10 * S


class Scripted:
    """A system that does what it is told: a place is a frame of r1 there, NaN one without it, an error is raised."""

    def __init__(self, script: "SimpleQueue[float | Exception]") -> None:
        self.script, self.rigidBodies = script, {}  # the library's name

    def waitForNextFrame(self) -> None:
        what = self.script.get()
        if isinstance(what, Exception):
            raise what
        self.rigidBodies = (
            {}
            if math.isnan(what)
            else {"r1": LIBRARY.connect("mock", {"rigid_bodies": f"r1({what},0,0,1,0,0,0)"}).rigidBodies["r1"]}
        )


def test_a_system_that_fails_is_opened_again() -> None:
    script: SimpleQueue[float | Exception] = SimpleQueue()
    openings, woken = [], threading.Event()

    def open_again() -> Any:
        openings.append(Scripted(script))
        return openings[-1]

    reader = CaptureReader(open_again, CLOCK, lambda _: woken.set())
    for x in (1.0, ConnectionError("it has gone"), 2.0):
        script.put(x)
        if not isinstance(x, Exception):
            assert taken(reader, woken).bodies["r1"].x == x
    reader.close()
    script.put(EOFError())
    assert len(openings) == 2


def test_of_frames_that_nobody_took_the_newest_is_kept() -> None:
    script: SimpleQueue[float | Exception] = SimpleQueue()
    counted = threading.Semaphore(0)
    reader = CaptureReader(lambda: Scripted(script), CLOCK, lambda _: counted.release())  # type: ignore[arg-type,return-value]
    for x in (1.0, 2.0, 3.0):
        script.put(x)
        assert counted.acquire(timeout=10)
    frame = reader.take(CLOCK.now_ns())
    assert frame is not None and frame.bodies["r1"].x == 3.0
    assert reader.take(CLOCK.now_ns()) is None
    reader.close()
    script.put(EOFError())


def test_what_a_polled_system_gives_again_or_without_a_body_is_no_frame() -> None:
    script: SimpleQueue[float | Exception] = SimpleQueue()
    frames: SimpleQueue[float] = SimpleQueue()
    started = threading.Event()

    def take(_: int) -> None:
        started.wait(10)
        if (frame := reader.take(CLOCK.now_ns())) is not None:
            frames.put(frame.bodies["r1"].x)

    reader = CaptureReader(lambda: Scripted(script), CLOCK, take, polled=True)  # type: ignore[arg-type,return-value]
    started.set()
    for x in (math.nan, 1.0, 1.0, math.nan, 1.0, 2.0, 2.0, 1.0):
        script.put(x)
    assert [frames.get(timeout=10) for _ in range(3)] == [1.0, 2.0, 1.0]
    script.put(EOFError())
    reader.close()
    assert frames.empty()


def test_a_reader_that_is_closed_has_ended_its_thread() -> None:
    before = threading.active_count()
    reader = CaptureReader(lambda: open_capture(MOCK), CLOCK, lambda _: None)
    reader.close()
    assert threading.active_count() == before


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(capture, "_ANSWER_S", 1.0)
    yield


@pytest.mark.parametrize(
    ("system", "why"),
    [
        ("optitrack", r"optitrack at 127\.0\.0\.1 sends nothing within 1 s: start its streaming"),  # it hangs
        ("qualisys", r"qualisys at 127\.0\.0\.1(: the library motioncapture says: Error connecting| sends nothing)"),
        ("nokov", r"nokov at 127\.0\.0\.1(: the library motioncapture says: Unknown| sends nothing)"),  # not built in
    ],
)
@pytest.mark.usefixtures("impatient")
def test_a_system_that_does_not_answer_is_one_clear_error(system: str, why: str) -> None:
    with pytest.raises(CameraError, match=why) as error:
        open_capture(MocapSettings(system=system, host="127.0.0.1"))  # type: ignore[arg-type]
    assert "\n" not in str(error.value)


def test_a_system_that_returns_though_nothing_answers_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture, "_BODY_S", 0.1)
    with pytest.raises(
        CameraError, match=r"^vrpn at 127\.0\.0\.1 sends no body: .* compare tracker\.mocap\.host [^\n]*$"
    ):
        bodies_there(MocapSettings(system="vrpn", host="127.0.0.1"))


def test_a_library_that_is_missing_names_the_cure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture, "find_spec", lambda _: None)
    with pytest.raises(CameraError, match=r"motioncapture is missing: pip install 'robofleet\[mocap\]'"):
        bodies_there(MOCK)


def refused(*keys: str) -> str:
    """Return what `robofleet check` says of the shipped configuration with keys changed, with exit code 2."""
    result = CliRunner().invoke(app, ["check", str(MOCAP), *(word for key in keys for word in ("--set", key))])
    assert result.exit_code == 2, result.output
    return " ".join(result.output.split())


@pytest.mark.parametrize(
    ("keys", "refusal"),
    [
        (["robots.0.body=Rigid 1"], "robots.0.body: mock tracks no body 'Rigid 1': known: box, r1, r2, r3, r4"),
        (NINE, "tracker.mocap.others: the body of no robot: r1: name the robot's body, or list it here"),
        (["tracker.mocap.others=[box, r2]"], "tracker.mocap.others.1: r2 is the body of r2: remove it"),
        (["robots.1.body=r1"], "robots.1.body: r1 is robots.0's already"),
        (["tracker.mocap.system=vrpn"], "robots.0.driver: 'vrpn' cannot measure a simulated robot: give r1 a driver"),
        (["tracker.source=mocup"], "tracker.source: there is no source of poses 'mocup': did you mean 'mocap'?"),
        (["tracker.source=camera"], "robots.0.tag: is missing: a camera knows r1 by its tag"),
    ],
)
def test_what_cannot_work_is_refused_in_a_line(keys: list[str], refusal: str) -> None:
    where = {"r1": (-1.2, 0.5), "r2": (-1.4, 0.25), "r3": (-1.48, 0.1), "r4": (-1.4, -0.2), "box": (1.0, 0.0)}
    bodies = ";".join(f"{name}({x},{y},0,1,0,0,0)" for name, (x, y) in where.items())
    mock = ["tracker.mocap.system=mock", f"tracker.mocap.options={{rigid_bodies: {bodies!r}}}"]
    assert refusal in refused(*mock, *keys)


def test_lockstep_waits_for_no_real_system() -> None:
    result = CliRunner().invoke(app, ["run", str(MOCAP), "--lockstep", "--set", "tracker.mocap.system=mock"])
    assert result.exit_code == 2
    assert "'mocap' keeps real time, and lockstep does not: run without --lockstep" in " ".join(result.output.split())
