"""A script of one's own in lockstep: what it wishes is done, checked, recorded, and repeated to the bit."""

import json
import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from typer.testing import CliRunner

import robofleet
from robofleet import Fleet, FleetError
from robofleet.bus.messages import SCRIPT_WISH, TICK_RECORD, RobotWish, ScriptWish
from robofleet.cli import app
from robofleet.recording import notes
from robofleet.recording.reading import read
from robofleet.recording.run import Run
from robofleet.reports.timeline import Timeline
from robofleet.safety.supervisor import Event

pytestmark = pytest.mark.usefixtures("unplotted")

CONFIGS = Path(__file__).parents[2] / "configs"
SCRIPT = CONFIGS / "script.yaml"
TRUTH = "tracker.source=truth"


def fleet(*settings: str, config: Path = SCRIPT, out: Path | bool = False, **how: Any) -> Fleet:
    return Fleet(config, lockstep=True, out=out, settings=[TRUTH, *settings], **how)


def drives(seed: int, out: Path | bool = False) -> Fleet:
    """Return a fleet after two seconds in which its script drove at random."""
    with fleet(seed=seed, out=out) as driven:
        rng = np.random.default_rng(seed)
        for _ in driven.ticks(2):
            driven.drive(rng.uniform([0.0, -1.0], [0.1, 1.0], (4, 2)))
    return driven


@pytest.mark.slow
def test_two_runs_of_a_script_leave_the_same_trace_and_another_seed_another_one() -> None:
    first, again, other = (drives(seed).summary["trace_hash"] for seed in (1, 1, 2))
    assert first == again != other


@pytest.mark.slow
@pytest.mark.parametrize("threads", [False, True])
def test_a_run_is_kept_as_any_other_and_is_replayed_to_the_bit(threads: bool, tmp_path: Path) -> None:
    out, over = tmp_path / "run", threading.Event()
    beside = threading.Thread(target=over.wait) if threads else None  # as a notebook has
    if beside is not None:
        beside.start()
    try:
        summary = drives(1, out).summary
    finally:
        over.set()
    assert {"run.mcap", "summary.json", "report.html", "metrics.csv"} <= {file.name for file in out.iterdir()}
    assert json.loads((out / "summary.json").read_text()) == json.loads(json.dumps(summary))
    assert (summary["outcome"], summary["cause"]) == ("completed", None)
    again = CliRunner().invoke(app, ["replay", str(out)])
    assert again.exit_code == 0, again.output
    assert "equal, bit for bit" in again.stdout


@pytest.mark.slow
def test_robots_do_what_was_wished_within_what_their_wheels_are_off() -> None:
    wished = np.array([[0.08, 0.0], [0.0, 0.6], [0.05, 0.3], [0.0, 0.0]])
    with fleet() as driven:
        times, poses = [], []
        for t in driven.ticks(4):
            driven.drive(wished)
            times.append(t)
            poses.append(driven.poses)
        after = 1.0  # the motors' lag is over
        at = np.searchsorted(times, after)
        span = times[-1] - times[at]
        way = np.array(poses)[at:]
        travelled = np.linalg.norm(np.diff(way[..., :2], axis=0), axis=2).sum(axis=0) / span
        turned = np.unwrap(way[..., 2], axis=0)
        assert travelled == pytest.approx(wished[:, 0], abs=0.01)
        assert (turned[-1] - turned[0]) / span == pytest.approx(wished[:, 1], abs=0.05)
    assert times == pytest.approx(np.arange(len(times)) * 0.033)
    assert len(times) == 122  # of 33 ms, in 4 s


def test_points_move_as_was_wished_and_stand_when_the_loop_ends() -> None:
    velocities = np.array([[0.05, 0.0], [0.0, 0.05], [-0.05, 0.0], [0.0, 0.05]])
    with fleet() as driven:
        before = driven.points
        for _ in driven.ticks(2):
            driven.move(velocities)
        assert driven.points - before == pytest.approx(2 * velocities, abs=0.015)
        for _ in driven.ticks(1):
            pass
        resting = driven.poses
        for _ in driven.ticks(1):
            pass
        assert driven.poses == pytest.approx(resting, abs=0.002)
        assert not driven.readings["left_output_rad_s"].any()


