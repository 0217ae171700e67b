"""What the live view shows an operator, and what it offers."""

import io
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from rich.console import Console

from robofleet.bus.keys import BUSY, STATE, STATUS, TICK, key
from robofleet.bus.messages import (
    BUSY_MACHINE,
    RUN_STATE,
    TICK_RECORD,
    BusyMachine,
    Late,
    RobotState,
    RobotTick,
    RunState,
    TickRecord,
)
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import MS, SimulatedClock
from robofleet.core.starting import Starting
from robofleet.operator.terminal.live import LiveView
from robofleet.operator.terminal.on_the_way import OnTheWay
from robofleet.operator.terminal.start_view import StartLines
from robofleet.operator.terminal.terminal import Terminal
from robofleet.recording.run import Recording
from robofleet.safety.arming import Stage
from robofleet.safety.busy import TRACKER
from robofleet.safety.latches import GateStatus, Latch
from robofleet.safety.supervisor import NOBODY, Event, Phase
from tests.bus.alone import ROBOT_STATUS, RobotStatus
from tests.operator.page.webstand import told_numbers

STANDING = RobotTick(*(0.0,) * len(RobotTick._fields))
TWO = Path(__file__).with_name("two_groups.yaml")
WELL = RobotState(1, 1, 0)
FOUR = (WELL,) * 4


class Attended(Terminal):
    """A terminal that is there."""

    present = True


class Stand:
    """The view of a fleet of four of which it was said what a test says."""

    def __init__(self, config: Config) -> None:
        self.terminal = Terminal()
        self.recording, self._config = Recording(config), config
        self.arena = config.arena.name
        self.tick()
        for robot in config.members:
            self.gate(robot.id, GateStatus.OPEN, Latch.NONE)

    def tick(self, *robots: RobotTick, run_tick: int = -1, figures: dict[str, Sequence[float]] | None = None) -> None:
        """Say a tick; ``figures``: by their names, a value a robot of all groups."""
        numbers = told_numbers(self.recording.groups, figures or {})
        items = robots or (STANDING,) * len(self._config.members)
        head = 1, 1, 9, run_tick, 1, *[0] * 6, Phase.RUNNING, *[0] * 4
        self.recording.add(key(self.arena, TICK), TICK_RECORD.encode(TickRecord(*head, items, numbers)))

    def gate(self, robot: str, gate: int, latch: int) -> None:
        status = RobotStatus(1, 1, 1, 1, 1, 1, 1, 0, 0, 0, gate, latch, 1, 0, 0, -1, -1, *(0.0,) * 8, 1.0)
        self.recording.add(key(self.arena, STATUS, robot), ROBOT_STATUS.encode(status))

    def state(
        self, phase: int, cause: int = Event.NOTHING, robot: int = NOBODY, stage: int = 0,
        robots: tuple[RobotState, ...] = FOUR,
    ) -> None:  # fmt: skip
        message = RunState(1, 1, phase, cause, robot, 0.0, stage, robots)
        self.recording.add(key(self.arena, STATE), RUN_STATE.encode(message))

    def shown(self, phase: str, width: int = 100) -> str:
        """Return what a terminal of so many columns shows."""
        view = LiveView(self._config, SimulatedClock(), self.terminal, quiet=True)
        view(self.recording, phase)
        output = io.StringIO()
        Console(file=output, width=width, color_system=None).print(view.picture(self.recording, phase))
        return output.getvalue()


@pytest.fixture
def view(platoon_of: Callable[..., Config]) -> Stand:
    return Stand(platoon_of())


def row(text: str, robot: str) -> str:
    (found,) = [line for line in text.splitlines() if line.startswith(robot)]
    return found


def test_until_wheels_drive_a_bar_says_how_far_the_start_is_and_what_has_not_begun_is_no_alarm(view: Stand) -> None:
    view.recording.messages.pop(key(view.arena, STATUS, "r1"))
    assert "silent" in row(view.shown("running"), "r1")
    view.terminal.starting = Starting(0.32, 23.6, "compiling kernels, 31 of 61")
    shown = view.shown("starting")
    assert shown.startswith("starting 32 %, about 24 s left   \u2501")
    assert "\ncompiling kernels, 31 of 61" in shown
    assert "starting" in row(shown, "r1")
    assert "silent" not in shown


