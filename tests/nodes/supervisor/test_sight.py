"""What the tracker tells the supervisor: who is seen, who is not, and what became of the camera."""

from typing import Any

import numpy as np
import pytest

from robofleet.bus.keys import CAMERA
from robofleet.bus.messages import TagPose
from robofleet.core.clock import MS, S
from robofleet.safety.supervisor import NOBODY, Event, Phase
from tests.nodes.stand import ROBOTS, Stand


def test_a_robot_whose_tag_is_hidden_stands_alone_and_goes_on_when_it_is_seen(stand: Stand) -> None:
    stand.running()
    stand.hidden.add("r3")
    stand.run(60 * MS)
    assert min(stand.limits()) > 0.0
    stand.run(160 * MS)
    assert stand.state.phase == Phase.RUNNING
    assert [limit > 0.0 for limit in stand.limits()] == [True, True, False, True]
    assert [robot.permitted for robot in stand.state.robots] == [1, 1, 0, 1]
    assert stand.state.robots[2].cause == Event.TAG_LATE
    assert stand.lines[-1] == "stands: r3: it is not seen"
    stand.hidden.clear()
    stand.run(100 * MS)
    assert min(stand.limits()) > 0.0
    assert stand.state.robots[2].cause == Event.NOTHING


def test_a_tag_that_the_tracker_predicts_is_not_seen(stand: Stand) -> None:
    """By the images' own stamps: messages that are late or lost do not make it older."""
    stand.running()
    stand.silent.add("tracker")

    def see(seq: int, coasted_ns: int, age_ns: int) -> list[int]:
        stand.tell_image(coasted_ns=coasted_ns, seq=seq, exposure_ns=stand.bench.now_ns - age_ns)
        stand.run(40 * MS)
        return [robot.permitted for robot in stand.state.robots]

    assert see(1000, 99 * MS, 60 * MS) == [1, 1, 1, 1]
    assert see(1001, 100 * MS, 0) == [1, 0, 1, 1]
    assert see(1000, 0, 0) == [1, 0, 1, 1], "a message that was overtaken says nothing"
    assert see(1002, 0, 60 * MS) == [1, 1, 1, 1]


def test_a_tag_is_late_when_three_images_that_came_lack_it(stand: Stand) -> None:
    """Images that the network lost say nothing of a tag."""
    stand.running()
    stand.silent.add("tracker")
    stand.hidden.add("r2")

    def see(seq: int) -> int:
        stand.tell_image(seq=seq)
        stand.run(40 * MS)
        return int(stand.state.robots[1].permitted)

    stand.run(80 * MS)  # two images are lost
    assert [see(1000), see(1001), see(1002)] == [1, 1, 0]


def test_a_tracker_that_was_restarted_on_another_clock_makes_nobody_seen_or_lost(stand: Stand) -> None:
    stand.running()
    stand.hidden.add("r2")
    stand.run(200 * MS)
    stand.silent.add("tracker")
    for seq in (1, 2):
        stand.tell_image(epoch=9, seq=seq, exposure_ns=33 * MS * seq)
    stand.run(40 * MS)
    assert stand.cause == (Phase.HOLD, Event.TRACKER_RESTARTED, NOBODY)
    assert [robot.cause for robot in stand.state.robots] == [0, Event.TAG_LATE, 0, 0]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_a_bad_network_raises_nothing(stand: Stand, monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    """1 % of what is said is lost, in bursts of up to 60 ms, and one message in a hundred is later than 60 ms."""
    rng = np.random.default_rng(seed)
    say, under_way, burst_end_ns = stand.bench.say, [], dict.fromkeys(["", CAMERA, *ROBOTS], 0)
    lost = 0

    def say_badly(topic: Any, message: Any, name: str = "") -> None:
        nonlocal lost
        now_ns = stand.bench.now_ns
        if rng.random() < 0.005:
            burst_end_ns[name] = now_ns + int(rng.integers(60 * MS))
        if now_ns < burst_end_ns[name]:
            lost += 1
        else:
            late_ns = 2 * MS * np.exp(rng.standard_normal() * np.log(30) / 2.33)
            under_way.append((now_ns + late_ns, topic, message, name))

    def deliver() -> None:
        due = sorted((m for m in under_way if m[0] <= stand.bench.now_ns), key=lambda m: m[0])
        under_way[:] = [m for m in under_way if m[0] > stand.bench.now_ns]
        for _, topic, message, name in due:
            say(topic, message, name)

    stand.others = [(5 * MS, deliver)]
    stand.running()
    monkeypatch.setattr(stand.bench, "say", say_badly)
    stand.run(20 * S)
    assert lost > 20
    assert stand.state.phase == Phase.RUNNING
    assert stand.lines[1:] == ["ARMED -> RUNNING: every check passed"]


def test_a_tag_that_is_only_predicted_gives_no_place(stand: Stand) -> None:
    stand.running()
    outside = TagPose(stand.tags["r1"], 0, 33 * MS, 9.0, 0.0, 0.0)
    stranger = TagPose(999, 0, 0, 9.0, 0.0, 0.0)
    stand.bench.run(stand.node, 10 * MS)
    stand.hidden.add("r1")
    stand.tell_image(outside, stranger, seq=10**6)
    stand.bench.run(stand.node, 50 * MS)
    assert stand.state.phase == Phase.RUNNING


def test_images_from_both_ends_of_time_end_nobody(stand: Stand) -> None:
    """Each of another tracker, so that what was unseen is carried over from one clock to the other."""
    stand.running()
    for epoch, exposure_ns in enumerate((2**63 - 1, -(2**63), 2**63 - 1, -(2**63)), start=50):
        stand.hidden.update(ROBOTS)
        stand.tell_image(
            epoch=epoch,
            seq=1,
            exposure_ns=exposure_ns,
            sent_ns=exposure_ns,
            echo_tick=stand.tick,
            since_tick_ns=exposure_ns,
        )
        stand.hidden.clear()
        stand.run(40 * MS)
    assert stand.state.phase == Phase.HOLD
    assert stand.state.cause == Event.TRACKER_RESTARTED
