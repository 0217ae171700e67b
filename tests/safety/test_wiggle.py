"""The wiggle told by hand, instant by instant: how long it waits, what it counts, and what makes it break off."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.safety import wiggle
from robofleet.safety.supervisor import NOBODY, Event, Happening
from robofleet.safety.view import FleetView, RobotView
from robofleet.safety.wiggle import BACK, FORTH, LEFT, RIGHT, STAND, Means, Wiggle, room_m, travel_m
from robofleet.vehicles.differential_drive import arc, body_from_wheels

MS, S = 1_000_000, 1_000_000_000
RADIUS, BASE = 0.016, 0.105
OUTPUTS = (6.0, 3.6)  # what the gate lets through in a stroke [rad/s]
STROKE_NS = 240 * MS


def _told(before: RobotView, after: RobotView, ns: int) -> RobotView:
    """Add up what the gate lets through: it rises and falls along a straight line."""
    left, right = before.left_output + after.left_output, before.right_output + after.right_output
    half_s = ns * 0.5e-9
    return after._replace(left_told=before.left_told + half_s * left, right_told=before.right_told + half_s * right)


class Trial:
    """Robots that stand, and wiggle one after the other; what becomes of them is told from look to look."""

    def __init__(self, *, on_the_spot: bool = False, rounds: tuple[tuple[int, int], ...] = ((0, 1), (2, 3))) -> None:
        robots = tuple(RobotView(heard_ns=S, pose=(0.0, 0.5 * row, 0.0)) for row in range(len(rounds)))
        self.view = FleetView(S, robots, tick=100)
        self.state = wiggle.begin(self.view, rounds, on_the_spot=on_the_spot)

    def look(self, after_ns: int, *, row: int = 0, image: bool = True, tick: int = 0, **robot: Any) -> Happening | None:
        """Look again: by default there is a new image of both, of the tick before; a robot may have changed."""
        view, now_ns = self.view, self.view.now_ns + after_ns
        robots = [seen._replace(heard_ns=now_ns) for seen in view.robots]
        robots[row] = _told(robots[row], robots[row]._replace(**robot), after_ns)
        if image:
            view = view._replace(image=view.image + 1, image_tick=tick or view.tick + 1)
            robots = [seen._replace(image=view.image) for seen in robots]
        self.view = view._replace(now_ns=now_ns, tick=view.tick + 2, robots=tuple(robots))
        n = len(robots)
        self.state, happening = wiggle.step(self.state, (RADIUS,) * n, (BASE,) * n, self.view)
        return happening

    @property
    def commanded(self) -> tuple[float, float]:
        robot, (left, right) = self.view.robots[0], self.state.tried[0].commanded
        return robot.left_told - left, robot.right_told - right

    @property
    def stroke(self) -> int:
        """What the first robot must do."""
        return self.state.strokes[0]

    def looked_at(self) -> "Trial":
        """Let three images pass: somebody begins a stroke."""
        for _ in range(3):
            assert self.look(30 * MS) is None
        return self

    def driven(self, outputs: tuple[float, float] = OUTPUTS) -> "Trial":
        """Let the first robot drive for its stroke's time."""
        assert self.look(STROKE_NS, image=False, left_output=outputs[0], right_output=outputs[1]) is None
        return self

    def at_rest(self) -> "Trial":
        """Let the first robot come to rest where the stroke leads."""
        rolled = [2.0 * wheels for wheels in self.commanded]  # as long as it drove, so long it slows down
        pose = arc(0.0, 0.0, 0.0, *body_from_wheels(*rolled, RADIUS, BASE), 1.0)
        self.look(STROKE_NS, image=False, left_output=0.0, right_output=0.0, pose=pose)
        assert self.look(400 * MS, image=False) is None
        assert self.state.rest_tick is not None
        return self