def test_lines_say_how_far_a_start_is_where_it_is_not_drawn(capsys: pytest.CaptureFixture[str]) -> None:
    lines, quiet = StartLines(), StartLines(long_ones=True)
    for left_s, phase in ((24.0, "starting"), (23.0, "starting"), (4.0, "arming")):
        for say in (lines, quiet):
            say(Starting(0.3, left_s, "compiling kernels, 31 of 61"), phase)
    output = capsys.readouterr().err.splitlines()
    assert [line.split(":")[0] for line in output] == [
        f"starting 30 %, about {left_s} s left" for left_s in (24, 24, 4)
    ]


def test_while_arming_it_says_what_is_tried(view: Stand) -> None:
    view.state(Phase.ARMED, stage=Stage.CHECKS)
    assert "does every robot answer, is it seen, and is it at rest?" in view.shown("arming")
    view.state(Phase.ARMED, stage=Stage.WIGGLE)
    assert "trying the wheels" in view.shown("arming")
    tried = WELL._replace(stroke=2)
    view.state(Phase.ARMED, stage=Stage.WIGGLE, robots=(WELL, tried, WELL, tried))
    assert "trying the wheels of r2, r4" in view.shown("arming")
    view.state(Phase.ARMED, stage=Stage.WIGGLE, robots=(tried,) * 4)
    assert "trying the wheels of r1, r2, r3 and 1 more" in view.shown("arming")


def test_a_hold_is_seen_with_its_cause_and_what_to_do(view: Stand) -> None:
    view.state(Phase.HOLD, Event.POSE_JUMPED, 1)
    shown = view.shown("held")
    assert "HOLD" in shown
    assert "r2: it was moved by hand" in shown
    assert "`robofleet resume` goes on" in shown
    assert "0.0 s of 88 s run time" in shown
    view.terminal = Attended()
    assert "press r and the run goes on" in view.shown("held")


def test_whom_a_person_drives_out_is_seen_in_the_banner_and_in_its_row(view: Stand) -> None:
    out = WELL._replace(cause=Event.DRIVEN_OUT_BY_PAGE)
    stands = RobotState(0, 0, 0)
    view.state(Phase.HOLD, Event.DEADLOCKED, 1, robots=(stands, stands, out, stands))
    shown = view.shown("held")
    assert "r3 is driven out at a crawl, all others stand." in shown
    assert "a person" in row(shown, "r3")


def test_an_emergency_stop_names_who_has_not_answered(view: Stand) -> None:
    view.state(Phase.ESTOP, Event.WIRED_STOP, 0)
    assert "Every robot has latched its gate." in view.shown("emergency stop")
    view.state(Phase.ESTOP, Event.WIRED_STOP, 0, robots=(WELL, WELL, RobotState(0, 0, 0), WELL))
    shown = view.shown("emergency stop")
    assert "r1: the robot's own e-stop" in shown
    assert "NOT acknowledged by r3" in shown


def test_a_robots_row_says_why_it_may_not_move(view: Stand) -> None:
    view.gate("r1", GateStatus.LATCHED, Latch.WIRED_STOP)
    view.gate("r2", GateStatus.NO_ENABLE, Latch.NONE)
    view.gate("r3", GateStatus.NO_ENABLE, Latch.NONE)
    view.state(Phase.RUNNING, robots=(WELL, RobotState(0, 0, Event.TAG_LATE), WELL, WELL))
    shown = view.shown("running", 120)
    assert row(shown, "r1").rstrip().endswith("wired stop")
    assert "it is not seen" in row(shown, "r2")
    assert "stands" in row(shown, "r3")
    assert "drives" in row(shown, "r4")


def test_keys_are_offered_where_somebody_can_press_them(view: Stand) -> None:
    view.state(Phase.RUNNING)
    assert "emergency stop" not in view.shown("running")
    view.terminal = Attended()
    view.terminal.note = "refused: r2's tag is not seen"
    shown = view.shown("running")
    assert " e  emergency stop    h  hold    r  resume    q  end the run" in shown
    assert "refused: r2's tag is not seen" in shown


