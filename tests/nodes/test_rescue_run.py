"""A run that is held, and one robot that a person drives out at a crawl: who is permitted what, and what moves."""

from collections.abc import Callable
from pathlib import Path
from random import Random

import numpy as np
import pytest

from robofleet.bus.keys import ENABLE, STATE, STATUS, TICK, TRUTH, WISH, key
from robofleet.bus.messages import RUN_STATE, TICK_RECORD, UNIT_ENABLE, UNIT_STATUS, UNIT_TRUTH
from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.operator.hand import Hand, Stick
from robofleet.recording.lines import state_lines
from robofleet.recording.log import RunLog
from robofleet.recording.reading import read
from robofleet.recording.run import Run
from robofleet.reports.stops import stops
from robofleet.runs.lockstep import Lockstep
from robofleet.runs.replay import replay
from robofleet.safety.rescue import WORD_NS
from robofleet.safety.supervisor import Phase

TELEOP, GROUP = SHIPPED / "teleop.yaml", "teleop"
CRAWL_M_S, RADIUS_M = 0.05, 0.016
AT_THE_WALL = "robots.0.start={x_m: 1.38, y_m: 0.0, heading_deg: 0}"
BACK, AHEAD, LET_GO = Stick(-1.0, 0.0, True), Stick(1.0, 0.0, True), Stick(0.0, 0.0, False)
STANDS_WITHIN_S = (WORD_NS + 120e6 + 40e6) * 1e-9 + 0.1  # its word, the gate's patience, a step; the wheels' ramp


class Held:
    """A run in lockstep beside a person with a gamepad: what was permitted, and what moved."""

    def __init__(self, *changes: str, faults: Path | None = None, file: Path | None = None) -> None:
        given = ["run.duration_s=3600", "tracker.source=truth", AT_THE_WALL, *changes]
        self.config = load_config(TELEOP, given, faults)
        self.log = None if file is None else RunLog(file, self.config)
        self.run = Lockstep(self.config, log=self.log)
        self.hand = Hand(self.run.bus, self.config, GROUP)
        self.stick: Stick | None = LET_GO
        self.out: str | None = None
        self.held_s = 0.0  # when the button was held last
        self.limits: dict[str, float] = {}  # of each robot, as permitted last [rad/s]
        self.wheels: dict[str, float] = {}  # the faster one's output
        self.lines: list[str] = []
        self.broken: list[str] = []  # what may never be
        self.x_m = np.zeros(4)  # as is true
        self._state = None
        self.run.bus.tap(self._hear)

    @property
    def now_s(self) -> float:
        return self.run.clock.now_ns() * 1e-9

    def begin(self, phase: Phase = Phase.RUNNING) -> None:
        self.run.request(b"start")
        assert self.run.advance(60.0, lambda: self.run.status.phase is phase)

    def hold(self) -> None:
        self.run.request(b"hold")
        assert self.run.advance(1.0, lambda: self.run.status.phase is Phase.HOLD)
        self.run.advance(1.0)

    def becomes(self, condition: Callable[[], bool], within_s: float = 3.0) -> None:
        assert self.run.advance(within_s, condition), (self.run.status, self.limits, self.wheels, self.lines)

    def stands(self, within_s: float = STANDS_WITHIN_S) -> None:
        self.becomes(lambda: not any(self.wheels.values()) and not any(self.limits.values()), within_s)

    def _hear(self, message: tuple[str, bytes]) -> None:
        full, payload = message
        arena = self.config.arena.name
        if full == key(arena, TICK) and (tick := TICK_RECORD.decode(payload)) is not None:
            self._drive(tick.tick)
        elif full == key(arena, STATE) and (state := RUN_STATE.decode(payload)) is not None:
            self.lines += [f"{line.name}: {line.words}" for line in state_lines(self._state, state, self.config.ids)]
            self._state = state
        for unit, robots in self.config.units.items():
            if full == key(arena, TRUTH, unit) and (truth := UNIT_TRUTH.decode(payload)) is not None:
                for body in truth.robots:
                    self.x_m[self.config.ids.index(robots[body.place])] = body.x_m
            if full == key(arena, ENABLE, unit) and (enable := UNIT_ENABLE.decode(payload)) is not None:
                limits = [body.limit_rad_s for body in enable.robots]
                self.limits.update(zip(robots, limits, strict=True))
                self._judge(enable.phase)
            elif full == key(arena, STATUS, unit) and (status := UNIT_STATUS.decode(payload)) is not None:
                for robot, body in zip(robots, status.robots, strict=True):
                    self.wheels[robot] = max(abs(body.left_output_rad_s), abs(body.right_output_rad_s))

    def _drive(self, tick: int) -> None:
        if self.stick is None:
            return
        if self.stick.held:
            self.held_s = self.now_s
        assert self.hand.drive(self.stick, tick, self.out)

    def _judge(self, phase: int) -> None:
        """Note what breaks the rules of a held run, and of every phase in which nothing may move."""
        positive = {robot: limit for robot, limit in self.limits.items() if limit > 0.0}
        if phase in (Phase.RUNNING, Phase.ARMED):
            return
        if positive and phase != Phase.HOLD:
            self.broken.append(f"{Phase(phase).name}: {positive}")
        if len(positive) > 1:
            self.broken.append(f"several: {positive}")
        if positive and self.now_s - self.held_s > WORD_NS * 1e-9 + 0.045:
            self.broken.append(f"no button: {positive}")
        if any(limit > CRAWL_M_S / RADIUS_M * (1 + 1e-9) for limit in positive.values()):
            self.broken.append(f"no crawl: {positive}")