@given(
    st.lists(st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(-0.5, 0.5)), min_size=1, max_size=8),
    st.floats(-math.pi, math.pi),
)
@settings(deadline=None)
def test_the_mean_of_poses_is_their_mean_also_across_the_cut_of_the_angle(
    poses: list[tuple[float, float, float]], heading: float
) -> None:
    means = Means.none(2)
    for x, y, psi in poses:
        seen = np.array([(9.0, 9.0, 9.0), (x, y, math.remainder(heading + psi, math.tau))])
        means = means.add(seen, np.array([False, True]))
    x, y, psi = (sum(values) / len(poses) for values in zip(*poses, strict=True))
    assert means.images.tolist() == [0, len(poses)]
    assert means.poses[1, :2] == pytest.approx((x, y), abs=1e-12)
    assert math.remainder(means.poses[1, 2] - heading - psi, math.tau) == pytest.approx(0.0, abs=1e-12)


def test_a_stroke_begins_after_three_images_of_everybody() -> None:
    trial = Trial()
    trial.look(30 * MS)
    trial.look(30 * MS)
    assert (trial.state.round, trial.state.strokes) == (-1, (0, 0))
    trial.look(30 * MS)
    assert (trial.state.round, trial.state.strokes) == (0, (1, 0))


def test_images_are_waited_for_two_seconds() -> None:
    trial = Trial()
    assert trial.look(2 * S - 1, image=False) is None
    assert trial.look(1, image=False) == Happening(Event.TAG_LOST, 0)


@pytest.mark.parametrize(
    "step", [{"pose": (0.006, 0.5, 0.0)}, {"pose": (0.0, 0.5, 0.05)}, {"pose": (0.0, 0.4941, 0.0)}]
)
def test_a_robot_that_stands_may_seem_to_move_a_little(step: dict[str, Any]) -> None:
    trial = Trial().looked_at()
    assert trial.look(30 * MS, row=1, **step) is None
    assert trial.state.strange == NOBODY


@pytest.mark.parametrize(
    "pose", [(0.0061, 0.5, 0.0), (0.0, 0.5061, 0.0), (0.0, 0.4939, 0.0), (0.0, 0.5, 0.0501), (0.0, 0.5, -0.0501)]
)
def test_a_tag_that_moves_unasked_stops_everybody_at_once(pose: tuple[float, float, float]) -> None:
    """It is named when all rest: after 400 ms without encoders, and three images of that."""
    trial = Trial().looked_at()
    assert trial.look(30 * MS, row=1, pose=pose) is None
    assert trial.state.strokes == (0, 0)
    assert trial.look(400 * MS) is None
    for _ in range(2):
        assert trial.look(30 * MS) is None
    assert trial.look(30 * MS) == Happening(Event.WRONG_TAG_MOVED, 0, 1)


@pytest.mark.parametrize("images", [True, False])
def test_who_moved_it_is_named_also_where_nobody_comes_to_rest_or_is_seen(images: bool) -> None:
    trial = Trial().looked_at()
    assert trial.look(30 * MS, row=1, pose=(0.01, 0.5, 0.0)) is None
    if not images:
        assert trial.look(400 * MS, image=False) is None
    assert trial.look(2 * S - 1, image=images, left_speed=float(images)) is None
    assert trial.look(1, image=images) == Happening(Event.WRONG_TAG_MOVED, 0, 1)


@pytest.mark.parametrize("images", [0, 3])
def test_of_two_that_drive_the_one_whose_tag_stood_moves_the_other_tag(images: int) -> None:
    """It is judged by its mean: in the last image alone it seems to have rolled. Without images, by where all are."""
    trial = Trial(rounds=((0, 1), (2, 3), (0, 2))).looked_at()
    for row in (0, 2):
        trial.look(STROKE_NS, row=row, image=False, left_output=6.0, right_output=3.6)
    assert trial.look(30 * MS, row=1, pose=(0.01, 0.5, 0.0)) is None
    trial.look(STROKE_NS, image=False, left_output=0.0, right_output=0.0)
    trial.look(STROKE_NS, row=2, image=False, left_output=0.0, right_output=0.0, pose=(0.02, 1.0, 0.0))
    assert trial.look(400 * MS, image=False) is None
    named = None
    for k in range(images):
        assert named is None
        named = trial.look(30 * MS, pose=(0.01 * (k == images - 1), 0.0, 0.0))
    named = named or trial.look(2 * S, image=False)
    assert named == Happening(Event.WRONG_TAG_MOVED, 0, 1)