def test_the_keys_come_before_what_a_low_terminal_cuts_off(view: Stand) -> None:
    view.terminal = Attended()
    lines = view.shown("running").splitlines()
    keys = next(i for i, line in enumerate(lines) if "emergency stop" in line)
    assert keys <= 2
    assert all(i > keys for i, line in enumerate(lines) if line.startswith("r1"))


@pytest.mark.parametrize(
    ("width", "left_out"), [(120, ""), (80, "battery, pose"), (60, "battery, pose, wheels"), (50, "estimated spacing")]
)
def test_a_narrow_terminal_cuts_nothing_and_is_told_what_is_left_out(view: Stand, width: int, left_out: str) -> None:
    view.terminal = Attended()
    view.state(Phase.RUNNING)
    shown = view.shown("running", width)
    assert max(map(len, shown.splitlines())) <= width
    assert "\N{HORIZONTAL ELLIPSIS}" not in shown
    for robot in ("r1", "r2", "r3", "r4"):
        assert row(shown, robot).split()[-1] == "drives"
    assert ("not shown" in " ".join(shown.split())) == bool(left_out)
    assert f"{left_out}: not shown" in " ".join(shown.split()) or not left_out


def test_values_of_another_version_break_nothing(view: Stand) -> None:
    view.gate("r1", 77, 77)
    view.gate("r2", 77, 0)
    view.state(77, 777, 7777, 77, robots=(WELL, RobotState(0, 0, 777, 77)))
    for phase in ("arming", "running", "held"):
        shown = view.shown(phase)
        assert "latched:" in row(shown, "r1")
        assert "unknown (77)" in shown


def test_it_shows_what_the_behaviour_tells_and_what_every_robot_has(view: Stand) -> None:
    pose = STANDING._replace(x_m=-0.512, y_m=0.25, psi_rad=1.0, left_rad_s=3.456, right_rad_s=-2.0)
    figures = {"control_error": [0.0012, 0.0123, 0.123, 1.23], "estimated_spacing": [math.nan, 0.25, 0.251, 0.252]}
    view.tick(pose, STANDING._replace(lost=1.0), STANDING._replace(filtered=1.0), STANDING, run_tick=3, figures=figures)
    shown = view.shown("running", 120)
    assert row(shown, "r1").split() == [
        "r1",
        "-0.512",
        "0.250",
        "57",
        "3.46",
        "-2.00",
        "100",
        "1.20",
        "-",
        "-",
        "drives",
    ]
    assert row(shown, "r2").split()[:2] == ["r2", "-"], "where it is not known"
    assert row(shown, "r3").split()[7:12] == ["123.0", "-", "251.0", "kept", "apart"]
    assert row(shown, "r4").split()[-4:] == ["1230", "-", "252.0", "drives"]
    heads = " ".join(shown.split("r1 ")[0].split())
    assert "control error" in heads and "reference parameter" not in heads, "it is not live"
    view.tick(figures=figures)
    assert "1.20" not in view.shown("armed", 120), "nothing is told of a run that has not begun"


def test_each_group_has_a_table_with_its_own_figures(capsys: pytest.CaptureFixture[str]) -> None:
    view = Stand(load_config(TWO, ["drivers.robots_per_process=1"]))
    view.tick(run_tick=3, figures={"control_error": [0.001] * 5, "radius_error": [0.002] * 5, "turned": [0.5] * 5})
    above, below = view.shown("running", 120).split("inner")
    assert "platoon" in above and "control error" in above and "radius error" not in above
    assert "tests.nodes.swirl:Swirl" in below and "radius error" in below and "control error" not in below
    assert row(above, "r3").split()[-4:] == ["1.00", "-", "-", "drives"]
    assert row(below, "s2").split()[-3:] == ["2.00", "28.6", "drives"]
    LiveView(view.recording.config, SimulatedClock(), view.terminal, quiet=False)(view.recording, "running")
    line = "platoon: control error 1.00 1.00 1.00 mm; inner: radius error 2.00 2.00 mm; 0 overruns"
    assert line in capsys.readouterr().err