def test_a_robot_stranded_at_the_wall_is_driven_out_and_the_run_goes_on(tmp_path: Path) -> None:
    held = Held(file=tmp_path / "run.mcap")
    held.begin()
    held.stick = AHEAD
    held.run.advance(2.0)
    assert held.x_m[0] < 1.6 - 0.055, "the barrier keeps it off the wall"
    held.stick = LET_GO
    held.hold()
    before, began_s = held.x_m.copy(), held.now_s
    held.out, held.stick = "r1", BACK
    held.becomes(lambda: bool(held.x_m[0] < before[0] - 0.2), 6.0)
    assert held.now_s - began_s > 0.19 / CRAWL_M_S, "no faster than a crawl"
    assert held.limits["r1"] == pytest.approx(CRAWL_M_S / RADIUS_M)
    assert held.x_m[1:] == pytest.approx(before[1:], abs=1e-3), "all others stand"
    held.stick = LET_GO
    held.stands()
    out = "r1: a person drives it out at a crawl, by `robofleet teleop`"
    assert held.lines.index(out) < held.lines.index("r1: it is driven out no more")
    held.run.request(b"resume")
    held.becomes(lambda: held.run.status.phase is Phase.RUNNING)
    held.out, held.stick, x_m = None, BACK, held.x_m[0]
    held.becomes(lambda: bool(held.x_m[0] < x_m - 0.1))
    held.run.request(b"stop")
    held.becomes(lambda: held.run.status.phase is Phase.IDLE)
    held.run.close()
    assert held.log is not None
    held.log.close()
    assert not held.broken
    run_stops = stops(Run(held.run.recording))
    assert any(stop["robot"] == "r1" and "a person no longer drives it out" in stop["cause"] for stop in run_stops)
    assert replay(read(tmp_path), 0.0).equal, "a replay finds every command of the person's"


@pytest.mark.slow
def test_a_program_that_sends_what_a_person_sends_moves_nothing_running_or_held() -> None:
    """On the topic that a program's certificate permits, whatever it claims to be."""
    held = Held()
    held.hand._publish = held.run.bus.publisher(WISH, GROUP, "web/mallory/1f")
    held.begin()
    before = held.x_m.copy()
    held.stick = BACK
    held.run.advance(1.0)
    held.stick = LET_GO
    held.hold()
    held.out, held.stick = "r1", BACK
    for _ in range(20):
        held.run.advance(0.1)
        assert not any(held.limits.values()) and not any(held.wheels.values())
    assert held.x_m == pytest.approx(before, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["r1", "r3"])
