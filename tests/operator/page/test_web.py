"""The operator's page as its browser sees it: what it is told, when, and what it can ask for."""

import base64
import json
from math import nan
from pathlib import Path

import httpx
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed

from robofleet.bus import keys, messages
from robofleet.bus.messages import Note, NoteKind, TagPose
from robofleet.core.clock import MS, S
from robofleet.core.starting import Starting
from robofleet.nodes.unit.state_store import FileStateStore, StoredRobot
from robofleet.safety.latches import GateStatus, Latch
from robofleet.safety.supervisor import Event, Phase
from robofleet.tracking.camera import CameraGeometry
from tests.operator.page.webstand import CLOCK, Frame, OpenPage, WebStand, placed, web_stand
from tests.runs.realrun import wait

TRUTH = "tracker.source=truth"


def row(hello: Frame, tick: Frame, robot: str) -> Frame:
    """Return a robot's values by their names."""
    ids = [robot_row["id"] for robot_row in hello["robots"]]
    return dict(zip(hello["columns"], tick["robots"][ids.index(robot)], strict=True))


def test_a_newcomer_sees_the_fleet_at_once_and_what_is_not_known_is_null(stand: WebStand) -> None:
    opened_ns = CLOCK.now_ns()
    with stand.page() as page:
        hello, tick = (page.heard_one() for _ in range(2))
        assert CLOCK.now_ns() - opened_ns < S
    assert (hello["type"], tick["type"]) == ("hello", "tick")
    assert hello["arena"] == {"name": "platoon", "size_m": [3.2, 2.0], "floor_m": None, "obstacles": []}
    assert [robot["id"] for robot in hello["robots"]] == stand.robots
    assert all(robot["safety_radius_m"] > robot["body_radius_m"] > 0 for robot in hello["robots"])
    (group,) = hello["groups"]
    assert (group["name"], group["behaviour"], group["robots"]) == ("platoon", "platoon", stand.robots)
    (path,) = group["shapes"]
    assert (path["kind"], path["name"], path["closed"], path["directed"]) == ("line", "path", True, True)
    assert all(abs(x) < 1.6 and abs(y) < 1.0 for x, y in path["points"])
    control = next(figure for figure in hello["figures"] if figure["key"] == "control_error_mm")
    assert (control["title"], control["unit"], control["robots"]) == ("control error", "mm", stand.robots)
    assert control["bounds"] == {"mean": 1.0, "max": None}
    assert (hello["cameras"], hello["duration_s"], hello["tick_ms"]) == ([], 88, 33)
    assert (tick["phase"], tick["t_s"], tick["cause"]) == ("starting", None, None)
    assert set(tick["health"].values()) == {None}
    nothing = dict.fromkeys(hello["columns"]) | {"figures": [None] * len(hello["figures"])}
    assert all(row(hello, tick, robot) == nothing for robot in stand.robots)


def test_a_tick_shows_what_the_controller_the_supervisor_and_the_drivers_say(stand: WebStand) -> None:
    stand.say_state(Phase.RUNNING, Event.PROVED, halted=Event.TAG_LATE)
    with stand.page() as page:
        hello = page.next("hello")
        page.next("tick", lambda tick: tick["phase"] == "running")
        stand.say_status("r1", GateStatus.NO_ENABLE, took_ns=31 * MS)
        stand.say_status("r2", took_ns=17 * MS)
        page.next("tick", lambda tick: row(hello, tick, "r2")["gate"])
        robots = [
            placed(0.5, 0.25, left_rad_s=3.456, filtered=1.0),
            placed(0.3, 0.25),
            placed(0.1, 0.25, lost=1.0, measured=0.0),
            placed(-0.1, 0.25),
        ]
        stand.say_tick(-1, *(robot._replace(lost=1.0) for robot in robots))  # overruns before the run are not the run's
        page.next("tick", lambda tick: tick["health"]["overruns"] is not None)
        figures = {
            "control_error": [0.00123, nan, 0.002, 0.003],
            "x": [0.6, nan, 0.2, 0.1],
            "y": [0.25, nan, 0.25, 0.25],
        }
        stand.say_tick(30, *robots, lateness_ns=42_000, overruns=10, figures=figures)
        tick = page.next("tick", lambda tick: tick["t_s"] is not None)
    assert (tick["t_s"], tick["clock_s"], tick["cause"]) == (0.99, 0.99, "every check passed")
    health = {"compute_us": 250, "late_us": 42, "overruns": 3, "latency_ms": 17.0, "tracker_hz": None, "seen_pct": None}
    assert tick["health"] == health
    first, second, third = (row(hello, tick, robot) for robot in ("r1", "r2", "r3"))
    assert (first["x_m"], first["point_x_m"], first["left_rad_s"]) == (0.5, 0.58, 3.46)
    shown = [figure["key"] for figure in hello["figures"]].index("control_error_mm")
    assert [robot_row["figures"][shown] for robot_row in (first, second, third)] == [1.23, None, 2.0]
    assert [robot_row["reference_x_m"] for robot_row in (first, second, third)] == [0.6, None, 0.2]
    assert (first["gate"], first["latch"], first["halted"]) == ("no enable", None, "it is not seen")
    assert (first["filtered"], first["lost"], first["battery"]) == (1, 0, 0.5)
    assert (second["gate"], second["halted"]) == ("open", None)
    assert 0 <= second["age_ms"] < 1000
    assert (third["lost"], third["x_m"], third["gate"], third["age_ms"]) == (1, None, None, None)