def test_robots_go_to_poses_and_who_is_not_named_stands() -> None:
    with fleet() as driven:
        before = driven.poses
        driven.go_to({"r1": (-0.6, 0.2, 90), "r4": (0.6, -0.2, 270)})
        poses = driven.poses
        assert poses[0] == pytest.approx((-0.6, 0.2, np.pi / 2), abs=0.02)
        assert poses[3] == pytest.approx((0.6, -0.2, -np.pi / 2), abs=0.02)
        assert poses[1:3] == pytest.approx(before[1:3], abs=0.003)
        driven.go_to({"r2": (-0.7, -0.5, 0)})
        assert driven.poses[1, :2] == pytest.approx((-0.7, -0.5), abs=0.01)


@pytest.mark.slow
def test_the_barrier_keeps_robots_apart_that_a_script_drives_at_each_other() -> None:
    with fleet() as driven:
        driven.go_to({"r1": (-0.5, 0.0, 0), "r3": (0.5, 0.0, 180)})
        nearest = np.inf
        for _ in driven.ticks(8):
            driven.drive([[0.15, 0.0], [0.0, 0.0], [0.15, 0.0], [0.0, 0.0]])
            nearest = min(nearest, np.linalg.norm(driven.poses[0, :2] - driven.poses[2, :2]))
    assert nearest < 0.3  # they did meet
    assert driven.summary["min_gap_mm"] >= 10.0
    assert driven.summary["filtered_fraction"] > 0.0


@pytest.mark.slow
def test_a_plain_configuration_is_driven_as_one_group_of_all_its_robots() -> None:
    with fleet(config=CONFIGS / "two-groups.yaml") as driven:
        assert driven.robots == tuple(robot.id for robot in driven.config.members)
        for _ in driven.ticks(0.2):
            driven.drive(np.zeros((len(driven.robots), 2)))
    assert list(driven.summary["groups"]) == ["script"]