def test_any_robot_of_the_group_is_driven_out_but_not_towards_another(robot: str) -> None:
    held = Held()
    held.begin()
    held.hold()
    before = held.x_m.copy()
    held.out, held.stick = robot, AHEAD if robot == "r1" else BACK
    held.run.advance(8.0)
    moved = np.abs(held.x_m - before)
    row = held.config.ids.index(robot)
    assert np.delete(moved, row) == pytest.approx(0.0, abs=1e-3)
    if robot == "r1":
        assert held.x_m[0] < 1.6 - 0.055, "the barrier keeps it off the wall"
    else:
        gap_m = held.x_m[2] - held.x_m[3]
        assert gap_m > 2 * 0.055, "and off the robot that stands behind it"
        assert moved[2] > 0.01
    assert held.run.status.phase is Phase.HOLD
    assert not held.broken


@pytest.mark.slow
def test_a_button_that_was_held_when_the_run_was_held_and_when_it_goes_on_moves_nothing() -> None:
    held = Held()
    held.begin()
    held.stick = BACK
    held.run.advance(1.0)
    held.run.request(b"hold")
    held.becomes(lambda: held.run.status.phase is Phase.HOLD)
    held.out = "r1"
    held.stands()
    held.run.advance(0.5)
    x_m = held.x_m[0]
    held.run.advance(1.0)
    assert held.x_m[0] == pytest.approx(x_m, abs=1e-3)
    held.stick = LET_GO
    held.run.advance(0.1)
    held.stick = BACK
    held.becomes(lambda: held.wheels["r1"] > 0.0)
    held.run.request(b"resume")
    held.becomes(lambda: held.run.status.phase is Phase.RUNNING)
    held.out = None
    held.becomes(lambda: not held.wheels["r1"])
    held.run.advance(0.5)
    x_m = held.x_m[0]
    held.run.advance(1.0)
    assert held.x_m[0] == pytest.approx(x_m, abs=1e-3), "it was not let go since"
    assert not held.broken


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "ends"),
    [
        ("{kind: killed, process: driver-r1, at_s: 8}", Phase.FAULT),
        ("{kind: stopped, process: driver-r1, at_s: 8, duration_s: 5}", Phase.FAULT),
        ("{kind: killed, process: controller, at_s: 8}", Phase.FAULT),
        ("{kind: stopped, process: tracker, at_s: 8, duration_s: 60}", Phase.HOLD),
        ("{robot: r1, kind: pose_dropout, at_s: 8, duration_s: 60}", Phase.HOLD),
        ("{robot: r2, kind: pose_dropout, at_s: 8, duration_s: 60}", Phase.HOLD),
        ("{robot: r2, kind: wired_stop, at_s: 8, duration_s: 60}", Phase.ESTOP),
    ],
)
def test_whatever_fails_lets_it_stand(fault: str, ends: Phase, tmp_path: Path) -> None:
    file = tmp_path / "faults.yaml"
    file.write_text(f"faults:\n  - {fault}\n")
    held = Held(faults=file)
    held.begin()
    began_s = held.now_s
    held.hold()
    held.out, held.stick = "r1", BACK
    held.becomes(lambda: held.wheels["r1"] > 0.0)
    held.run.advance(8.0 - (held.now_s - began_s) + 1.0)
    assert held.run.status.phase is ends
    x_m = held.x_m[0]
    held.run.advance(2.0)
    assert held.x_m[0] == pytest.approx(x_m, abs=1e-3)
    assert not held.broken


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(6))
def test_in_any_sequence_of_inputs_one_robot_at_most_may_crawl_and_none_without_the_button(seed: int) -> None:
    draw, held = Random(seed), Held()
    held.begin()
    held.hold()
    crawled = False
    for _ in range(60):
        match draw.randrange(12):
            case 0:
                held.run.request(draw.choice([b"hold", b"resume", b"status"]))
            case 1:
                held.out = None
            case 2 | 3:
                held.out = draw.choice(held.config.ids)
            case 4:
                held.stick = None
            case 5 | 6:
                held.stick = LET_GO
            case 7 | 8 | 9:
                held.stick = Stick(draw.uniform(-1, 1), draw.uniform(-1, 1), True)
        held.run.advance(draw.uniform(0.01, 0.4))
        if held.run.status.phase is Phase.RUNNING and draw.random() < 0.5:
            held.run.request(b"hold")
        crawled = crawled or (held.run.status.phase is Phase.HOLD and any(held.limits.values()))
    assert crawled, "the sequence shows something"
    assert not held.broken