SCRIPT = Path(__file__).parents[3] / "configs" / "script.yaml"


def test_what_a_script_says_is_a_line_and_what_it_marks_is_on_the_floor(tmp_path: Path) -> None:
    marks = [("Dots", "centre", [[0.1, 0.2]]), ("Line", "wall", [[0.0, 0.0], [1.0, 0.0]]), ("Dots", "centre", [])]
    with web_stand(tmp_path, file=SCRIPT) as stand, stand.page() as page:
        page.next("hello")
        note = stand._bus.publisher(keys.NOTE, "script")
        for k, (kind, name, points) in enumerate(marks):
            text = json.dumps({"kind": kind, "name": name, "points": points})
            note(messages.NOTE.encode(Note(1, k, 0, NoteKind.MARK, text.encode())))
        note(messages.NOTE.encode(Note(1, 9, 0, NoteKind.MARK, b"{}")))  # it is nothing
        note(messages.NOTE.encode(Note(1, 10, 0, NoteKind.SAY, b'"<b>closed</b>"')))
        shapes = page.next("shapes", lambda frame: [shape["name"] for shape in frame["groups"][0]] == ["wall"])
        assert shapes["groups"][0][0]["points"] == [[0.0, 0.0], [1.0, 0.0]]
        assert page.next("event", lambda event: "closed" in event["text"])["text"] == "script: <b>closed</b>"


TWO = Path(__file__).parents[1] / "two_groups.yaml"


def test_each_group_is_told_with_its_own_figures_and_shapes(tmp_path: Path) -> None:
    with web_stand(tmp_path, file=TWO) as stand, stand.page() as page:
        hello = page.next("hello")
        tick_figures = {"control_error": [0.001] * 3, "radius_error": [nan] * 3 + [0.002, 0.003], "turned": [0.5] * 5}
        stand.say_state(Phase.RUNNING)
        stand.say_tick(3, figures={name: [*values, nan, nan][:5] for name, values in tick_figures.items()})
        tick = page.next("tick", lambda tick: tick["t_s"] is not None)
        figures = [figure["key"] for figure in hello["figures"]]
        shown = {
            robot["id"]: dict(zip(figures, row(hello, tick, robot["id"])["figures"], strict=True))
            for robot in hello["robots"]
        }
    assert [(group["name"], group["behaviour"]) for group in hello["groups"]] == [
        ("platoon", "platoon"), ("inner", "tests.nodes.swirl:Swirl"),
    ]  # fmt: skip
    assert [shape["kind"] for shape in hello["groups"][1]["shapes"]] == ["line", "dots"]
    assert [robot["group"] for robot in hello["robots"]] == ["platoon"] * 3 + ["inner"] * 2 + [None]
    assert "secret" not in figures, "it is not live"
    assert (shown["r1"]["control_error_mm"], shown["r1"]["radius_error_mm"]) == (1.0, None)
    assert (shown["s1"]["control_error_mm"], shown["s1"]["radius_error_mm"]) == (None, 2.0)
    assert shown["s1"]["turned_deg"] == pytest.approx(28.6479, abs=1e-4)
    assert set(shown["p1"].values()) == {None}, "a robot in no group has no figures"


