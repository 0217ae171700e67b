"""What viewers draw of a run: everything where it is, in the colours of how it is doing, and told in words."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.Color_pb2 import Color

from robofleet.behaviours import described
from robofleet.bus.keys import CAMERA, NEWS, STATE, STATUS, TICK, TOPICS, key
from robofleet.bus.messages import RUN_STATE, TICK_RECORD, TRACKER_NEWS, RobotTick, TrackerNews
from robofleet.config.barrier import body, keepout
from robofleet.config.load import load_config
from robofleet.core.clock import S
from robofleet.recording.run import Recording
from robofleet.recording.scenes.shapes import arena, prism, triangles
from robofleet.safety.distances import apart
from robofleet.safety.latches import Latch
from robofleet.safety.supervisor import NOBODY, Event, Phase
from robofleet.tracking.events import NO_TAG, TrackerEvent
from robofleet.vehicles.solids import Solid, area, distances
from tests.bus.alone import ROBOT_STATUS
from tests.recording.recorded import in_order
from tests.recording.viewer import START_NS, TICK_NS, Viewer, heading, instant_ns
from tests.shipped import SHIPPED

Make = Callable[..., Any]
INFO, WARNING, ERROR = 2, 3, 4  # Foxglove's


def with_items(recording: Recording, change: Callable[[int, int, RobotTick], RobotTick]) -> Recording:
    """Return a recording whose ticks are changed: by (number of the tick, row, item)."""
    changed, ticks = Recording(recording.config), 0
    for full, payload in in_order(recording):
        if full == key(recording.config.arena.name, TICK) and (tick := TICK_RECORD.decode(payload)) is not None:
            items = tuple(change(ticks, row, item) for row, item in enumerate(tick.robots))
            changed.add(full, TICK_RECORD.encode(tick._replace(robots=items)))
            ticks += 1
        else:
            changed.add(full, payload)
    return changed


def with_references(recording: Recording, group: described.Group) -> Recording:
    """Return a recording whose robots are to be at x = number of the tick, y = row."""
    full, changed = key(recording.config.arena.name, TICK), Recording(recording.config)
    for k, payload in enumerate(recording.messages[full]):
        tick = TICK_RECORD.decode(payload)
        assert tick is not None
        numbers = np.array(tick.figures).reshape(len(group.robots), group.width)
        numbers[:, 0], numbers[:, 1] = k, range(len(group.robots))
        changed.add(full, TICK_RECORD.encode(tick._replace(figures=tuple(numbers.ravel().tolist()))))
    return changed


def test_robots_are_drawn_where_they_are_estimated_and_where_they_truly_are(story: Make) -> None:
    drive = story(ticks=60)
    drive.estimate_off = 0.02, -0.01, 0.1
    frames = Viewer(drive.config).play(drive.recording()).frames
    assert set(frames) == {f"r{k}{kind}" for k in (1, 2, 3, 4) for kind in ("", "/truth")}
    for row, robot in enumerate(drive.config.members):
        for name, off in ((robot.id, drive.estimate_off), (f"{robot.id}/truth", (0.0, 0.0, 0.0))):
            assert len(frames[name]) > 10
            for frame in frames[name]:
                tick = max(0, (instant_ns(frame.timestamp) - START_NS) // TICK_NS - drive.before)
                x, y = drive.centres[tick, row] + off[:2]
                assert (frame.translation.x, frame.translation.y) == pytest.approx((x, y), abs=1e-9)
                turned = heading(frame.rotation) - drive.psi[tick, row] - off[2]
                assert math.remainder(turned, math.tau) == pytest.approx(0.0, abs=1e-9)
                assert frame.parent_frame_id == "world"


def test_poses_are_told_ten_times_a_second(story: Make) -> None:
    drive = story(ticks=300)
    viewer = Viewer(drive.config).play(drive.recording(truth=False))
    frames_of = viewer.frames
    assert len(viewer.messages["/tf"]) / (305 * TICK_NS / S) == pytest.approx(10, abs=0.2)
    for robot in drive.config.members:
        poses, frames = viewer.messages[f"/robots/{robot.id}/pose"], frames_of[robot.id]
        published = [(p.pose.position.x, p.pose.position.y, instant_ns(p.timestamp), p.frame_id) for p in poses]
        assert published == [(f.translation.x, f.translation.y, instant_ns(f.timestamp), "world") for f in frames]


def test_a_robot_that_was_never_seen_is_nowhere(story: Make) -> None:
    recording = with_items(story(ticks=20).recording(truth=False), lambda _, row, item: item._replace(lost=row == 1))
    viewer = Viewer(recording.config).play(recording)
    assert set(viewer.frames) == set(viewer.bodies) == {"r1", "r3", "r4"}


def test_a_robot_has_the_colour_of_how_it_is_doing(story: Make, add_state: Make, add_status: Make) -> None:
    recording = with_items(
        story(ticks=40).recording(truth=False), lambda k, row, i: i._replace(lost=k > 9 and row == 2)
    )
    halts = 0, Event.TAG_LATE, 0, 0
    add_state(recording, Phase.RUNNING, Event.PROVED, halts=halts)
    add_status(recording, "r4", S)
    (state,), (status,) = (recording.messages[key("platoon", *at)] for at in ((STATE,), (STATUS, "r4")))
    viewer = Viewer(recording.config).play(recording)
    later = START_NS + 45 * TICK_NS
    viewer.tell(key("platoon", STATE), state, later + S)
    assert viewer.states == {"r1": "running", "r2": "halted", "r3": "lost", "r4": "running"}
    latched = ROBOT_STATUS.decode(status)._replace(latch=Latch.EMERGENCY_STOP)  # type: ignore[union-attr]
    viewer.tell(key("platoon", STATUS, "r4"), ROBOT_STATUS.encode(latched), later + 2 * S)
    assert viewer.states["r4"] == "latched"
    held = RUN_STATE.decode(state)._replace(phase=Phase.HOLD)  # type: ignore[union-attr]
    viewer.tell(key("platoon", STATE), RUN_STATE.encode(held), later + 3 * S)
    assert viewer.states == {"r1": "halted", "r2": "halted", "r3": "lost", "r4": "latched"}
    fills = {(at.color.r, at.color.g, at.color.b) for b in viewer.bodies.values() for at in b.cylinders}
    assert len(fills) == 3, "one colour a state"


def test_shapes_are_said_again_only_when_they_change(story: Make, add_state: Make) -> None:
    recording = story(ticks=100).recording()
    add_state(recording, Phase.RUNNING, Event.PROVED)
    viewer = Viewer(recording.config).play(recording)
    viewer.play(recording)
    assert len(viewer.messages["/fleet"]) == 2, "standing, then running"
    assert len(viewer.messages["/arena"]) == 1


def test_a_body_is_a_disc_with_its_id_and_half_of_the_distance_that_is_kept(story: Make) -> None:
    drive = story(ticks=5)
    config, viewer = drive.config, Viewer(drive.config).play(drive.recording())
    for robot in config.members:
        shape = viewer.bodies[robot.id]
        disc, kept = shape.cylinders
        assert shape.frame_id == robot.id
        assert [text.text for text in shape.texts] == [robot.id]
        assert disc.size.x == disc.size.y == 2 * robot.vehicle.body_radius_m
        # Two such films touch when the points in front of the axles are as near as they may be.
        assert kept.pose.position.x == pytest.approx(config.controller.barrier.ahead_m)
        least = apart(keepout(config), *[body(config, robot)] * 2)
        assert kept.size.x == pytest.approx(least)
        assert kept.color.a < disc.color.a


def test_the_path_and_the_arena_are_drawn_once(story: Make) -> None:
    drive = story(ticks=50)
    viewer = Viewer(drive.config).play(drive.recording())
    (static,) = viewer.messages["/arena"]
    lines = {entity.id: np.array([(p.x, p.y) for p in entity.lines[0].points]) for entity in static.entities}
    assert np.ptp(lines["arena"], axis=0) == pytest.approx(drive.config.arena.size_m)
    off = np.linalg.norm(lines["platoon/path"][:, None] - drive.points[None, :, 0], axis=-1).min(axis=0)
    assert off.max() < 0.02, "every point of the drive is on the path"


def test_references_are_drawn_while_the_robots_run(story: Make, add_state: Make) -> None:
    drive, moved = story(ticks=60), Recording(story().config)
    add_state(moved, Phase.RUNNING, Event.PROVED)
    running = with_references(drive.recording(truth=False), drive.group)
    for full in running.messages:
        for _, payload in running.placed(full):
            moved.add(full, payload)
    viewer = Viewer(drive.config).play(moved)
    newest = viewer.messages["/references"][-1].entities[0]
    assert [dot.pose.position.y for dot in newest.spheres] == [0.0, 1.0, 2.0, 3.0]
    assert newest.spheres[0].pose.position.x == newest.spheres[3].pose.position.x > 60
    ends = [(p.x, p.y) for p in newest.lines[0].points]
    assert ends[1::2] == [(dot.pose.position.x, dot.pose.position.y) for dot in newest.spheres]
    assert ends[0] == pytest.approx(drive.points[int(newest.spheres[0].pose.position.x) - drive.before, 0], abs=1e-9)
    add_state(moved, Phase.HOLD, Event.HOLD_REQUESTED)
    (_, held) = moved.messages[key("platoon", STATE)]
    end_ns = START_NS + 70 * TICK_NS
    viewer.tell(key("platoon", STATE), held, end_ns)
    viewer.tell(key("platoon", TICK), moved.messages[key("platoon", TICK)][-1], end_ns + S)
    viewer.tell(key("platoon", STATE), held, end_ns + 2 * S)
    assert len(viewer.messages["/references"][-1].entities[0].spheres) == 0


def test_the_log_says_what_happened_and_why(story: Make, add_state: Make, add_status: Make) -> None:
    recording = Recording(story().config)
    add_state(recording, Phase.IDLE, Event.NOTHING, halts=(Event.TAG_LATE, 0, 0, 0))
    add_state(recording, Phase.RUNNING, Event.PROVED)
    add_state(recording, Phase.RUNNING, Event.PROVED)
    add_state(recording, Phase.RUNNING, Event.PROVED, halts=(0, Event.TAG_LATE, 0, 0))
    add_state(recording, Phase.RUNNING, Event.PROVED, halts=(0, Event.TAG_LATE, Event.TAG_LATE, 0))
    add_state(recording, Phase.RUNNING, Event.PROVED, halts=(0, 0, Event.TAG_LATE, 0))
    add_state(recording, Phase.FAULT, Event.TAG_LOST, robot=2)
    news = TrackerNews(1, 1, S, TrackerEvent.CAMERA_STALLED, NO_TAG, 0.5)
    recording.add(key("platoon", NEWS, CAMERA), TRACKER_NEWS.encode(news))
    add_status(recording, "r1", S)
    (status,) = recording.messages[key("platoon", STATUS, "r1")]
    viewer = Viewer(recording.config).play(recording)
    for latch in (Latch.WIRED_STOP, Latch.WIRED_STOP, Latch.NONE):
        latched = ROBOT_STATUS.decode(status)._replace(latch=latch)  # type: ignore[union-attr]
        viewer.tell(key("platoon", STATUS, "r1"), ROBOT_STATUS.encode(latched), 9 * S)
    assert viewer.log == [
        (INFO, "supervisor", "idle"),
        (INFO, "supervisor", "running: every check passed"),
        (WARNING, "r2", "stands still: it is not seen"),
        (WARNING, "r3", "stands still: it is not seen"),
        (INFO, "r2", "may move again"),
        (ERROR, "supervisor", "fault: r3: the tracker lost the robot"),
        (WARNING, "tracker", "camera stalled: no image for 0.50 s"),
        (ERROR, "r1", "gate latched: wired stop"),
        (INFO, "r1", "gate cleared"),
    ]
    assert instant_ns(viewer.messages["/log"][-1].timestamp) == 9 * S


def test_what_cannot_be_read_changes_nothing(story: Make) -> None:
    recording = story(ticks=10).recording()
    viewer = Viewer(recording.config).play(recording)
    viewer.tell("something/else", b"", 8 * S)
    before = {topic: len(messages) for topic, messages in viewer.messages.items()}
    names = {"unit/{}/status": "r1", "unit/{}/cmd": "r1", "sim/{}/truth": "r1"}
    for topic in TOPICS:
        for payload in (b"", b"\x03", b"\xff" * 400, bytes(2000)):
            viewer.tell(key("platoon", topic, names.get(topic.key, CAMERA)), payload, 9 * S)
    viewer.tell("rf/another/tick", recording.messages[key("platoon", TICK)][0], 11 * S)
    assert {topic: len(messages) for topic, messages in viewer.messages.items()} == before


def test_a_value_of_another_version_is_told_as_its_number(story: Make, add_state: Make) -> None:
    recording = Recording(story().config)
    add_state(recording, 77, 99, NOBODY)
    assert Viewer(recording.config).play(recording).log[0][2].startswith("unknown (77)")


@pytest.mark.parametrize("seed", range(20))
def test_triangles_fill_a_star(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angle, reach = np.sort(rng.uniform(0.0, math.tau, 11)), rng.uniform(0.1, 1.0, 11)
    star = Solid("star", tuple(zip((reach * np.cos(angle)).tolist(), (reach * np.sin(angle)).tolist(), strict=True)))
    outline = star.outline.tolist()
    found = triangles(outline)
    assert len(found) == len(outline) - 2
    assert sum(area(triangle) for triangle in found) == pytest.approx(area(outline))
    assert min(area(triangle) for triangle in found) > -1e-12
    middles = np.array([np.mean(triangle, axis=0) for triangle in found])
    assert distances((star,), middles).max() < 1e-9


def test_every_obstacle_of_a_configuration_is_in_the_viewers_scene() -> None:
    config = load_config(SHIPPED / "obstacles.yaml")
    entities = {entity.id: entity for entity in arena(config, (), None)}  # type: ignore[arg-type]
    assert {"arena", "obstacles/box", "obstacles/pillar", "obstacles/wall"} == set(entities)
    assert len(entities["arena"].lines) == 2, "the arena, and its floor"
    tops = {point.z for point in entities["obstacles/box"].triangles[0].points}
    assert tops == {0.0, 0.15}
    assert len(prism([(0, 0), (1, 0), (0, 1)], 1.0, Color()).points) == 3 + 3 * 6
