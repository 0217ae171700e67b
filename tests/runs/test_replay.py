"""Replay: what a recorded controller took leads today's to the same figures, and what does not is named."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from robofleet.behaviours.platoon import Platoon
from robofleet.bus.keys import CAMERA, COMMAND, POSES, STATE, TICK, Topic, key
from robofleet.bus.messages import TICK_RECORD, TickRecord
from robofleet.config.tree import Config, ControllerSettings
from robofleet.recording.log import RunLog
from robofleet.recording.reading import RecordingError
from robofleet.recording.run import Recording
from robofleet.runs.lockstep import Lockstep
from robofleet.runs.replay import replay
from robofleet.safety.supervisor import Phase
from tests.bus.alone import WHEEL_COMMAND, WheelCommand
from tests.command import robofleet
from tests.process_fixtures import LAYOUTS
from tests.recording.recorded import in_order

FAULTS = """[
{kind: lost, topics: [poses, state], share: 0.1}, {kind: late, topics: [poses, state]},
{kind: duplicated, topics: [poses, state], share: 0.3}, {kind: malformed, topics: [poses, state], share: 0.1},
{kind: stopped, process: controller, at_s: 0.5, duration_s: 0.1},
{kind: second_controller, at_s: 0.8, duration_s: 2.6}, {kind: killed, process: controller, at_s: 1, duration_s: 2}]"""
Alter = Callable[[int, bytes], bytes | None]


@pytest.fixture(scope="module")
def recording(platoon_of: Callable[..., Config]) -> Recording:
    """Return two seconds of a healthy run of two robots."""
    run = Lockstep(platoon_of("tracker.source=truth", "groups.0.robots=[r2, r1]", "run.duration_s=2"))
    assert run.run() == ("completed", None)
    return run.recording


@pytest.fixture(scope="module")
def wild(platoon_of: Callable[..., Config]) -> Recording:
    """Return a run with bad news: three controllers, of which one was stopped and killed, and one kept silent."""
    run = Lockstep(platoon_of("tracker.source=truth", "groups.0.robots=[r1]", f"faults={FAULTS}"))
    run.request(b"start")
    assert run.advance(20.0, lambda: run.status.phase is Phase.RUNNING)
    run.advance(4.7)
    for what in (b"stop", b"reset", b"start"):
        run.request(what)
        run.advance(0.2)
    assert run.advance(20.0, lambda: run.status.phase is Phase.RUNNING), run.status
    run.advance(1.0)
    run.close()
    return run.recording


def with_controller(recording: Recording, controller: ControllerSettings) -> Recording:
    """Return a recording of which another controller is said to have made it."""
    config = recording.config.model_copy(update={"controller": controller})
    return dataclasses.replace(recording, config=config)


def altered(recording: Recording, where: Topic | str, alter: Alter) -> Recording:
    """Return a recording whose messages of a key are others; None: it is missing."""
    other, full = Recording(recording.config), where if isinstance(where, str) else key("platoon", where)
    for name, messages in recording.messages.items():
        changed = [alter(k, m) if name == full else m for k, m in enumerate(messages)]
        for message in changed:
            if message is not None:
                other.add(name, message)
    return other


def ticks(recording: Recording) -> list[TickRecord]:
    payloads = recording.messages[key(recording.config.arena.name, TICK)]
    return [message for message in map(TICK_RECORD.decode, payloads) if message is not None]


def commands(recording: Recording) -> list[WheelCommand]:
    keys = [key(recording.config.arena.name, COMMAND, robot.id) for robot in recording.config.members]
    found = (WHEEL_COMMAND.decode(payload) for full in keys for payload in recording.messages[full])
    return [command for command in found if command is not None]


def test_every_tick_and_every_command_is_what_it_was_to_the_last_bit(recording: Recording) -> None:
    verdict = replay(recording, 0.0)
    assert verdict.equal
    assert (verdict.ticks, verdict.commands) == (len(ticks(recording)), len(commands(recording)))
    assert verdict.commands > 2 * 0.9 * verdict.ticks > 200


@pytest.mark.slow
def test_controllers_that_miss_messages_stand_still_die_and_keep_silent_are_replayed_too(wild: Recording) -> None:
    verdict, records = replay(wild, 0.0), ticks(wild)
    assert verdict.equal
    assert verdict.ticks == len(records)
    newest = {record.epoch: record for record in records}
    assert len(newest) == 3
    assert max(record.overruns for record in records) >= 2
    numbers = [(c.seq, newest[c.session >> 32].command_seq) for c in commands(wild)]
    assert verdict.commands == sum(seq <= before + 1 for seq, before in numbers), "all but repetitions at the very end"


def test_another_gain_is_found_at_the_first_tick_that_it_changes(recording: Recording) -> None:
    quicker = recording.config.controller.model_copy(update={"alpha": 46.0})
    verdict = replay(with_controller(recording, quicker), 1e-9)
    first = next(record for record in ticks(recording) if record.run_tick >= 0)
    assert verdict.differences[0].tick == first.tick
    assert verdict.differences[0].what == "r2: u_x_m_s"
    assert verdict.differences[0].recorded == first.robots[0].u_x_m_s != verdict.differences[0].now


def test_another_filter_is_found_before_anything_drives(recording: Recording) -> None:
    controller = recording.config.controller
    noisy = controller.model_copy(update={"filter": controller.filter.model_copy(update={"position_noise_m": 0.01})})
    verdict = replay(with_controller(recording, noisy), 1e-9)
    began = next(record.tick for record in ticks(recording) if record.run_tick >= 0)
    assert ticks(recording)[0].tick < verdict.differences[0].tick < began


@pytest.mark.parametrize(("by", "tolerance", "found"), [(1e-12, 0.0, 1), (1e-12, 1e-9, 0), (1e-8, 1e-9, 1)])
def test_one_figure_that_is_a_little_off_is_named_unless_the_tolerance_is_wider(
    recording: Recording, by: float, tolerance: float, found: int
) -> None:
    meant = ticks(recording)[50]
    robots = meant.robots[0], meant.robots[1]._replace(y_m=meant.robots[1].y_m + by)

    def off(k: int, payload: bytes) -> bytes:
        return TICK_RECORD.encode(meant._replace(robots=robots)) if k == 50 else payload

    verdict = replay(altered(recording, TICK, off), tolerance)
    assert [(d.tick, d.what, d.now) for d in verdict.differences] == [(meant.tick, "r1: y_m", meant.robots[1].y_m)][
        :found
    ]


@pytest.mark.parametrize("column", ["phase", "run_tick", "exposure_ns"])
def test_what_concerns_the_whole_fleet_is_compared_as_well(recording: Recording, column: str) -> None:
    meant = ticks(recording)[50]

    def off(k: int, payload: bytes) -> bytes:
        return TICK_RECORD.encode(meant._replace(**{column: 3})) if k == 50 else payload

    assert [d.what for d in replay(altered(recording, TICK, off), 1e-9).differences] == [column]


def test_a_command_that_is_not_the_ticks_is_named_also_where_a_foreigner_said_it(recording: Recording) -> None:
    full, meant = key("platoon", COMMAND, "r2"), 70

    def off(k: int, payload: bytes) -> bytes:
        command = WHEEL_COMMAND.decode(payload)
        assert command is not None
        return WHEEL_COMMAND.encode(command._replace(left_rad_s=37.5)) if k == meant else payload

    (difference,) = replay(altered(recording, full, off), 1e-9).differences
    number = WHEEL_COMMAND.decode(recording.messages[full][meant])
    assert number is not None
    assert difference.what == f"r2: command {number.seq}, left_rad_s"
    tick = next(r for r in ticks(recording) if r.tick == difference.tick)
    assert tick.command_seq < number.seq <= tick.command_seq + 2
    assert (difference.recorded, difference.now) == (37.5, tick.robots[0].left_rad_s)


@pytest.mark.slow
def test_from_a_missing_record_on_nothing_is_compared_until_a_controller_begins(wild: Recording) -> None:
    records = ticks(wild)
    verdict = replay(altered(wild, TICK, lambda k, payload: None if k == 30 else payload), 0.0)
    (hole,) = verdict.holes
    of_the_first = [record for record in records if record.epoch == records[0].epoch]
    assert (hole.first, hole.last) == (records[31].tick, of_the_first[-1].tick)
    assert hole.why == "1 record before them is missing"
    assert verdict.ticks == len(records) - len(of_the_first) + 30
    assert not verdict.equal
    assert not verdict.differences


def test_a_recording_without_its_controllers_beginning_is_not_compared(recording: Recording) -> None:
    verdict = replay(altered(recording, TICK, lambda k, payload: payload if k > 9 else None), 0.0)
    assert (verdict.ticks, verdict.commands) == (0, 0)
    assert [str(hole) for hole in verdict.holes] == [
        f"ticks 11 to {ticks(recording)[-1].tick} were not compared: 10 records before them are missing"
    ]


@pytest.mark.parametrize(("topic", "name"), [(POSES, CAMERA), (STATE, "")])
def test_from_a_missing_message_on_nothing_is_compared(recording: Recording, topic: Topic, name: str) -> None:
    full = key("platoon", topic, name)
    heads = {decoded[:2]: k for k, p in enumerate(recording.messages[full]) if (decoded := LAYOUTS[topic].decode(p))}
    tick = ticks(recording)[40]
    gone = heads[(tick.poses_epoch, tick.poses_seq) if topic is POSES else (tick.state_epoch, tick.state_seq)]
    verdict = replay(altered(recording, full, lambda k, payload: None if k == gone else payload), 0.0)
    (hole,) = verdict.holes
    assert hole.first in (tick.tick - 1, tick.tick), "the tick before may have taken the same state"
    assert hole.why == "a message that the first of them took is missing"
    assert verdict.ticks == [other.tick for other in ticks(recording)].index(tick.tick) + hole.first - tick.tick


def test_a_run_without_a_tick_is_refused(recording: Recording) -> None:
    with pytest.raises(RecordingError, match="no tick"):
        replay(altered(recording, TICK, lambda _k, _payload: None), 0.0)


def test_the_command_says_in_a_line_what_was_compared_and_how_fast(recording: Recording, tmp_path: Path) -> None:
    result = command(recording, tmp_path)
    assert result.exit_code == 0, result.output
    assert len(result.stdout.splitlines()) == 1
    n = len(ticks(recording)), len(commands(recording))
    assert f"{n[0]} ticks and {n[1]} commands of 2 robots: equal, bit for bit" in result.stdout
    assert "x real time" in result.stdout


def test_the_command_names_the_first_differences_and_fails(recording: Recording, tmp_path: Path) -> None:
    def off(k: int, payload: bytes) -> bytes:
        record = TICK_RECORD.decode(payload)
        assert record is not None
        return TICK_RECORD.encode(record._replace(phase=5)) if k >= 50 else payload

    result = command(altered(recording, TICK, off), tmp_path)
    assert result.exit_code == 1
    lines, many = result.stdout.splitlines(), len(ticks(recording)) - 50
    assert lines[0].startswith(f"tick {ticks(recording)[50].tick}: phase: 5 was recorded, now ")
    assert f"{many} differences" in result.stdout
    assert len(lines) < 10
    (tmp_path / "run.mcap").unlink()
    result = command(altered(recording, TICK, lambda k, payload: None if k == 30 else payload), tmp_path)
    assert result.exit_code == 1
    assert "were not compared: 1 record before them is missing" in result.stdout


def test_the_command_refuses_what_is_no_recording_and_an_empty_run(recording: Recording, tmp_path: Path) -> None:
    empty = altered(recording, TICK, lambda _k, _payload: None)
    for result in (robofleet("replay", tmp_path / "nothing"), command(empty, tmp_path)):
        assert result.exit_code == 2
        assert len(result.stderr.splitlines()) == 1


@pytest.mark.slow_after_first
@pytest.mark.parametrize("kept", [slice(1, None), slice(None, None, -1)])
def test_a_behaviour_that_has_other_figures_today_is_refused_in_one_line(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kept: slice
) -> None:
    """Somebody changed it since: its ticks have other columns."""
    assert command(recording, tmp_path).exit_code == 0
    monkeypatch.setattr(Platoon, "figures", Platoon.figures[kept])
    result = robofleet("replay", tmp_path)
    assert result.exit_code == 2
    assert isinstance(result.exception, SystemExit), result.exception
    lines = result.stderr.splitlines()
    assert "group platoon: platoon has other figures: " in lines[-1], lines
    assert lines[-1].endswith("today: replay it with the version that recorded it")


def command(recording: Recording, folder: Path) -> Any:
    """Return what ``robofleet replay`` says of a recording that is kept in a file."""
    with RunLog(folder / "run.mcap", recording.config) as log:
        for index, (full, message) in enumerate(in_order(recording)):
            log.add(full, message, index)
    return robofleet("replay", folder)