def test_a_behaviour_that_failed_is_seen_with_its_robots_and_what_to_do(view: Stand) -> None:
    failed = STANDING._replace(failed=float(Event.BEHAVIOUR_STANDS))
    view.tick(failed, STANDING._replace(failed=float(Event.BEHAVIOUR_RAISED)), failed, failed, run_tick=3)
    view.state(Phase.HOLD, Event.BEHAVIOUR_RAISED, 1)
    shown = " ".join(view.shown("held").replace("┃", " ").split())
    assert "r2: the behaviour of its group platoon failed with an error" in shown
    assert "mend the behaviour and start again" in shown


@pytest.mark.parametrize(("phase", "words"), [("positioning", "drives to its start"), ("parking", "it is parked")])
def test_on_the_way_it_says_where_to(view: Stand, phase: str, words: str) -> None:
    assert words in view.shown(phase, 80)


def test_on_the_way_it_says_who_is_there_how_far_the_others_are_and_what_a_hold_holds(
    platoon_of: Callable[..., Config],
) -> None:
    config = platoon_of("run.begin=go_to_start")
    view = Stand(config)
    view.terminal = Attended()
    shown = LiveView(config, SimulatedClock(), view.terminal, quiet=True)

    def text(phase: str) -> str:
        output = io.StringIO()
        Console(file=output, width=80, color_system=None).print(shown.picture(view.recording, phase))
        return output.getvalue()

    robots = []
    for away, pose in zip((0.0, 0.5, 0.0, 0.0), OnTheWay(config).places[Phase.POSITIONING], strict=True):
        assert pose is not None
        robots.append(STANDING._replace(x_m=pose[0] + away, y_m=pose[1], psi_rad=pose[2]))
    view.tick(*robots)
    view.state(Phase.POSITIONING)
    going = text("positioning")
    assert "at their start: 3 of 4 robots; r2 has 0.50 m to go, at least 3 s" in going
    assert "at its start" in row(going, "r1")
    assert "0.50 m to its start" in row(going, "r2")
    assert "control error" not in going, "no behaviour tells figures"
    view.state(Phase.HOLD, Event.HOLD_REQUESTED)
    held = text("held")
    assert "press r and the robots drive on to their start" in " ".join(held.replace("┃", " ").split()).lower()
    assert "0.50 m to its start" in row(held, "r2")
    view.state(Phase.RUNNING)
    assert "control error" in text("running").replace("\n", " ")


def test_a_busy_machine_is_seen_and_a_run_that_it_holds_goes_on_by_itself(
    view: Stand, capsys: pytest.CaptureFixture[str]
) -> None:
    message = BusyMachine(1, 1, Event.TRACKER_SILENT, 1, 0, 0, 2, 6.1, (Late(TRACKER, 310 * MS, 310 * MS),))
    notice = "this machine is busy: load 6.1 on 2 cores, the tracker was late by 310 ms"
    plain = LiveView(view.recording.config, SimulatedClock(), view.terminal, quiet=False)
    view.state(Phase.HOLD, Event.TRACKER_SILENT)
    plain(view.recording, "held")
    view.recording.add(key(view.arena, BUSY), BUSY_MACHINE.encode(message))
    plain(view.recording, "held")
    shown = " ".join(view.shown("held").replace("┃", " ").split())
    assert f"the tracker went silent, or its poses are late ({notice.replace(' is ', ' was ')})" in shown
    assert "the run goes on by itself" in shown
    view.state(Phase.RUNNING, Event.CAUGHT_UP)
    plain(view.recording, "held")  # the launcher has not seen it yet
    plain(view.recording, "running")
    assert notice in view.shown("running")
    first, *_, last, _ = lines = capsys.readouterr().err.splitlines()
    assert "`robofleet resume` goes on" in first
    assert last.startswith("held: the tracker went silent, or its poses are late (this machine was busy")
    assert last.endswith("; the run goes on by itself")
    assert lines.count(notice) == 1