def test_on_the_way_the_references_are_told_and_no_figures(stand: WebStand) -> None:
    with stand.page() as page:
        hello = page.next("hello")
        stand.say_state(Phase.POSITIONING, Event.SET_OUT)
        figures = {"control_error": [0.001] * 4, "x": [0.5] * 4, "y": [0.25] * 4}
        stand.say_tick(-1, figures=figures, phase=Phase.POSITIONING)
        tick = page.next("tick", lambda tick: row(hello, tick, "r1")["reference_x_m"])
    assert tick["phase"] == "positioning"
    assert set(row(hello, tick, "r1")["figures"]) == {None}


def test_on_the_way_the_page_knows_where_each_robot_goes_and_how_far_it_is(tmp_path: Path) -> None:
    with web_stand(tmp_path, TRUTH, "run.begin=go_to_start") as stand, stand.page() as page:
        hello = page.next("hello")
        goals = hello["places"]["positioning"]
        aways = (0.0, 0.5, 0.0, 0.0)
        robots = [placed(x + away, y, psi_rad=psi) for (x, y, psi), away in zip(goals, aways, strict=True)]
        stand.say_state(Phase.POSITIONING, Event.SET_OUT)
        stand.say_tick(-1, *robots, phase=Phase.POSITIONING)
        tick = page.next("tick", lambda tick: tick["way"] and row(hello, tick, "r2")["to_go_m"])
        assert [row(hello, tick, robot)["to_go_m"] for robot in stand.robots] == pytest.approx(aways, abs=1e-3)
        assert tick["what_next"].startswith("At their start: 3 of 4 robots; r2 has 0.50 m to go")
        stand.say_state(Phase.HOLD, Event.HOLD_REQUESTED)
        held = page.next("tick", lambda tick: tick["phase"] == "hold")
        assert (held["way"], "on its way to its start" in held["what_next"]) == ("positioning", True)
        stand.say_state(Phase.RUNNING, Event.AT_START)
        running = page.next("tick", lambda tick: tick["phase"] == "running")
    assert running["way"] is None
    assert row(hello, running, "r2")["to_go_m"] is None


def test_a_robot_whose_behaviour_failed_stands_in_words(stand: WebStand) -> None:
    with stand.page() as page:
        hello = page.next("hello")
        stand.say_state(Phase.HOLD, Event.BEHAVIOUR_RAISED, 1)
        failed = [Event.BEHAVIOUR_STANDS, Event.BEHAVIOUR_RAISED, Event.BEHAVIOUR_STANDS, Event.BEHAVIOUR_STANDS]
        stand.say_tick(30, *(placed(0.1 * k, 0.0, failed=float(event)) for k, event in enumerate(failed)))
        tick = page.next("tick", lambda tick: row(hello, tick, "r1")["halted"])
    assert "r2: the behaviour of its group platoon failed" in tick["cause"]
    assert row(hello, tick, "r1")["halted"] == "the behaviour of its group failed, and all its robots stand"


@pytest.mark.slow
def test_a_silent_controller_is_not_shown_as_if_it_were_there(stand: WebStand) -> None:
    stand.say_state(Phase.RUNNING)
    stand.say_tick(30)
    with stand.page() as page:
        hello = page.next("hello")
        page.next("tick", lambda tick: row(hello, tick, "r1")["x_m"] == 0.0)
        page.next("beat", lambda beat: beat["controller"] > 1000 and beat["supervisor"] > 1000)
        tick = page.next("tick", lambda tick: row(hello, tick, "r1")["x_m"] is None)
        assert tick["health"]["compute_us"] is None
        stand.say_state(Phase.RUNNING)
        assert page.next("beat", lambda beat: beat["supervisor"] < 1000)["controller"] > 1000


def test_the_page_is_told_every_200_ms_that_the_link_is_there(stand: WebStand) -> None:
    heard_ns = []
    with stand.page() as page:
        for _ in range(6):
            page.next("beat")
            heard_ns.append(CLOCK.now_ns())
    assert np.median(np.diff(heard_ns)) < 300 * MS  # a busy machine delays some of them


