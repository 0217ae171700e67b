"""The run's state machine: one transition table, no I/O.

Wheels may move in RUNNING, before it in POSITIONING, after it in PARKING, and in ARMED those of the robots that
are being tried. HOLD keeps the run and waits for the operator, who resumes what was held; FAULT and ESTOP end it and
wait for a reset, which moves nothing.
"""

from collections.abc import Iterable
from enum import IntEnum
from typing import NamedTuple, Self

NOBODY = 0xFFFF


class Phase(IntEnum):
    """State of a run."""

    IDLE = 0
    ARMED = 1  # the checks before a start; passed, they wait for it
    RUNNING = 2
    FAULT = 3
    HOLD = 4
    ESTOP = 5
    POSITIONING = 6  # the robots drive to where their behaviours begin
    PARKING = 7  # after a run, to where they are parked


MOVING = Phase.RUNNING, Phase.POSITIONING, Phase.PARKING  # every robot that nothing is wrong with may move


class Event(IntEnum):
    """What can happen to a run; also the recorded cause of a state. A comment says what the ``detail`` is."""

    NOTHING = 0
    # the operator
    START_REQUESTED = 1
    PROVED = 2  # every check was passed, and the start is asked for
    STOP_REQUESTED = 3
    HOLD_REQUESTED = 4
    RESUME_REQUESTED = 5
    ESTOP_REQUESTED = 6
    RESET = 7  # requested, and every robot at rest, every e-stop acknowledged, no input that still asks for one
    OPERATOR_LOST = 8  # the dead man's terminal is gone
    ARM_REQUESTED = 70  # the checks, and then to wait for the start
    PARK_REQUESTED = 77
    CAUGHT_UP = 71  # nobody asked: all is simulated, and whom a busy machine had delayed is there again (busy.py)
    # the way to the start, and to the park
    SET_OUT = 78  # every check was passed, and the robots are to go to their start first
    AT_START = 79
    PARKED = 80
    ACCOMPLISHED = 81  # the behaviours have done all that they were to do
    UNDER_WAY_TOO_LONG = 82
    OFF_TO_PARK = 83  # the behaviours have done all, and the robots are to be parked
    # the processes
    SUPERVISOR_STALLED = 9  # the supervisor itself stood still, or its clock jumped
    DRIVER_SILENT = 10
    DRIVER_RESTARTED = 11
    LINK_LOST = 84  # of a robot with a computer of its own: its radio is away, or its computer starts again
    CONTROLLER_SILENT = 12
    CONTROLLER_RESTARTED = 13
    TICKS_OVERRUN = 14  # ticks in a row
    TRACKER_SILENT = 15
    TRACKER_RESTARTED = 16
    OTHER_BUILD = 17  # another version or another configuration
    LEASE_LOST = 18  # a robot answers to another controller, or to none
    DISK_FULL = 19
    # the camera
    CAMERA_STALLED = 20
    CAMERA_FROZEN = 21
    CAMERA_LOST = 22
    CAMERA_MOVED = 23
    CAMERA_OUT = 24  # of several: detail is its number
    POSES_SILENT = 25  # of a source that is no camera, as a motion capture
    # a robot
    WIRED_STOP = 30
    GATE_LATCHED = 31  # safety.latches.Latch
    ROBOT_FAULT = 32  # bits that only its own driver knows
    BATTERY_LOW = 33  # charge
    TAG_LATE = 34  # not seen for 100 ms: this robot stands still
    TAG_LOST = 35  # not seen for 2 s
    TAG_TWICE = 36
    POSE_JUMPED = 37  # distance [m]
    OUTSIDE_ARENA = 38
    TOO_CLOSE = 39  # to another robot: its index
    FILTER_INFEASIBLE = 40
    DEADLOCKED = 41
    BUMPED = 42  # this and the next: vehicles.interface.RobotFault, by the same names
    CLIFF = 43
    WHEEL_DROPPED = 44
    OVERCURRENT = 45
    CHARGING = 46
    UNREACHABLE = 47
    RUNAWAY = 48  # a wheel turns that is told to stand
    STOPPED_AT_GATE = 49  # an emergency stop that the supervisor had not heard of
    WHEEL_STALLED = 93  # a wheel stands, or turns much slower than it is commanded
    # a bystander: a robot that this run does not drive
    BYSTANDER_LOST = 65  # not seen for 2 s: nobody knows where an obstacle is
    BYSTANDER_MOVED = 66  # carried somewhere else: distance [m]
    # the checks before a start
    NOT_AT_REST = 50
    ESTOP_UNANSWERED = 51
    DID_NOT_MOVE = 52
    WRONG_TAG_MOVED = 53  # index of the robot whose tag moved
    WHEELS_SWAPPED = 54
    LEFT_REVERSED = 55
    RIGHT_REVERSED = 56
    BOTH_REVERSED = 57
    MOVED_UNASKED = 67  # while others were tried
    WRONG_GAIN = 58  # travelled over expected
    ENCODER_WRONG = 59  # counted over asked
    WRONG_ORDER = 63  # it stands ahead of the robot with this index, which it is to follow
    WAYS_CROSS = 64  # with the way of the robot with this index
    # a group's behaviour; told of one of its robots
    BEHAVIOUR_RAISED = 72
    BEHAVIOUR_NOT_FINITE = 73
    BEHAVIOUR_SHAPE = 74
    BEHAVIOUR_LATE = 75
    BEHAVIOUR_NO_WAY = 92  # it comes to no goal past what stands in its way
    BEHAVIOUR_STANDS = 76  # with the robot of its group of which one of the events above is told
    # a script that drives a group; told of one of its robots
    SCRIPT_SILENT = 85
    SCRIPT_FAILED = 86
    # a robot that a person drives out of a held run (rescue.py): told of it alone, it changes nothing of the run
    DRIVEN_OUT_BY_PAGE = 87
    DRIVEN_OUT_BY_GAMEPAD = 88
    # patience
    ARMED_TOO_LONG = 60
    HELD_TOO_LONG = 61
    NOT_STARTED = 62