@pytest.mark.parametrize(
    ("wish", "why"),
    [
        (lambda f: f.drive(np.full((4, 2), np.nan)), "r1 is not finite"),
        (lambda f: f.drive([[0, 0], [0, np.inf], [0, 0], [0, 0]]), "r2 is not finite"),
        (lambda f: f.drive(np.zeros((3, 2))), r"the shape is \(3, 2\), must be \(4, 2\)"),
        (lambda f: f.drive({"r1": (0.1, 0.0)}), r"dict is no array of numbers, must be \(4, 2\)"),
        (lambda f: f.drive([[0.1], [0.1, 0.0]]), "list is no array"),
        (lambda f: f.move(np.zeros((2, 4))), r"the shape is \(2, 4\)"),
        (lambda f: f.go_to({"r9": (0, 0, 0)}), "no robot 'r9' in the group: it has r1, r2, r3, r4"),
        (lambda f: f.go_to({"r1": (0, 0)}), "is no pose"),
        (lambda f: f.go_to({"r1": (0, float("nan"), 0)}), "is no pose"),
        (lambda f: f.go_to({"r1": (1.59, 0, 0)}), "r1's goal from the edge"),
        (lambda f: f.go_to({"r1": (0, 0, 0), "r2": (0.05, 0, 0)}), "goals of r1 and r2"),
        (lambda f: f.go_to({}), "at least one"),
        (lambda f: f.keep(x=object()), "x is a object"),
        (lambda f: f.keep(x=[1, 10**400]), "x is an integer of 1329 bits"),
        (lambda f: f.keep(x=-(10**5000)), "x is an integer of 16610 bits"),
        (lambda f: f.keep(x=nested(1000)), "x has lists in lists"),
        (lambda f: f.mark("m", [[0, np.nan]]), "not finite"),
    ],
)  # fmt: skip
def test_what_cannot_be_meant_is_refused_in_the_script(driven: Fleet, wish: Callable[[Fleet], None], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        wish(driven)


def nested(levels: int) -> list[Any]:
    found: list[Any] = []
    for _ in range(levels):
        found = [found]
    return found


@pytest.fixture(scope="module")
def driven() -> Any:
    with fleet() as first:
        yield first


def of_wish(wish: ScriptWish, n: int = 4, v: float = 0.1) -> bytes:
    return SCRIPT_WISH.encode(wish._replace(robots=tuple(RobotWish(1, v, 0.0, 0.0) for _ in range(n))))


@pytest.mark.slow
@pytest.mark.parametrize("what", ["not finite", "too few robots", "unknown kind", "of the future", "beyond", "cut"])
def test_the_controller_takes_no_wish_that_fleet_would_not_have_sent(what: str) -> None:
    with pytest.raises(FleetError, match="no longer hears from its script"), fleet() as driven:
        link: Any = driven._link
        for k, t in enumerate(driven.ticks(2)):
            if t < 0.5:
                driven.drive(np.tile([0.05, 0.0], (4, 1)))
                good = echo(driven)
                continue
            tick = 10_000_000 if what == "of the future" else echo(driven)
            wish = ScriptWish(driven._epoch, 1000 + k, 99 if what == "unknown kind" else 1, 0, tick, ())
            payload = of_wish(wish, 3 if what == "too few robots" else 4, 1e7 if what == "beyond" else 0.1)
            if what == "not finite":
                payload = payload[:-24] + np.array([np.nan] * 3).tobytes()
            driven._commanded = True  # `ticks` says nothing for it
            link.wish(payload[:-1] if what == "cut" else payload)
    run = Run(link.run.recording, every_tick=True)
    wheels = np.stack([run.items["left_rad_s"], run.items["right_rad_s"]])
    assert wheels[:, run.ticks["tick"] == good].all()
    assert not wheels[:, run.ticks["tick"] > good + 3].any()


def echo(driven: Fleet) -> int:
    return int(TICK_RECORD.head_of(driven._record, "tick"))


@pytest.mark.slow
def test_a_script_that_says_nothing_stands_within_the_setting_and_one_resume_goes_on() -> None:
    with fleet("groups.0.settings.fresh_s=0.2") as driven:
        for _ in driven.ticks(1):
            driven.drive(np.tile([0.05, 0.0], (4, 1)))
        driven.drive(np.tile([0.05, 0.0], (4, 1)))
        link: Any = driven._link
        newest = echo(driven)
        link.run.advance(1.0)
        assert driven.phase == "hold"
        assert link.status.cause is Event.SCRIPT_SILENT
        run = Run(link.run.recording, every_tick=True)
        late = run.ticks["tick"] > newest
        moving = np.abs(run.items["left_rad_s"][late]).max(axis=1) > 0.0
        assert int(moving.argmin()) == 6  # ticks: 0.2 s, and no longer
        assert not moving[6:].any()
        with pytest.raises(FleetError, match="is held: r1: the behaviour of its group script no longer hears"):
            next(driven.ticks())
        driven.resume()
        for _ in driven.ticks(1):
            driven.drive(np.tile([0.05, 0.0], (4, 1)))
        assert driven.phase == "running"
    assert driven.summary["outcome"] == "completed"


def test_an_error_of_the_script_ends_its_run_and_says_so(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), fleet(out=tmp_path / "run") as driven:
        for t in driven.ticks(1):
            driven.drive(np.tile([0.05, 0.0], (4, 1)))
            if t > 0.5:
                _ = 1 // 0
    cause = "the script ended by ZeroDivisionError: integer division or modulo by zero"
    assert (driven.summary["outcome"], driven.summary["cause"]) == ("stopped", cause)
    assert not Run(read(tmp_path / "run"), every_tick=True).statuses[0]["left_output_rad_s"][-1]


def test_hold_resume_and_stop() -> None:
    with pytest.raises(FleetError, match="emergency stop requested"), fleet() as driven:
        driven.hold()
        assert driven.phase == "hold"
        driven.resume()
        assert driven.phase == "running"
        for _ in driven.ticks(0.5):
            driven.drive(np.tile([0.05, 0.0], (4, 1)))
        driven.stop()
        assert driven.phase == "estop"
        next(driven.ticks())
    assert driven.summary["outcome"] == "fault"


def test_who_is_not_open_and_what_is_no_run_is_refused_in_a_line(tmp_path: Path) -> None:
    for use in (lambda f: f.poses, lambda f: f.phase, lambda f: f.drive([])):
        with pytest.raises(FleetError, match="not open"):
            use(Fleet(SCRIPT, lockstep=True))
    with pytest.raises(FleetError, match=r"has a run|has no run"):
        Fleet("nowhere").open()
    with pytest.raises(robofleet.ConfigError, match="did you mean 'fresh_s'"):
        fleet("groups.0.settings.fresh=1").open()
    (tmp_path / "file").touch()
    with pytest.raises(FleetError, match="exists already and is not empty") as refused:
        fleet(out=tmp_path).open()
    assert refused.value.__suppress_context__, "no other exception is shown with it"


@pytest.mark.slow
def test_a_closed_fleet_has_what_stays_and_refuses_what_has_passed(tmp_path: Path) -> None:
    closed, folder = drives(1), tmp_path / "run"
    for use in (
        lambda f: f.poses, lambda f: f.points, lambda f: f.readings, lambda f: f.sensors, lambda f: f.time,
        lambda f: f.phase, lambda f: next(f.ticks(1)), lambda f: f.drive(np.zeros((4, 2))),
        lambda f: f.move(np.zeros((4, 2))), lambda f: f.go_to({"r1": (0, 0, 0)}), lambda f: f.hold(),
        lambda f: f.say(""), lambda f: f.mark("here", []), lambda f: f.keep(n=1), lambda f: f.plot(),
    ):  # fmt: skip
        with pytest.raises(FleetError, match=r"^the fleet is closed$"):
            use(closed)
    assert (closed.robots, closed.tick_s, closed.folder) == (("r1", "r2", "r3", "r4"), 0.033, None)
    assert closed.config.arena.name == "script"
    assert closed.summary["outcome"] == "completed"
    assert closed._repr_html_() == f"&lt;Fleet {SCRIPT}: closed&gt;"
    kept = drives(1, folder)
    with pytest.raises(FleetError, match="has the run"):
        _ = kept.poses
    assert kept._repr_html_() == robofleet.load(folder)._repr_html_()
    assert len(kept.plot().axes) == 2


def test_a_notebook_shows_where_the_robots_are_now() -> None:
    with fleet() as driven:
        for _ in driven.ticks(1):
            driven.drive(np.tile([0.05, 0.0], (4, 1)))
        driven.mark("<goal>", [[0.1, 0.2]])
        page, figure = driven._repr_html_(), driven.plot()
    assert 2_000 < len(page) < 100_000
    assert all(text in page for text in ("script.yaml", "r4", "running, ", "M0.100 -0.200h0"))
    assert "<goal>" not in page
    assert len(figure.axes[0].patches) >= 4


@pytest.mark.slow
def test_what_a_script_says_marks_and_keeps_is_in_the_recording_the_report_and_the_summary(tmp_path: Path) -> None:
    out = tmp_path / "run"
    with fleet(out=out) as driven:
        for k, _ in enumerate(driven.ticks(0.3)):
            driven.drive(np.zeros((4, 2)))
            driven.mark("centre", driven.points.mean(axis=0))
            driven.mark("gone", [[0.0, 0.0]] if k < 3 else [])
        driven.mark("wall", [[-0.2, 0.3], [0.2, 0.3], [0.2, 0.4]], line=True)
        driven.say("formation\nclosed")
        driven.keep(rounds=3, error_mm=np.float64(1.5), gains=np.array([1.0, np.nan]))
        driven.keep(rounds=4, law="consensus")
    kept = driven.summary["groups"]["script"]["kept"]
    assert kept == {"rounds": 4, "error_mm": 1.5, "gains": [1.0, None], "law": "consensus"}
    assert json.loads((out / "summary.json").read_text())["groups"]["script"]["kept"] == kept
    recording = read(out)
    marks = notes.marks(recording, "script")
    assert [(type(mark).__name__, mark.name, len(mark.points)) for mark in marks] == [
        ("Dots", "centre", 1), ("Line", "wall", 3),
    ]  # fmt: skip
    assert [note.line for note in notes.of_group(recording, "script") if note.line] == [r"formation\nclosed"]
    assert "formation\\nclosed" in [entry.what for entry in Timeline(Run(recording), ()).entries]
    drawn = {entity.id: entity for entity in shown(out, "/arena")}
    assert {"script/centre", "script/wall"} <= drawn.keys()
    assert len(drawn["script/wall"].lines[0].points) == 3


def shown(out: Path, topic: str) -> list[Any]:
    """Return the entities that viewers draw of a topic, in their order."""
    with (out / "run.mcap").open("rb") as stream:
        messages = make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages(topics=[topic])
        return [entity for message in messages for entity in message.decoded_message.entities]


@pytest.mark.slow
def test_the_guides_first_script_works_as_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    found = re.search(r"^```python\n(.*?)^```$", (CONFIGS / "SCRIPTS.md").read_text(), re.DOTALL | re.MULTILINE)
    assert found is not None
    assert len(found[1].splitlines()) <= 15
    monkeypatch.chdir(tmp_path)
    (tmp_path / "configs").symlink_to(CONFIGS)
    exec(compile(found[1].replace("fleet.ticks(20)", "fleet.ticks(1)"), "SCRIPTS.md", "exec"), {})
    assert capsys.readouterr().out.startswith("completed ")
    (run,) = (tmp_path / "runs").iterdir()
    assert "spread_m" in json.loads((run / "summary.json").read_text())["groups"]["script"]["kept"]