@pytest.mark.slow
def test_events_come_to_all_pages_and_the_last_100_to_who_comes_later(stand: WebStand) -> None:
    with stand.page() as page:
        stand.say_state(Phase.ARMED, Event.START_REQUESTED)
        assert page.next("event")["text"] == "armed: start requested"
        stand.say_state(Phase.RUNNING, Event.PROVED)
        page.next("event", lambda event: event["text"] == "running: every check passed")
        stand.say_tick(300)
        page.next("tick", lambda tick: tick["t_s"] == 9.9)
        for halted in (Event.TAG_LATE, Event.NOTHING) * 51:
            stand.say_state(Phase.RUNNING, Event.PROVED, halted=halted)
            expected = "r1: stands still: it is not seen" if halted else "r1: may move again"
            event = page.next("event", lambda event, expected=expected: event["text"] == expected)  # type: ignore[misc]
            assert (event["at"], event["level"]) == (9.9, "warning" if halted else "info")
        stand.say_state(Phase.ESTOP, Event.WIRED_STOP, 1)
        stand.say_status("r2", GateStatus.LATCHED, Latch.EMERGENCY_STOP)
        latched = page.next("event", lambda event: "gate latched" in event["text"])
        assert (latched["text"], latched["level"]) == ("r2: gate latched: emergency stop", "error")
    with stand.page() as late:
        events = [frame for frame in late.heard(S // 2) if frame["type"] == "event"]
    assert len(events) == 100
    assert {"estop: r2: the robot's own e-stop", latched["text"]} <= {event["text"] for event in events[-3:]}


def test_what_happens_is_told_at_once(stand: WebStand) -> None:
    took_ms = []
    with stand.page() as page:
        for phase in (Phase.RUNNING, Phase.HOLD) * 20:
            said_ns = CLOCK.now_ns()
            stand.say_state(phase)
            page.next("event")
            took_ms.append((CLOCK.now_ns() - said_ns) / MS)
    assert np.percentile(took_ms, 25) < 20, "small messages wait for one another"  # a busy machine keeps some


def fresh_seqs(page: OpenPage, within_ns: int) -> list[int]:
    return [frame["seq"] for frame in page.heard(within_ns) if frame["type"] == "tick"]


@pytest.mark.slow
def test_a_page_that_sleeps_delays_nobody_and_is_owed_no_more_than_the_newest_tick(stand: WebStand) -> None:
    with stand.page() as asleep, stand.page() as page:
        began_ns, took_ns = CLOCK.now_ns(), []
        for k in range(40):
            sent_ns = CLOCK.now_ns()
            stand.say_tick(k)
            page.next("tick", lambda tick, k=k: tick["t_s"] == round(0.033 * k, 3))  # type: ignore[misc]
            took_ns.append(CLOCK.now_ns() - sent_ns)
            CLOCK.sleep_until(sent_ns + 33 * MS)
        assert np.median(took_ns) < 200 * MS
        missed = fresh_seqs(asleep, S // 2)
        lasted_s = (CLOCK.now_ns() - began_ns) / S
        assert 4 <= len(missed) <= 4 + 1 + lasted_s, "a few, then one a second"
        asleep.say(ack=missed[-1])
        newest = asleep.next("tick")
    assert newest["t_s"] == round(0.033 * 39, 3)


def test_a_change_of_phase_comes_also_to_a_page_that_draws_nothing(stand: WebStand) -> None:
    stand.say_state(Phase.RUNNING)
    with stand.page() as hidden:
        for _ in range(5):  # as many as may be on their way
            stand.say_tick(1)
            CLOCK.sleep_until(CLOCK.now_ns() + 20 * MS)
        hidden.heard(300 * MS)
        stand.say_state(Phase.ESTOP, Event.ESTOP_REQUESTED)
        phases = [frame["phase"] for frame in hidden.heard(200 * MS) if frame["type"] == "tick"]
    assert phases[-1:] == ["estop"]


@pytest.mark.slow
def test_a_picture_comes_only_to_who_asked_with_the_tags_where_they_were_seen(tmp_path: Path) -> None:
    with web_stand(tmp_path) as stand, stand.page() as page, stand.page() as other:
        assert page.next("hello")["cameras"] == [{"name": "overhead", "width": 1280, "height": 720}]
        page.say(picture="overhead")
        page.say(do="hold")
        page.next("answer")
        exposure_ns = CLOCK.now_ns()
        stand.say_image(1, exposure_ns - 33 * MS, TagPose(2, 0, 0, 0.0, 0.0, 0.0))
        stand.say_image(
            2, exposure_ns, TagPose(1, 0, 0, 0.4, -0.3, 0.5), TagPose(77, 0, 0, 0.0, 0.0, 0.0), jpeg=b"JPEG"
        )
        picture = page.next("picture")
        assert not [frame for frame in other.heard(S // 2) if frame["type"] == "picture"]
        page.say(picture=False)
        page.say(do="hold")
        page.next("answer")
        stand.say_image(3, exposure_ns + 33 * MS, jpeg=b"JPEG")
        assert not [frame for frame in page.heard(S // 2) if frame["type"] == "picture"]
        tick = page.next("tick")
        camera = CameraGeometry.from_model(stand.config.camera.model)
    assert (picture["exposure_ns"], picture["width"], picture["height"]) == (exposure_ns, 1280, 720)
    assert base64.b64decode(picture["jpeg"]) == b"JPEG"
    (tag,) = picture["tags"]
    assert (tag["id"], tag["robot"]) == (1, "r1")
    on_floor = camera.to_plane(np.array(tag["corners"]), 0.08)
    assert on_floor.mean(axis=0) == pytest.approx([0.4, -0.3], abs=1e-3)
    sides = np.linalg.norm(np.roll(on_floor, -1, axis=0) - on_floor, axis=1)
    assert sides == pytest.approx([0.07] * 4, abs=1e-3)
    right = on_floor[1] - on_floor[0]  # along the print's top
    assert np.arctan2(right[1], right[0]) == pytest.approx(0.5, abs=0.02)
    assert tick["health"]["tracker_hz"] == pytest.approx(30.3, abs=0.1)


def frames_until_closed(page: OpenPage) -> list[Frame]:
    frames: list[Frame] = []
    with pytest.raises(ConnectionClosed) as closed:
        while True:
            frames.append(page.heard_one())
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code in (1001, 1012)
    return frames


def test_a_page_that_is_ended_in_mid_run_does_not_say_that_the_run_has_ended(stand: WebStand) -> None:
    with stand.page() as page:
        stand.say_state(Phase.IDLE, Event.STOP_REQUESTED)
        page.next("tick", lambda tick: tick["phase"] == "idle")
        stand.end()
        assert not [frame for frame in frames_until_closed(page) if frame["type"] == "ended"]


def test_the_launchers_last_words_say_how_the_run_ends_while_nobody_has_judged_it(tmp_path: Path) -> None:
    lines, lives = ["Starting the processes."], [True]
    with (
        web_stand(tmp_path, TRUTH, console=lambda: lines[-1], launcher_lives=lambda: lives[-1]) as stand,
        stand.page() as page,
    ):
        stand.say_state(Phase.RUNNING, Event.PROVED)
        stand.say_tick(100)
        page.next("tick", lambda tick: tick["t_s"] == 3.3)
        lines.append("ends: completed after 3.3 s")
        stand.say_tick(100)
        ending = page.next("tick", lambda tick: tick["phase"] == "ending")
        assert (ending["stage"], ending["t_s"]) == ("completed after 3.3 s", 3.3)
        end = page.next("event", lambda event: "completed" in event["text"])
        assert (end["text"], end["level"], end["at"]) == ("completed after 3.3 s", "info", 3.3)
        stand.say_state(Phase.IDLE, Event.STOP_REQUESTED)
        stand.say_status("r1", GateStatus.LATCHED, Latch.EMERGENCY_STOP)
        event = page.next("event")
        assert event["text"] == "r1: gate latched: emergency stop", "the launcher's own request for the stop is no news"
        stand.over.set()
        ended = page.next("ended")
        assert (ended["text"], ended["good"], ended["report"]) == ("Completed after 3.3 s", None, None)
        assert ended["report_due"]
        lives.append(False)
        assert not page.next("ended")["report_due"], "nobody is left who makes it"


def test_a_run_whose_launcher_was_killed_says_so(stand: WebStand, tmp_path: Path) -> None:
    with stand.page() as page:
        stand.say_state(Phase.RUNNING, Event.PROVED)
        page.next("tick", lambda tick: tick["phase"] == "running")
        stand.over.set()
        ended = page.next("ended")
        assert "was killed, or it crashed" in ended["text"]
        assert ended["lines"] == [f"Its recording is completed by: robofleet repair {tmp_path}"]
        assert page.next("event", lambda event: "killed" in event["text"])["level"] == "warning"


@pytest.mark.slow
@pytest.mark.parametrize("simulated", [True, False])
def test_latches_of_a_simulated_run_are_reset_on_its_page_after_the_end(stand: WebStand, *, simulated: bool) -> None:
    store = FileStateStore("platoon", simulated=simulated)
    store.save("r2", StoredRobot(3, Latch.EMERGENCY_STOP, 2))
    with stand.page() as page:
        stand.over.set()
        ended = page.next("ended", lambda frame: frame["latched"], within_s=10)
        assert (ended["latched"], ended["resets"]) == (["r2"], simulated)
        assert ended["latched_words"].startswith("r2 is latched by an emergency stop (")
        page.say(do="reset")
        assert page.next("answer")["ok"] == simulated
        if simulated:
            ended = page.next("ended", lambda frame: not frame["latched"])
            assert ended["latched_words"] == "platoon: r2: reset; nothing has moved, and the next run can start"
        assert bool(store.latches()) != simulated
        assert stand.requests == [], "nobody is there who could be asked"


def test_the_end_of_a_run_is_told_with_its_verdict_and_its_report_to_who_still_looks(
    stand: WebStand, tmp_path: Path
) -> None:
    with stand.page() as page:
        stand.say_state(Phase.IDLE, Event.STOP_REQUESTED)
        page.next("tick", lambda tick: tick["phase"] == "idle")
        report = stand.url.replace("/?", "/report?")
        assert httpx.get(report).status_code == 404
        stand.over.set()
        ended = page.next("ended")
        assert (ended["text"], ended["good"], ended["report"]) == ("stop requested", None, None)
        bounds = [{"figure": "overruns", "value": 2, "limit": 0, "pass": False}]
        summary = {"outcome": "completed", "cause": None, "ticks": 9, "bounds": bounds}
        (tmp_path / "summary.json").write_text(json.dumps(summary))
        judged = page.next("ended")
        assert (judged["text"], judged["good"]) == ("Completed, 1 of 1 bounds not met", False)
        assert judged["lines"] == ["ticks overrun: 2; limit 0"]
        (tmp_path / "report.html").write_text("<!doctype html><title>its report</title>")
        assert page.next("ended")["report"] == str(tmp_path / "report.html")
        served = httpx.get(report)
        assert (served.status_code, "its report" in served.text) == (200, True)
        assert "script-src" not in served.headers["content-security-policy"], "it has none"
        assert httpx.get(report.replace(stand.token, "0" * 32)).status_code == 403
        with stand.page() as later:
            assert later.next("ended")["text"] == judged["text"]


def test_a_page_that_nobody_has_opened_ends_with_its_run(stand: WebStand) -> None:
    stand.over.set()
    assert wait(lambda: not stand.serves(), 5)


def test_until_wheels_drive_the_page_says_how_far_the_start_is(tmp_path: Path) -> None:
    starting = Starting(0.32, 24.0, "compiling kernels, 31 of 61")
    line = [starting.encode()]
    with web_stand(tmp_path, TRUTH, console=lambda: line[0]) as stand, stand.page() as page:
        page.next("tick", lambda tick: (tick["stage"], tick["start_share"]) == (starting.words(), 0.32))
        stand.say_state(Phase.IDLE, Event.NOTHING)
        page.next("tick", lambda tick: tick["phase"] == "starting")
        line[0] = "started"
        stand.say_state(Phase.RUNNING, Event.PROVED)
        page.next("tick", lambda tick: (tick["phase"], tick["stage"], tick["start_share"]) == ("running", None, None))