DRIVEN_OUT = Event.DRIVEN_OUT_BY_PAGE, Event.DRIVEN_OUT_BY_GAMEPAD

CAUSES = {
    Event.NOTHING: "nothing",
    Event.ARM_REQUESTED: "arming requested",
    Event.START_REQUESTED: "start requested",
    Event.PROVED: "every check passed",
    Event.STOP_REQUESTED: "stop requested",
    Event.HOLD_REQUESTED: "hold requested",
    Event.RESUME_REQUESTED: "resume requested",
    Event.ESTOP_REQUESTED: "emergency stop requested",
    Event.RESET: "reset",
    Event.PARK_REQUESTED: "parking requested",
    Event.SET_OUT: "every check passed: the robots go to their start",
    Event.AT_START: "every robot is at its start",
    Event.PARKED: "every robot is parked",
    Event.ACCOMPLISHED: "the behaviours have done what they were to do",
    Event.OFF_TO_PARK: "the behaviours have done what they were to do: the robots go to the park",
    Event.UNDER_WAY_TOO_LONG: "the robots did not get to where they were to go in time",
    Event.CAUGHT_UP: "the busy machine has caught up",
    Event.OPERATOR_LOST: "the operator's terminal is gone",
    Event.SUPERVISOR_STALLED: "the supervisor stalled",
    Event.DRIVER_SILENT: "the driver went silent",
    Event.DRIVER_RESTARTED: "the driver was restarted",
    Event.LINK_LOST: "its computer cannot be reached over the network, or has started again",
    Event.CONTROLLER_SILENT: "the controller went silent",
    Event.CONTROLLER_RESTARTED: "the controller was restarted",
    Event.TICKS_OVERRUN: "the controller overran {detail:.0f} ticks in a row",
    Event.TRACKER_SILENT: "the tracker went silent, or its poses are late",
    Event.TRACKER_RESTARTED: "the tracker was restarted",
    Event.OTHER_BUILD: "another version of robofleet or of the configuration runs here",
    Event.LEASE_LOST: "the driver does not answer to this run's controller",
    Event.DISK_FULL: "the disk is full",
    Event.CAMERA_STALLED: "the camera stalled",
    Event.CAMERA_FROZEN: "the camera froze",
    Event.CAMERA_LOST: "the camera is gone, or is another one",
    Event.CAMERA_MOVED: "the camera moved: calibrate its place again",
    Event.CAMERA_OUT: "only {camera} could see it, and that gives no poses",
    Event.POSES_SILENT: "the source of the poses went silent",
    Event.WIRED_STOP: "the robot's own e-stop",
    Event.GATE_LATCHED: "its gate is latched: look at the robot, then reset",
    Event.STOPPED_AT_GATE: "an emergency stop closed its gate without the supervisor: look at the robots, then reset",
    Event.ROBOT_FAULT: "the robot reports a fault ({detail:.0f})",
    Event.BUMPED: "a bumper is hit",
    Event.CLIFF: "there is no floor ahead of it",
    Event.WHEEL_DROPPED: "a wheel is off the floor",
    Event.OVERCURRENT: "a motor draws too much current: a wheel is blocked",
    Event.CHARGING: "it is at its charger",
    Event.UNREACHABLE: "its driver has lost the connection to it (unplugged?)",
    Event.RUNAWAY: "a wheel turns by itself",
    Event.WHEEL_STALLED: "a wheel does not turn as it is commanded",
    Event.BATTERY_LOW: "the battery is low ({percent:.0f} %)",
    Event.TAG_LATE: "it is not seen",
    Event.TAG_LOST: "the tracker lost the robot",
    Event.TAG_TWICE: "its tag is seen twice",
    Event.POSE_JUMPED: "it was moved by hand",
    Event.OUTSIDE_ARENA: "it left the arena",
    Event.TOO_CLOSE: "it is too close to {other}",
    Event.FILTER_INFEASIBLE: "no motion is safe for it",
    Event.DEADLOCKED: "it and other robots block each other",
    Event.BYSTANDER_LOST: "it is a bystander, and the tracker no longer sees it",
    Event.BYSTANDER_MOVED: "it is a bystander, and somebody moved it",
    Event.NOT_AT_REST: "it is not at rest",
    Event.ESTOP_UNANSWERED: "its driver did not answer the test of the emergency stop",
    Event.DID_NOT_MOVE: "its tag did not move when its wheels were turned",
    Event.WRONG_TAG_MOVED: "its driver moves the tag of {other}",
    Event.MOVED_UNASKED: "its tag moved while others were tried, and it was told to stand",
    Event.WHEELS_SWAPPED: "its wheels are swapped",
    Event.ENCODER_WRONG: "an encoder counts {detail:.2f} of its wheel's commanded travel",
    Event.LEFT_REVERSED: "its left wheel turns backwards",
    Event.RIGHT_REVERSED: "its right wheel turns backwards",
    Event.BOTH_REVERSED: "both its wheels turn backwards",
    Event.WRONG_ORDER: "it stands ahead of {other}, which it is to follow",
    Event.WAYS_CROSS: "it and {other} are in each other's way to their places on the path",
    Event.WRONG_GAIN: "it travels {detail:.2f} of the distance that its wheels should give: check wheel_radius_m",
    Event.BEHAVIOUR_RAISED: "{group} failed with an error: its traceback is in the controller's log",
    Event.BEHAVIOUR_NOT_FINITE: "{group} returned a velocity that is not finite",
    Event.BEHAVIOUR_SHAPE: "{group} returned velocities of a wrong shape",
    Event.BEHAVIOUR_LATE: "{group} took longer than its share of a tick",
    Event.BEHAVIOUR_NO_WAY: "{group} finds no way to its goals past what stands there",
    Event.BEHAVIOUR_STANDS: "{group} failed, and all its robots stand",
    Event.SCRIPT_SILENT: "{group} no longer hears from its script: it has ended, hangs, or was stopped",
    Event.SCRIPT_FAILED: "{group} has lost its script: it ended by an error",
    Event.DRIVEN_OUT_BY_PAGE: "a person drives it out at a crawl, from the operator's page",
    Event.DRIVEN_OUT_BY_GAMEPAD: "a person drives it out at a crawl, by `robofleet teleop`",
    Event.ARMED_TOO_LONG: "the fleet was not ready in time",
    Event.HELD_TOO_LONG: "nobody resumed",
    Event.NOT_STARTED: "nobody started the fleet in time, and its checks are too old",
}