def test_another_one_is_watched_also_when_the_tried_one_has_come_to_rest() -> None:
    trial = Trial().looked_at().driven().at_rest()
    assert trial.look(30 * MS, row=1, pose=(0.01, 0.5, 0.0)) is None
    assert trial.state.strange == 1
    assert trial.state.rest_tick is None, "everybody comes to rest anew"


def test_the_mean_of_who_stands_is_taken_while_another_one_drives() -> None:
    trial = Trial()
    for _ in range(3):
        trial.look(30 * MS, row=1, pose=(0.003, 0.5, 0.0))
    for _ in range(6):
        assert trial.look(30 * MS, row=1, pose=(-0.003, 0.5, 0.0)) is None
    trial.look(30 * MS, row=1, pose=(0.0052, 0.5, 0.0))
    assert trial.state.strange == 1, "6.2 mm from the mean, 2.2 mm from that of the first three images"


def test_who_has_done_its_stroke_stands_while_another_one_is_late() -> None:
    trial = Trial(rounds=((0, 1), (0, 2))).looked_at()
    assert trial.state.strokes == (FORTH, FORTH)
    trial.driven()
    assert trial.state.strokes == (STAND, FORTH)


def test_on_the_spot_a_stroke_begins_after_twelve_images_and_takes_750_ms() -> None:
    trial = Trial(on_the_spot=True)
    for _ in range(11):
        trial.look(30 * MS)
    assert trial.state.strokes == (STAND, STAND)
    trial.look(30 * MS)
    assert trial.state.strokes == (LEFT, STAND)
    wheels = {"left_output": -0.7, "right_output": 1.0}
    assert trial.look(750 * MS - 1, image=False, **wheels) is None
    assert trial.state.strokes == (LEFT, STAND)
    assert trial.look(1, image=False) is None
    assert trial.state.strokes == (STAND, STAND)


def test_who_gets_too_far_on_the_spot_is_stopped_and_told_how_far_he_got() -> None:
    at_most = room_m(RADIUS, LEFT)
    for row, event in ((0, Event.WRONG_GAIN), (1, Event.WRONG_TAG_MOVED)):
        trial = Trial(on_the_spot=True)
        for _ in range(12):
            trial.look(30 * MS)
        y = 0.5 * row
        if row == 1:  # its tag moves unasked, and goes on
            assert trial.look(30 * MS, row=1, pose=(0.0, y, 0.051)) is None
            assert trial.state.strange == 1
        assert trial.look(30 * MS, row=row, pose=(0.0, y, 0.051 * row)) is None
        got = trial.look(30 * MS, row=row, pose=(at_most + 1e-4, y, 0.051 * row))
        assert got is not None
        assert (got.event, got.robot) == (event, 0)
        if row == 0:
            assert got.detail == pytest.approx((at_most + 1e-4) / travel_m(RADIUS, LEFT))


def test_a_robot_may_get_half_as_far_again_as_its_stroke_and_the_noise() -> None:
    for strokes, noise in (((FORTH, BACK), 0.006), ((LEFT, RIGHT), 0.002)):
        for stroke in strokes:
            assert room_m(RADIUS, stroke) == pytest.approx(1.5 * travel_m(RADIUS, stroke) + noise)


def test_a_fleet_of_bystanders_has_wiggled_once_it_was_looked_at() -> None:
    assert not Wiggle(round=-1).done
    assert Wiggle(round=0).done


