"""Motion-capture systems through their library: its own mock, and systems that do not answer."""

import itertools
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from robofleet.cli import app
from robofleet.config.files.names import SHIPPED
from robofleet.config.mocap import MocapSettings
from robofleet.core.clock import MS, S, WallClock
from robofleet.tracking import capture
from robofleet.tracking.bodies import Body
from robofleet.tracking.capture import CaptureDevice, bodies_there, open_capture
from robofleet.tracking.sources import CameraError

MOCAP = SHIPPED / "mocap.yaml"
LIBRARY = pytest.importorskip("motioncapture", reason="NO MOTIONCAPTURE: pip install 'robofleet[mocap]'")
BODIES = "r1(0.5,-0.25,0.1,0,0,0,1);r2(1,0,0,1,0,0,0)"  # the mock's: name(x, y, z, qw, qx, qy, qz)
MOCK = MocapSettings(system="mock", options={"rigid_bodies": BODIES, "frequency": "100"})
NINE = ["robots.0.id=r9", "robots.0.body=box", "groups.0.robots=[r9, r2, r3, r4]"]
CLOCK = WallClock()


def test_the_librarys_own_mock_is_asked_for_its_bodies_and_read() -> None:
    assert bodies_there(MOCK) == ["r1", "r2"]
    device = open_capture(MOCK, CLOCK)
    frames = [device.read() for _ in range(5)]
    assert frames[-1].bodies == {
        "r1": Body(0.5, -0.25, pytest.approx(0.1), 0, 0, 1, 0),
        "r2": Body(1, 0, 0, 0, 0, 0, 1),
    }
    arrivals = [frame.arrival_ns for frame in frames]
    assert all(other - before > 5 * MS for before, other in itertools.pairwise(arrivals))
    assert CLOCK.now_ns() - arrivals[-1] < 10 * S


def test_what_a_polled_system_gives_again_or_without_a_body_is_no_frame() -> None:
    capture = SimpleNamespace(rigidBodies={}, waitForNextFrame=lambda: None)
    device, places = CaptureDevice(capture, CLOCK, polled=True), []
    for x in (None, 1.0, 1.0, None, 1.0, 2.0, 2.0, 1.0):
        mock = {"rigid_bodies": f"r1({x},0,0,1,0,0,0)"}
        capture.rigidBodies = {} if x is None else LIBRARY.connect("mock", mock).rigidBodies
        if (frame := device.read()) is not None:
            places.append(frame.bodies["r1"].x)
    assert places == [1.0, 2.0, 1.0]


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setattr(capture, "_ANSWER_S", 1.0)
    yield


@pytest.mark.slow_after_first
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
        open_capture(MocapSettings(system=system, host="127.0.0.1"), CLOCK)  # type: ignore[arg-type]
    assert "\n" not in str(error.value)


@pytest.mark.slow
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