_SAME = None
_I, _A, _R, _H, _F, _E = Phase.IDLE, Phase.ARMED, Phase.RUNNING, Phase.HOLD, Phase.FAULT, Phase.ESTOP
_G, _P = Phase.POSITIONING, Phase.PARKING

# Where each event leads from each phase; the column's own letter or a dash means that nothing changes.
_COLUMNS = (_I, _A, _R, _H, _F, _E)
_TABLE: dict[Event, tuple[Phase | None, ...]] = {
    #                            IDLE   ARMED  RUNNING HOLD  FAULT  ESTOP
    Event.ARM_REQUESTED:        (_A,    _SAME, _SAME, _SAME, _SAME, _SAME),
    Event.START_REQUESTED:      (_A,    _SAME, _SAME, _SAME, _SAME, _SAME),
    Event.PROVED:               (_SAME, _R,    _SAME, _SAME, _SAME, _SAME),
    Event.SET_OUT:              (_SAME, _G,    _SAME, _SAME, _SAME, _SAME),
    Event.ACCOMPLISHED:         (_SAME, _SAME, _I,    _SAME, _SAME, _SAME),
    Event.OFF_TO_PARK:          (_SAME, _SAME, _P,    _SAME, _SAME, _SAME),
    Event.PARK_REQUESTED:       (_SAME, _SAME, _P,    _P,    _SAME, _SAME),
    Event.UNDER_WAY_TOO_LONG:   (_SAME, _SAME, _H,    _SAME, _SAME, _SAME),
    Event.STOP_REQUESTED:       (_SAME, _I,    _I,    _I,    _SAME, _SAME),
    Event.HOLD_REQUESTED:       (_SAME, _SAME, _H,    _SAME, _SAME, _SAME),
    Event.RESUME_REQUESTED:     (_SAME, _SAME, _SAME, _R,    _SAME, _SAME),
    Event.CAUGHT_UP:            (_SAME, _SAME, _SAME, _R,    _SAME, _SAME),
    Event.ESTOP_REQUESTED:      (_E,    _E,    _E,    _E,    _E,    _SAME),
    Event.RESET:                (_SAME, _SAME, _SAME, _SAME, _I,    _I),
    Event.OPERATOR_LOST:        (_SAME, _E,    _E,    _E,    _SAME, _SAME),
    Event.SUPERVISOR_STALLED:   (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.DRIVER_SILENT:        (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.DRIVER_RESTARTED:     (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.LINK_LOST:            (_SAME, _F,    _H,    _SAME, _SAME, _SAME),
    Event.CONTROLLER_SILENT:    (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.CONTROLLER_RESTARTED: (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.TICKS_OVERRUN:        (_SAME, _SAME, _H,    _SAME, _SAME, _SAME),
    Event.TRACKER_SILENT:       (_SAME, _F,    _H,    _SAME, _SAME, _SAME),
    Event.TRACKER_RESTARTED:    (_SAME, _F,    _H,    _SAME, _SAME, _SAME),
    Event.OTHER_BUILD:          (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.LEASE_LOST:           (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.DISK_FULL:            (_SAME, _F,    _H,    _SAME, _SAME, _SAME),
    Event.CAMERA_STALLED:       (_SAME, _F,    _H,    _SAME, _SAME, _SAME),
    Event.CAMERA_FROZEN:        (_SAME, _F,    _H,    _SAME, _SAME, _SAME),
    Event.CAMERA_LOST:          (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.CAMERA_MOVED:         (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.CAMERA_OUT:           (_SAME, _F,    _SAME, _SAME, _SAME, _SAME),
    Event.POSES_SILENT:         (_SAME, _F,    _H,    _SAME, _SAME, _SAME),
    Event.WIRED_STOP:           (_E,    _E,    _E,    _E,    _E,    _SAME),
    Event.GATE_LATCHED:         (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.STOPPED_AT_GATE:      (_SAME, _E,    _E,    _E,    _E,    _SAME),
    Event.ROBOT_FAULT:          (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.BUMPED:               (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.CLIFF:                (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.WHEEL_DROPPED:        (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.OVERCURRENT:          (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.CHARGING:             (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.UNREACHABLE:          (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.RUNAWAY:              (_E,    _E,    _E,    _E,    _E,    _SAME),
    Event.BATTERY_LOW:          (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.TAG_LATE:             (_SAME, _SAME, _SAME, _SAME, _SAME, _SAME),
    Event.TAG_LOST:             (_SAME, _F,    _F,    _SAME, _SAME, _SAME),
    Event.TAG_TWICE:            (_SAME, _F,    _H,    _SAME, _SAME, _SAME),
    Event.POSE_JUMPED:          (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.OUTSIDE_ARENA:        (_SAME, _F,    _F,    _F,    _SAME, _SAME),
    Event.TOO_CLOSE:            (_SAME, _F,    _H,    _SAME, _SAME, _SAME),
    Event.FILTER_INFEASIBLE:    (_SAME, _SAME, _H,    _SAME, _SAME, _SAME),
    Event.WHEEL_STALLED:        (_SAME, _SAME, _H,    _SAME, _SAME, _SAME),
    Event.DEADLOCKED:           (_SAME, _SAME, _H,    _SAME, _SAME, _SAME),
    Event.BYSTANDER_LOST:       (_SAME, _F,    _H,    _SAME, _SAME, _SAME),
    Event.BYSTANDER_MOVED:      (_SAME, _F,    _H,    _SAME, _SAME, _SAME),
    Event.NOT_AT_REST:          (_SAME, _F,    _SAME, _SAME, _SAME, _SAME),
    Event.ESTOP_UNANSWERED:     (_SAME, _F,    _SAME, _SAME, _SAME, _SAME),
    Event.DID_NOT_MOVE:         (_SAME, _F,    _SAME, _SAME, _SAME, _SAME),
    Event.WRONG_TAG_MOVED:      (_SAME, _F,    _SAME, _SAME, _SAME, _SAME),
    Event.MOVED_UNASKED:        (_SAME, _F,    _SAME, _SAME, _SAME, _SAME),
    Event.WHEELS_SWAPPED:       (_SAME, _F,    _SAME, _SAME, _SAME, _SAME),
    Event.ENCODER_WRONG:        (_SAME, _F,    _SAME, _SAME, _SAME, _SAME),
    Event.LEFT_REVERSED:        (_SAME, _F,    _SAME, _SAME, _SAME, _SAME),
    Event.RIGHT_REVERSED:       (_SAME, _F,    _SAME, _SAME, _SAME, _SAME),
    Event.BOTH_REVERSED:        (_SAME, _F,    _SAME, _SAME, _SAME, _SAME),
    Event.WRONG_GAIN:           (_SAME, _F,    _SAME, _SAME, _SAME, _SAME),
    Event.WRONG_ORDER:          (_SAME, _F,    _SAME, _SAME, _SAME, _SAME),
    Event.WAYS_CROSS:           (_SAME, _F,    _SAME, _SAME, _SAME, _SAME),
    Event.BEHAVIOUR_RAISED:     (_SAME, _SAME, _H,    _SAME, _SAME, _SAME),
    Event.BEHAVIOUR_NOT_FINITE: (_SAME, _SAME, _H,    _SAME, _SAME, _SAME),
    Event.BEHAVIOUR_SHAPE:      (_SAME, _SAME, _H,    _SAME, _SAME, _SAME),
    Event.BEHAVIOUR_LATE:       (_SAME, _SAME, _H,    _SAME, _SAME, _SAME),
    Event.BEHAVIOUR_NO_WAY:     (_SAME, _SAME, _H,    _SAME, _SAME, _SAME),
    Event.BEHAVIOUR_STANDS:     (_SAME, _SAME, _SAME, _SAME, _SAME, _SAME),
    Event.SCRIPT_SILENT:        (_SAME, _SAME, _H,    _SAME, _SAME, _SAME),
    Event.SCRIPT_FAILED:        (_SAME, _SAME, _H,    _SAME, _SAME, _SAME),
    Event.DRIVEN_OUT_BY_PAGE:   (_SAME, _SAME, _SAME, _SAME, _SAME, _SAME),
    Event.DRIVEN_OUT_BY_GAMEPAD: (_SAME, _SAME, _SAME, _SAME, _SAME, _SAME),
    Event.ARMED_TOO_LONG:       (_SAME, _F,    _SAME, _SAME, _SAME, _SAME),
    Event.HELD_TOO_LONG:        (_SAME, _SAME, _SAME, _F,    _SAME, _SAME),
    Event.NOT_STARTED:          (_SAME, _I,    _SAME, _SAME, _SAME, _SAME),
}  # fmt: skip

TRANSITIONS: dict[tuple[Phase, Event], Phase] = {
    (phase, event): to
    for event, row in _TABLE.items()
    for phase, to in zip(_COLUMNS, row, strict=True)
    if to is not None
}
# On the way to the start and to the park an event leads where it leads from RUNNING, but for these.
TRANSITIONS |= {(phase, event): to for phase in (_G, _P) for (before, event), to in TRANSITIONS.items() if before is _R}
TRANSITIONS |= {(_G, Event.AT_START): _R, (_P, Event.PARKED): _I}
_IMPOSSIBLE = (
    (_G, Event.ACCOMPLISHED), (_G, Event.OFF_TO_PARK),
    (_P, Event.ACCOMPLISHED), (_P, Event.OFF_TO_PARK), (_P, Event.PARK_REQUESTED),
)  # fmt: skip
for _cell in _IMPOSSIBLE:
    del TRANSITIONS[_cell]


class Roster(tuple[str, ...]):
    """Ids of the robots in the order of their numbers, of which group each one is, and the names of the cameras."""

    _groups: tuple[str, ...]
    cameras: tuple[str, ...]

    def __new__(cls, robots: Iterable[str], groups: Iterable[str], cameras: Iterable[str] = ()) -> Self:
        """Keep them; ``groups``: of each robot, empty for one in no group."""
        made = super().__new__(cls, robots)
        made._groups, made.cameras = tuple(groups), tuple(cameras)
        return made

    def group_of(self, robot: int) -> str:
        """Return the name of a robot's group."""
        return self._groups[robot]


class Happening(NamedTuple):
    """An event, the robot that it is about (its number: the group's first, then bystanders), and its own figure."""

    event: Event
    robot: int = NOBODY
    detail: float = 0.0


_PHASES = frozenset(Phase)


class RunStatus(NamedTuple):
    """Where the run is, and what led there."""

    phase: Phase = Phase.IDLE
    cause: Event = Event.NOTHING
    robot: int = NOBODY
    detail: float = 0.0
    held: Phase = Phase.RUNNING  # what was held, and goes on when the run is resumed

    @classmethod
    def read(cls, phase: int, cause: int, robot: int, detail: float) -> "RunStatus | None":
        """Return what a message says; None where its phase or its cause is not known here."""
        if phase not in _PHASES or cause not in CAUSES:
            return None
        return cls(Phase(phase), Event(cause), robot, detail)

    def describe(self, robots: tuple[str, ...]) -> str:
        """Return the cause in words; ``robots`` are the ids in the order of their numbers."""
        return describe(Happening(self.cause, self.robot, self.detail), robots)


def describe(happening: Happening, robots: tuple[str, ...]) -> str:
    """Return an event in words; ``robots`` are the ids in the order of their numbers."""
    event, robot, detail = happening
    other = robots[int(detail)] if 0 <= detail < len(robots) else "the wall or to an obstacle"
    group = "the behaviour of its group"
    if isinstance(robots, Roster) and robot < len(robots):
        group += f" {robots.group_of(robot)}"
    cameras = robots.cameras if isinstance(robots, Roster) else ()
    camera = f"the camera {cameras[int(detail)]}" if 0 <= detail < len(cameras) else "a camera"
    cause = CAUSES[event].format(detail=detail, percent=100 * detail, other=other, group=group, camera=camera)
    return f"{robots[robot]}: {cause}" if robot < len(robots) else cause


def step(status: RunStatus, happening: Happening) -> RunStatus:
    """Return the status after an event; an event that means nothing in this phase changes nothing."""
    phase = TRANSITIONS.get((status.phase, happening.event))
    if phase is None:
        return status
    if status.phase is Phase.HOLD and phase is Phase.RUNNING:
        phase = status.held
    held = status.phase if phase is Phase.HOLD else phase
    return RunStatus(phase, *happening, held if held in MOVING else Phase.RUNNING)