def test_who_gets_further_than_his_room_is_stopped_and_told_how_far_he_got() -> None:
    at_most = room_m(RADIUS)
    assert Trial().looked_at().look(30 * MS, pose=(at_most, 0.0, 0.0)) is None
    got = Trial().looked_at().look(30 * MS, pose=(0.0, at_most + 1e-4, 0.0))
    assert got == Happening(Event.WRONG_GAIN, 0, pytest.approx((at_most + 1e-4) / travel_m(RADIUS)))


@pytest.mark.parametrize("wheels", [(1.0, 0.6), (0.6, 1.0), (-1.0, -0.6)])
@pytest.mark.parametrize(("share", "enough"), [(1.0, True), (0.999, False)])
def test_a_stroke_takes_its_time_and_half_of_its_travel(
    wheels: tuple[float, float], share: float, enough: bool
) -> None:
    """The output rises along a straight line, so it was half of what it is."""
    trial = Trial().looked_at()
    outputs = {"left_output": 6.0 * share * wheels[0], "right_output": 6.0 * share * wheels[1]}
    trial.look(STROKE_NS - 1, image=False)
    assert trial.stroke == 1, "not before its time"
    trial = Trial().looked_at()
    assert trial.look(STROKE_NS, image=False, **outputs) is None
    assert (trial.stroke == 0) is enough
    trial.look(20 * MS, image=False)
    assert trial.stroke == 0, "what comes late gets more time"


def test_what_was_asked_in_the_first_stroke_does_not_count_in_the_second() -> None:
    trial = Trial().looked_at().driven().at_rest()
    assert trial.look(30 * MS, left_output=0.04) is None  # still at rest
    for _ in range(2):
        assert trial.look(30 * MS) is None
    assert trial.stroke == 2
    assert trial.look(STROKE_NS, image=False, left_output=-5.99, right_output=-3.6) is None
    assert max(map(abs, trial.commanded)) == pytest.approx(0.12 * (5.99 - 0.04))
    assert trial.stroke == 2


def test_a_command_is_waited_for_one_second() -> None:
    trial = Trial().looked_at()
    assert trial.look(S - 1, image=False) is None
    assert trial.look(1, image=False) == Happening(Event.LEASE_LOST, 0)


@pytest.mark.parametrize(
    ("angle", "needed_ns"), [(0.0, 400 * MS), (0.001, 400 * MS), (0.00101, 100 * MS), (-0.00101, 100 * MS)]
)
@pytest.mark.parametrize("wheel", ["left_angle", "right_angle"])
def test_rest_is_believed_sooner_where_an_encoder_counts_from_the_strokes_end_on(
    wheel: str, angle: float, needed_ns: int
) -> None:
    trial = Trial().looked_at().driven()
    assert trial.look(needed_ns - 1, image=False, left_output=0.0, right_output=0.0, **{wheel: angle}) is None
    assert trial.state.rest_tick is None
    assert trial.look(1, image=False) is None
    assert trial.state.rest_tick == trial.view.tick


def test_rest_is_waited_for_two_seconds() -> None:
    trial = Trial().looked_at().driven()
    assert trial.look(2 * S - 1, image=False, left_speed=1.0) is None
    assert trial.look(1, image=False) == Happening(Event.NOT_AT_REST, 0)


def test_images_of_rest_are_waited_for_two_seconds_from_rest_on() -> None:
    trial = Trial().looked_at().driven().at_rest()
    assert trial.look(2 * S - 1, image=False) is None
    assert trial.look(1, image=False) == Happening(Event.TAG_LOST, 0)


def test_an_image_of_the_very_tick_at_which_a_robot_came_to_rest_does_not_count() -> None:
    trial = Trial().looked_at().driven().at_rest()
    rest_tick = trial.state.rest_tick
    assert rest_tick is not None
    for _ in range(6):
        assert trial.look(30 * MS, tick=rest_tick) is None
    assert trial.stroke == 0
    for _ in range(3):
        assert trial.look(30 * MS, tick=rest_tick + 1) is None
    assert trial.stroke == 2
