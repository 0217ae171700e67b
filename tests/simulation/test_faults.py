"""Timed faults in lockstep: each has its effect while it lasts and none before it, and the same seed the same bytes."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import COMMAND, ENABLE, NEWS, POSES, STATE, STATUS, TICK, TRUTH, key
from robofleet.bus.messages import FLEET_POSES, RUN_STATE, TICK_RECORD, TRACKER_NEWS
from robofleet.config.load import load_config
from robofleet.core.clock import MS, S, SimulatedClock
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.gate import GateState, Inputs
from robofleet.safety.supervisor import Event, Phase
from robofleet.simulation.faults import Schedule
from robofleet.simulation.faulty_bus import FaultyBus
from robofleet.tracking.events import TrackerEvent
from tests.bus.alone import ROBOT_STATUS, WHEEL_COMMAND, Alone, WheelCommand
from tests.bus.alone import TRUTH as TRUTH_LAYOUT
from tests.shipped import PLATOON

WHEN = "at_s: 0.5, duration_s: 1.0"
BEGIN, END = 0.5, 1.5  # after the start of the run [s]


class Drive:
    """A run of the platoon with faults, from its start on for some seconds."""

    def __init__(self, *faults: str, seconds: float = 2.0, together: int = 1) -> None:
        processes = f"drivers.robots_per_process={together}"
        overrides = ["tracker.source=truth", processes, f"faults=[{', '.join(faults)}]"]
        self.run = Lockstep(load_config(PLATOON, overrides))
        self.run.request(b"start")
        assert self.run.advance(30.0, lambda: self.run.status.phase is Phase.RUNNING)
        self.began_ns = self.run.clock.now_ns()
        self.phases = [self.run.status]
        self.run.advance(seconds, self._noted)
        self.run.close()

    def _noted(self) -> bool:
        if self.run.status != self.phases[-1]:
            self.phases.append(self.run.status)
        return False

    def rows(self, topic: Any, layout: Any, name: str = "") -> list[tuple[float, Any]]:
        """Return (time since the start of the run [s], message) of every message of a topic."""
        stamp = "sent_ns" if topic is POSES else "stamp_ns"
        units, unit_of = self.run.recording.config.units, self.run.recording.config.unit_of
        payloads = self.run.recording.messages[key("platoon", topic, unit_of.get(name, name))]
        if isinstance(layout, Alone):
            row = units[unit_of[name]].index(name)
            messages: list[Any] = [layout.of(payload, row) for payload in payloads]
        else:
            messages = [layout.decode(payload) for payload in payloads]
        return [((getattr(m, stamp) - self.began_ns) / S, m) for m in messages]

    @property
    def effects(self) -> int:
        return self.run.faults.injections[0].effects

    @property
    def causes(self) -> list[Event]:
        return [status.cause for status in self.phases[1:]]


def during(rows: list[tuple[float, Any]]) -> list[Any]:
    return [message for t, message in rows if BEGIN + 0.1 < t < END - 0.1]


def before(rows: list[tuple[float, Any]]) -> list[Any]:
    return [message for t, message in rows if 0.0 < t < BEGIN]


def tags(fleet: Any) -> set[int]:
    return {pose.tag for pose in fleet.poses}


@pytest.mark.slow
def test_stuck_motors_hold_one_robot_and_let_it_go() -> None:
    drive = Drive(f"{{kind: motor_stuck, robot: r2, {WHEN}}}")
    turned = {}
    for robot in ("r1", "r2"):
        angles = [m.left_angle_rad for m in during(drive.rows(STATUS, ROBOT_STATUS, robot))]
        turned[robot] = abs(angles[-1] - angles[0])
    assert turned["r2"] == 0.0
    assert turned["r1"] > 1.0


@pytest.mark.slow
def test_slip_takes_half_of_the_travel_and_not_of_the_wheels_turns() -> None:
    def travel_over_turns(drive: Drive) -> float:
        truths = during(drive.rows(TRUTH, TRUTH_LAYOUT, "r1"))
        statuses = during(drive.rows(STATUS, ROBOT_STATUS, "r1"))
        path = np.array([(t.x_m, t.y_m) for t in truths])
        turned = statuses[-1].left_angle_rad + statuses[-1].right_angle_rad
        turned -= statuses[0].left_angle_rad + statuses[0].right_angle_rad
        return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum() / turned)

    slipping = travel_over_turns(Drive(f"{{kind: slip, robot: r1, {WHEN}}}"))
    gripping = travel_over_turns(Drive(f"{{kind: slip, robot: r4, {WHEN}}}"))
    assert slipping / gripping == pytest.approx(0.5, abs=0.08)


@pytest.mark.slow_after_first
@pytest.mark.parametrize(("kind", "event"), [("low_battery", Event.BATTERY_LOW), ("wired_stop", Event.WIRED_STOP)])
def test_what_a_robot_says_of_itself_stops_the_run(kind: str, event: Event) -> None:
    drive = Drive(f"{{kind: {kind}, robot: r3, {WHEN}}}")
    assert drive.causes[0] is event
    assert drive.phases[1].robot == 2


@pytest.mark.slow_after_first
@pytest.mark.parametrize("kind", ["pose_dropout", "duplicate_tag"])
def test_a_tag_is_missing_while_the_others_are_there(kind: str) -> None:
    drive = Drive(f"{{kind: {kind}, robot: r2, {WHEN}}}")
    rows = drive.rows(POSES, FLEET_POSES, "overhead")
    tag = drive.run.recording.config.robots[1].tag
    assert all(tag in tags(fleet) for fleet in before(rows))
    assert not any(tag in tags(fleet) for fleet in during(rows))
    assert np.mean([len(fleet.poses) for fleet in during(rows)]) > 2.7  # the platoon's source loses some by itself
    twice = [m for _, m in drive.rows(NEWS, TRACKER_NEWS, "overhead") if m.event == TrackerEvent.TAG_TWICE]
    assert bool(twice) == (kind == "duplicate_tag")


@pytest.fixture(scope="module")
def noisy_and_late() -> Drive:
    return Drive(
        f"{{kind: pose_noise, robot: r2, sigma_m: 0.02, {WHEN}}}", f"{{kind: pose_delay, delay_s: 0.1, {WHEN}}}"
    )


def test_noise_is_as_large_as_asked_and_of_one_robot(noisy_and_late: Drive) -> None:
    drive, config = noisy_and_late, noisy_and_late.run.recording.config
    off: dict[str, list[float]] = {"r1": [], "r2": []}
    for robot in config.robots[:2]:
        truths = drive.rows(TRUTH, TRUTH_LAYOUT, robot.id)
        at = np.array([m.stamp_ns for _, m in truths])
        for fleet in during(drive.rows(POSES, FLEET_POSES, "overhead")):
            truth = truths[int(np.abs(at - fleet.exposure_ns).argmin())][1]
            for pose in (pose for pose in fleet.poses if pose.tag == robot.tag):  # the source loses some by itself
                off[robot.id].append(math.dist((pose.x_m, pose.y_m), (truth.x_m, truth.y_m)))
    assert max(off["r1"]) < 0.003
    assert 0.01 < float(np.mean(off["r2"])) < 0.05


@pytest.mark.slow
def test_swapped_tags_are_where_the_other_robot_is() -> None:
    drive = Drive(f"{{kind: id_swap, robots: [r1, r3], {WHEN}}}")
    rows, robots = drive.rows(POSES, FLEET_POSES, "overhead"), drive.run.recording.config.robots
    where = [{p.tag: (p.x_m, p.y_m) for p in fleet.poses} for fleet in (before(rows)[-1], during(rows)[0])]
    for row, other in ((0, 2), (2, 0)):
        assert math.dist(where[0][robots[row].tag], where[1][robots[other].tag]) < 0.05
    assert math.dist(where[0][robots[1].tag], where[1][robots[1].tag]) < 0.05


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "event"), [("camera_frozen", TrackerEvent.CAMERA_FROZEN), ("camera_stalled", TrackerEvent.CAMERA_STALLED)]
)
def test_a_camera_that_gives_nothing_new_is_named_and_comes_back(kind: str, event: TrackerEvent) -> None:
    drive = Drive(f"{{kind: {kind}, {WHEN}}}")
    assert during(drive.rows(POSES, FLEET_POSES, "overhead")) == []
    assert [m.event for _, m in drive.rows(NEWS, TRACKER_NEWS, "overhead")] == [event, TrackerEvent.CAMERA_BACK]
    assert drive.phases[1].phase is Phase.HOLD


def test_delayed_poses_are_as_old_as_asked(noisy_and_late: Drive) -> None:
    rows = noisy_and_late.rows(POSES, FLEET_POSES, "overhead")
    usual, delayed = ([(m.sent_ns - m.exposure_ns) / S for m in part(rows)] for part in (before, during))
    assert min(delayed) >= max(usual) + 0.09
    assert len(delayed) >= 20


@pytest.mark.slow_after_first
@pytest.mark.parametrize("process", ["controller", "tracker", "supervisor", "driver-r2"])
@pytest.mark.parametrize("kind", ["killed", "stopped"])
def test_a_process_says_nothing_while_it_is_down_and_again_afterwards(process: str, kind: str) -> None:
    drive = Drive(f"{{kind: {kind}, process: {process}, {WHEN}}}", seconds=3.0)
    topic, layout, name = {
        "controller": (TICK, TICK_RECORD, ""),
        "tracker": (POSES, FLEET_POSES, "overhead"),
        "driver-r2": (STATUS, ROBOT_STATUS, "r2"),
    }.get(process, (TICK, TICK_RECORD, ""))
    rows = drive.rows(topic, layout, name)
    if process != "supervisor":
        assert during(rows) == []
        assert any(t > END for t, _ in rows)
    assert before(rows)
    assert drive.effects == 1
    assert drive.run.status.phase is not Phase.RUNNING
    assert process in drive.run.nodes


@pytest.mark.slow
def test_a_robot_whose_driver_died_comes_to_rest_and_stays_where_it_is() -> None:
    drive = Drive(f"{{kind: killed, process: driver-r2, {WHEN}}}")
    truths = [(t, m) for t, m in drive.rows(TRUTH, TRUTH_LAYOUT, "r2") if t > 0.0]
    stands = [m for t, m in truths if t > BEGIN + 0.2 + 0.6]
    moved = [m for t, m in truths if t < BEGIN]
    assert max(abs(m.v_m_s) for m in stands) < 1e-3 < max(abs(m.v_m_s) for m in moved)
    assert math.dist((moved[-1].x_m, moved[-1].y_m), (stands[-1].x_m, stands[-1].y_m)) < 0.06


@pytest.mark.slow
@pytest.mark.parametrize("what", ["kind: killed, process: driver-r1", "kind: stopped, process: driver-r1"])
def test_every_robot_of_a_process_that_is_struck_stands_and_is_seen_on(what: str) -> None:
    drive = Drive(f"{{{what}, {WHEN}}}", together=2)
    assert drive.causes[0] is Event.DRIVER_SILENT
    for robot in ("r1", "r2"):
        instants = [t for t, _ in drive.rows(TRUTH, TRUTH_LAYOUT, robot)]
        assert max(np.diff(instants)) < 0.03
        times = [t for t, _ in drive.rows(STATUS, ROBOT_STATUS, robot) if t > 0.0]
        assert max(np.diff(times)) > END - BEGIN - 0.1
    times = [t for t, _ in drive.rows(STATUS, ROBOT_STATUS, "r3") if t > 0.0]
    assert max(np.diff(times)) < 0.03, "it has another process"


@pytest.mark.slow
def test_a_cut_to_a_driver_process_parts_all_its_robots() -> None:
    drive = Drive(f"{{kind: network_cut, processes: [driver-r3], {WHEN}}}", together=2)
    states = [RUN_STATE.decode(payload) for payload in drive.run.recording.messages[key("platoon", STATE)]]
    silent = {tuple(robot.cause == Event.DRIVER_SILENT for robot in state.robots) for state in states}
    assert silent == {(False, False, False, False), (False, False, True, True)}


@pytest.mark.slow
@pytest.mark.parametrize(("process", "step_s"), [("controller", 1.0), ("supervisor", -1.0), ("driver-r2", 1.0)])
def test_a_clock_that_jumps_stops_the_run_with_a_cause(process: str, step_s: float) -> None:
    drive = Drive(f"{{kind: clock_step, process: {process}, step_s: {step_s}, {WHEN}}}")
    assert drive.causes
    assert drive.causes[0] is not Event.NOTHING


@pytest.mark.slow
def test_a_second_controller_is_refused_and_says_nothing() -> None:
    drive = Drive(f"{{kind: second_controller, {WHEN}}}")
    plain = Drive("{kind: disk_full, at_s: 80}")
    assert drive.effects == 1
    assert drive.causes == []
    for topic, name in ((COMMAND, "r1"), (TICK, "")):
        messages, usual = (d.run.recording.messages[key("platoon", topic, name)] for d in (drive, plain))
        assert len(messages) == len(usual)


@pytest.mark.slow
def test_a_full_disk_stops_the_run() -> None:
    assert Drive(f"{{kind: disk_full, {WHEN}}}").causes[0] is Event.DISK_FULL


@pytest.mark.slow
def test_a_fault_that_is_yet_to_come_changes_nothing() -> None:
    def said(fault: str) -> dict[str, list[bytes]]:
        messages = Drive(fault, seconds=0.5).run.recording.messages
        return {full: list(payloads) for full, payloads in messages.items()}

    later = said("{kind: disk_full, at_s: 80}"), said("{kind: pose_delay, delay_s: 0.1, at_s: 70}")
    builds = ("status", "tick", "overhead")  # a build is of one configuration
    for full in later[0]:
        if not full.endswith(builds):
            assert later[0][full] == later[1][full], full


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_whatever_goes_wrong() -> None:
    faults = [
        "faults=[{kind: lost, topics: [cmd, status, enable], share: 0.05, burst_s: 0.06}",
        "{kind: late, topics: [cmd, poses, state]}",
        "{kind: malformed, topics: [status], share: 0.1}",
        "{kind: killed, process: tracker, at_s: 1, duration_s: 0.2}]",
    ]

    def trace(seed: int) -> str:
        overrides = ["tracker.source=truth", "run.duration_s=2", f"run.seed={seed}", ", ".join(faults)]
        run = Lockstep(load_config(PLATOON, overrides))
        run.run()
        return run.recording.trace_hash or ""

    first, again, other = trace(1), trace(1), trace(2)
    assert first == again != other


# One subscription behind a bad network


def delivered(*faults: str, seconds: float = 2.0, message: bytes = b"") -> list[tuple[float, bytes]]:
    """Return what arrives of messages that are said every 10 ms for some seconds: (ms since they began, payload)."""
    config = load_config(PLATOON, ["drivers.robots_per_process=1", f"faults=[{', '.join(faults)}]"])
    clock = SimulatedClock()
    clock.advance_to(S)
    bus = MemoryBus("platoon", clock, 0)
    faulty = FaultyBus(bus, Schedule(config, clock), "driver-r1", clock, simulated_router=True)
    subscription, publish = faulty.newest(COMMAND, "r1"), bus.publisher(COMMAND, "r1")
    arrived = []
    for ms in range(round(seconds * 1000)):
        clock.advance_to(S + ms * S // 1000)
        if ms % 10 == 0:
            publish(message or ms.to_bytes(4, "little") + bytes(12))
        if (payload := subscription.take()) is not None:
            arrived.append((ms, payload))
    return arrived


def sent_ms(payload: bytes) -> int:
    return int.from_bytes(payload[:4], "little")


def test_without_a_fault_of_its_own_a_link_is_whole() -> None:
    arrived = delivered("{kind: lost, topics: [cmd], robot: r2}", "{kind: late, topics: [status]}")
    assert [ms for ms, _ in arrived] == list(range(0, 2000, 10))
    assert all(ms == sent_ms(payload) for ms, payload in arrived)


def test_single_losses_are_as_many_as_asked() -> None:
    arrived = delivered("{kind: lost, topics: [cmd], share: 0.3}", seconds=10)
    assert 0.6 < len(arrived) / 1000 < 0.8


def test_bursts_are_no_longer_than_asked_and_as_frequent() -> None:
    arrived = [sent_ms(p) for _, p in delivered("{kind: lost, topics: [cmd], share: 0.05, burst_s: 0.06}", seconds=60)]
    gaps = np.diff(arrived) - 10
    assert 30 < gaps.max() <= 60
    assert 0.02 < 1 - len(arrived) / 6000 < 0.08


def test_the_same_burst_takes_what_a_robot_says_and_what_it_is_told() -> None:
    fault = "faults=[{kind: lost, topics: [cmd, status], share: 0.1, burst_s: 0.06}]"
    config = load_config(PLATOON, ["drivers.robots_per_process=1", fault])
    clock = SimulatedClock()
    bus, schedule = MemoryBus("platoon", clock, 0), Schedule(config, clock)
    commands = FaultyBus(bus, schedule, "driver-r1", clock).newest(COMMAND, "r1")
    statuses = FaultyBus(bus, schedule, "controller", clock).newest(STATUS, "r1")
    others = FaultyBus(bus, schedule, "controller", clock).newest(STATUS, "r2")
    publish = [bus.publisher(COMMAND, "r1"), bus.publisher(STATUS, "r1"), bus.publisher(STATUS, "r2")]
    came: list[list[bool]] = [[], [], []]
    for ms in range(5000):
        clock.advance_to(ms * S // 1000)
        for say in publish:
            say(b"something")
        for subscription_heard, subscription in zip(came, (commands, statuses, others), strict=True):
            subscription_heard.append(subscription.take() is not None)
    assert came[0] == came[1]
    assert came[0] != came[2]
    assert 0.05 < came[0].count(False) / 5000 < 0.2


def test_lateness_has_the_median_and_the_tail_that_were_asked() -> None:
    arrived = delivered("{kind: late, topics: [cmd], median_s: 0.002, p99_s: 0.06}", seconds=100)
    late = np.array([ms - sent_ms(payload) for ms, payload in arrived])
    assert np.median(late) == pytest.approx(2.5, abs=1.0)  # seen every millisecond
    assert 20 < np.percentile(late, 99) < 80


def test_a_duplicate_comes_a_little_later() -> None:
    arrived = [sent_ms(payload) for _, payload in delivered("{kind: duplicated, topics: [cmd]}")]
    assert arrived == [ms for ms in range(0, 2000, 10) for _ in range(2)]


def test_a_message_is_overtaken_by_the_next_one() -> None:
    arrived = [sent_ms(payload) for _, payload in delivered("{kind: reordered, topics: [cmd]}")]
    assert arrived[:4] == [10, 0, 30, 20]


def test_a_nan_stands_where_the_last_number_was() -> None:
    command = WHEEL_COMMAND.encode(WheelCommand(1, 2, 3, 4, 5, 6, 7.5, 8.5))
    for _, payload in delivered("{kind: not_a_number, topics: [cmd]}", message=command):
        assert payload[:-8] == command[:-8]
        assert math.isnan(np.frombuffer(payload[-8:], "<f8")[0])


def test_a_malformed_payload_has_another_length_or_version() -> None:
    for ms, payload in delivered("{kind: malformed, topics: [cmd]}"):
        assert len(payload) != 16 or payload[0] == 0xFF, ms


@pytest.mark.parametrize("held", ["true", "false"])
def test_a_cut_lets_nothing_through_and_brings_what_it_held_back_in_order(held: str) -> None:
    cut = f"{{kind: network_cut, processes: [controller], duration_s: 1.0, held_back: {held}}}"
    arrived = delivered(cut)
    stamps = [sent_ms(payload) for _, payload in arrived]
    assert arrived[0][0] == 1000
    assert stamps == sorted(stamps)
    assert (stamps[0] < 900) == (held == "true")
    assert [ms for ms, _ in arrived[-50:]] == stamps[-50:]


def test_a_cut_between_others_is_none() -> None:
    assert len(delivered("{kind: network_cut, processes: [tracker]}")) == 200
    assert len(delivered("{kind: network_cut, processes: [controller, driver-r1]}")) == 200


def test_a_cut_around_the_tracker_of_one_camera_stops_what_it_says_alone() -> None:
    config = load_config(
        PLATOON.with_name("two-cameras.yaml"), ["faults=[{kind: network_cut, processes: [tracker-left]}]"]
    )
    clock = SimulatedClock()
    clock.advance_to(S)
    bus = MemoryBus(config.arena.name, clock, 0)
    faulty = FaultyBus(bus, Schedule(config, clock), "controller", clock, simulated_router=True)
    subscriptions = {(topic, name): faulty.newest(topic, name) for topic in (POSES, NEWS) for name in ("left", "right")}
    for topic, name in subscriptions:
        bus.publisher(topic, name)(b"said")
    clock.advance_to(2 * S)
    assert {where for where, subscription in subscriptions.items() if subscription.take() is not None} == {
        (POSES, "right"),
        (NEWS, "right"),
    }


@pytest.mark.slow
def test_a_radio_that_is_as_bad_as_it_may_be_stops_nobody_and_is_spoken_on_more_often() -> None:
    lossy = PLATOON.parent / "faults" / "lossy.yaml"
    run = Lockstep(
        load_config(PLATOON, ["tracker.source=truth", "run.duration_s=10", "drivers.robots_per_process=1"], lossy)
    )
    assert run.run() == ("completed", None)
    assert all(injection.effects > 100 for injection in run.faults.injections)
    for robot in ("r1", "r2", "r3", "r4"):
        statuses = [ROBOT_STATUS.decode(p) for p in run.recording.messages[key("platoon", STATUS, robot)]]
        count = len(run.recording.messages[key("platoon", COMMAND, robot)])
        assert any(status is not None and status.hurry for status in statuses)
        assert count > 100 * 10
    healthy = Lockstep(
        load_config(PLATOON, ["tracker.source=truth", "run.duration_s=2", "drivers.robots_per_process=1"])
    )
    healthy.run()
    statuses = [ROBOT_STATUS.decode(p) for p in healthy.recording.messages[key("platoon", STATUS, "r1")]]
    assert not any(status is not None and status.hurry for status in statuses)


@pytest.mark.slow
@pytest.mark.parametrize("faults", [None, PLATOON.parent / "faults" / "lossy.yaml"])
def test_robots_with_computers_of_their_own_bear_that_radio_with_few_messages(faults: Path | None) -> None:
    """Their packets share the air: each tells once a command, and is answered at once."""
    robots = [
        robot | {"unit": robot["id"], "driver": "robofleet.drivers.simulated:SimulatedRobot"}
        for robot in yaml.safe_load(PLATOON.read_text())["robots"]
    ]
    overrides = [
        "tracker.source=truth", f"robots={json.dumps(robots)}", "drivers.started_by=daemon",
        "bus.listen=[quic/127.0.0.1:7447]",
    ]  # fmt: skip
    worst_ns: dict[str, int] = {}

    def witness(robot: str, now_ns: int, _inputs: Inputs, state: GateState) -> None:
        if run.status.phase is Phase.RUNNING:
            worst_ns[robot] = max(worst_ns.get(robot, 0), now_ns - min(state.command_nonce, state.enabled_nonce))

    run = Lockstep(load_config(PLATOON, overrides, faults), witness)
    run.request(b"start")
    assert run.advance(30.0, lambda: run.status.phase is Phase.RUNNING)
    run.advance(1.0)  # by then the answers to what was said before have come
    worst_ns.clear()
    topics = [key("platoon", topic, robot) for topic in (COMMAND, ENABLE, STATUS) for robot in ("r1", "r2", "r3", "r4")]
    before = {full: len(run.recording.messages[full]) for full in topics}
    run.advance(10.0)
    run.close()
    assert run.status.phase is Phase.RUNNING
    assert len(worst_ns) == 4
    assert max(worst_ns.values()) < (120 if faults else 70) * MS  # safety.gate closes a gate then
    for robot in ("r1", "r2", "r3", "r4"):
        count = sum(len(run.recording.messages[full]) - before[full] for full in topics if f"/{robot}/" in full)
        assert count < (110 if faults else 80) * 10
