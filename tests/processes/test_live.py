"""What the live view shows an operator, and what it offers."""

import io
from collections.abc import Callable

import pytest
from rich.console import Console

from robofleet.clock import SimulatedClock
from robofleet.comms.keys import STATE, STATUS, TICK, key
from robofleet.comms.messages import (
    ROBOT_STATUS,
    RUN_STATE,
    TICK_RECORD,
    RobotState,
    RobotStatus,
    RobotTick,
    RunState,
    TickRecord,
)
from robofleet.config.tree import Config
from robofleet.processes.live import LiveView
from robofleet.processes.terminal import Terminal
from robofleet.recording.metrics import summary
from robofleet.recording.run import Recording
from robofleet.safety.arming import Stage
from robofleet.safety.gate import GateStatus, Latch
from robofleet.safety.supervisor import NOBODY, Event, Phase
from tests.recording.conftest import Story

WELL = RobotState(1, 1, 0)
FOUR = (WELL,) * 4


class Attended(Terminal):
    """A terminal that is there."""

    present = True


class View:
    """The view of a fleet of four of which it was said what a test says."""

    def __init__(self, config: Config) -> None:
        self.terminal = Terminal()
        self.recording, self._config = Recording(config), config
        robots = (RobotTick(*(0.0,) * len(RobotTick._fields)),) * 4
        self.recording.add(key("platoon", TICK), TICK_RECORD.encode(TickRecord(1, 1, 9, -1, 1, *[0] * 10, robots)))
        for robot in config.platoon:
            self.gate(robot.id, GateStatus.OPEN, Latch.NONE)

    def gate(self, robot: str, gate: int, latch: int) -> None:
        status = RobotStatus(1, 1, 1, 1, 1, 1, 1, 0, 0, 0, gate, latch, 1, 0, 0, -1, -1, *(0.0,) * 8, 1.0)
        self.recording.add(key("platoon", STATUS, robot), ROBOT_STATUS.encode(status))

    def state(
        self, phase: int, cause: int = Event.NOTHING, robot: int = NOBODY, stage: int = 0, probed: int = NOBODY,
        stroke: int = 0, robots: tuple[RobotState, ...] = FOUR,
    ) -> None:  # fmt: skip
        message = RunState(1, 1, phase, cause, robot, 0.0, stage, probed, stroke, robots)
        self.recording.add(key("platoon", STATE), RUN_STATE.encode(message))

    def shown(self, phase: str) -> str:
        """Return what a terminal of 100 columns shows."""
        view = LiveView(self._config, SimulatedClock(), self.terminal, quiet=True)
        view(self.recording, phase)
        output = io.StringIO()
        Console(file=output, width=100, color_system=None).print(view.picture(self.recording, phase))
        return output.getvalue()


@pytest.fixture
def view(platoon_of: Callable[..., Config]) -> View:
    return View(platoon_of())


def row(text: str, robot: str) -> str:
    (found,) = [line for line in text.splitlines() if line.startswith(robot)]
    return found


def test_while_arming_it_says_what_is_tried(view: View) -> None:
    view.state(Phase.ARMED, stage=Stage.CHECKS)
    assert "is everything there, fresh and at rest?" in view.shown("arming")
    view.state(Phase.ARMED, stage=Stage.WIGGLE, probed=1, stroke=1)
    assert "trying r2" in view.shown("arming")


def test_a_hold_is_seen_with_its_cause_and_what_to_do(view: View) -> None:
    view.state(Phase.HOLD, Event.POSE_JUMPED, 1)
    shown = view.shown("held")
    assert "HOLD" in shown
    assert "r2: it was moved by hand" in shown
    assert "`robofleet resume` goes on" in shown
    view.terminal = Attended()
    assert "press r and the run goes on" in view.shown("held")


def test_an_emergency_stop_names_who_has_not_answered(view: View) -> None:
    view.state(Phase.ESTOP, Event.WIRED_STOP, 0)
    assert "Every robot has latched its gate." in view.shown("emergency stop")
    view.state(Phase.ESTOP, Event.WIRED_STOP, 0, robots=(WELL, WELL, RobotState(0, 0, 0), WELL))
    shown = view.shown("emergency stop")
    assert "r1: the robot's own e-stop" in shown
    assert "NOT acknowledged by r3" in shown


def test_a_robots_row_says_why_it_may_not_move(view: View) -> None:
    view.gate("r1", GateStatus.LATCHED, Latch.WIRED_STOP)
    view.gate("r2", GateStatus.NO_ENABLE, Latch.NONE)
    view.gate("r3", GateStatus.NO_ENABLE, Latch.NONE)
    view.state(Phase.RUNNING, robots=(WELL, RobotState(0, 0, Event.TAG_LATE), WELL, WELL))
    shown = view.shown("running")
    assert row(shown, "r1").rstrip().endswith("wired stop")
    assert "its tag is not seen" in row(shown, "r2")
    assert "no enable" in row(shown, "r3")
    assert "open" in row(shown, "r4")


def test_keys_are_offered_where_somebody_can_press_them(view: View) -> None:
    view.state(Phase.RUNNING)
    assert "emergency stop" not in view.shown("running")
    view.terminal = Attended()
    view.terminal.note = "refused: r2's tag is not seen"
    shown = view.shown("running")
    assert " e  emergency stop    h  hold    r  resume    q  end the run" in shown
    assert "refused: r2's tag is not seen" in shown


def test_the_keys_come_before_what_a_low_terminal_cuts_off(view: View) -> None:
    view.terminal = Attended()
    lines = view.shown("running").splitlines()
    keys = next(i for i, line in enumerate(lines) if "emergency stop" in line)
    assert keys <= 2
    assert all(i > keys for i, line in enumerate(lines) if line.startswith("r1"))


def test_values_of_another_version_break_nothing(view: View) -> None:
    view.gate("r1", 77, 77)
    view.gate("r2", 77, 0)
    view.state(77, 777, 7777, 77, 3, 77, robots=(WELL, RobotState(0, 0, 777)))
    for phase in ("arming", "running", "held"):
        shown = view.shown(phase)
        assert "unknown (77)" in row(shown, "r1")


@pytest.mark.parametrize("track", ["point", "centre"])
@pytest.mark.parametrize("origin", [0.0, 2.4])
def test_its_errors_are_the_summarys(platoon_of: Callable[..., Config], origin: float, track: str) -> None:
    told = Story(platoon_of(f"groups.0.track={track}", "run.spacing_settle_s=0"), ticks=1)
    told.origin = origin
    told.place([0.004, 0.002, 0.001, 0.0])
    told.aside(0.005)
    recording = told.recording()
    figures = summary(recording, name="story", mode="lockstep", outcome="completed", cause=None)
    output = io.StringIO()
    shown = LiveView(told.config, SimulatedClock(), Terminal(), quiet=True).picture(recording, "running")
    Console(file=output, width=100, color_system=None).print(shown)
    for k, robot in enumerate(told.config.groups[0].robots):
        _, _, path, timed = row(output.getvalue(), robot).split()[:4]
        assert float(path) == pytest.approx(figures["path_error_mm"]["per_robot_mean"][k], abs=0.051)
        assert float(timed) == pytest.approx(figures["timed_error_mm"]["per_robot_mean"][k], abs=0.051)
