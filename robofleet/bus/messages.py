"""What crosses processes. Units are in the field names; ``layouts.py`` decodes."""

from enum import IntEnum
from typing import NamedTuple

from robofleet.bus.layouts import BlobLayout, Layout, ListLayout


class UnitCommand(NamedTuple):
    """Controller to unit."""

    seq: int  # above that of every command before, in a session
    session: int  # of the controller that holds the leases; its upper half is the epoch of that controller's ticks
    boot_id: int  # of the unit, echoed
    nonce: int  # of the unit, newest seen, echoed
    exposure_ns: int  # mid-exposure of the newest image behind this command [tracker's host's clock]; 0: none
    robots: tuple["WheelCommand", ...]  # in the unit's order


class WheelCommand(NamedTuple):
    """One robot's part of a unit's command."""

    epoch: int  # of the robot's lease; 0: nothing is said to this robot
    left_rad_s: float
    right_rad_s: float


class LinkState(IntEnum):
    """How a unit's link is, and so how often it should be spoken to."""

    GOOD = 0
    BAD = 1  # by cable: often, for its link was bad a short while ago; by radio: at once, for it has heard nothing new
    WAS_BAD = 2  # by radio: after each status


class UnitStatus(NamedTuple):
    """Unit to all."""

    seq: int
    build: int  # config.slices.build: equal in every process of a run
    boot_id: int  # drawn when the unit started
    nonce: int  # opaque to everybody else
    stamp_ns: int  # [unit's clock]
    hurry: int  # LinkState
    robots: tuple["RobotStatus", ...]  # in the unit's order


class RobotStatus(NamedTuple):
    """One robot's part of a unit's status."""

    epoch: int  # of the lease
    session: int  # of the controller that holds the lease; 0: nobody
    applied_exposure_ns: int  # of the newest command that reached the wheels
    applied_ns: int  # when it did [unit's clock]
    rejected: int  # messages refused so far
    gate: int  # safety.latches.GateStatus
    latch: int  # safety.latches.Latch: what holds the gate closed until it is cleared
    latch_id: int  # counts the latches of this robot; who clears one names it
    faults: int  # vehicles.interface.RobotFault: what lasts, and what was felt since the gate was latched
    target_after_ns: int  # last stop: from the issue of the newest nonce echoed to a target of zero; -1: none yet
    output_after_ns: int  # and to an output of zero
    left_angle_rad: float
    right_angle_rad: float
    left_rad_s: float  # as measured
    right_rad_s: float
    left_output_rad_s: float  # what the gate lets through
    right_output_rad_s: float
    left_told_rad: float  # the output added up over time since the driver started
    right_told_rad: float
    battery: float  # charge [0..1]; -1 where unknown


class UnitEnable(NamedTuple):
    """Supervisor to unit: permission to move; to latch, also from whoever asks for the emergency stop."""

    seq: int
    boot_id: int  # of the unit, echoed
    nonce: int  # of the unit, newest seen, echoed
    phase: int  # safety.supervisor.Phase
    robots: tuple["Enable", ...]  # in the unit's order


class Enable(NamedTuple):
    """One robot's part of a unit's permission."""

    epoch: int  # of the robot's lease, echoed
    latch: int  # safety.latches.Latch that the gate must close by, until it is cleared; 0: none
    clear: int  # latch_id that may be cleared, if the robot is at rest; 0: none
    limit_rad_s: float  # the fastest wheel that is permitted; 0: the wheels must stand


class RobotState(NamedTuple):
    """One robot's part of a run's state."""

    permitted: int  # 1: its wheels may move
    acknowledged: int  # 1: it has answered the e-stop by closing its gate
    cause: int  # safety.supervisor.Event for which it alone stands still; 0: none
    stroke: int = 0  # index in safety.wiggle.STROKES of what it must do while its wheels are tried; 0: stand


class RunState(NamedTuple):
    """Supervisor to all."""

    epoch: int  # drawn when the supervisor started
    seq: int
    phase: int  # safety.supervisor.Phase
    cause: int  # safety.supervisor.Event that led there
    robot: int  # index of the robot concerned in the group's order; safety.supervisor.NOBODY where it is not about one
    detail: float  # the cause's own figure, as its description says
    stage: int  # safety.arming.Stage, while ARMED
    robots: tuple[RobotState, ...]  # in the group's order

    def repeats(self, before: "RunState") -> bool:
        """Return whether nothing but ``epoch`` and ``seq`` differs from a state that was published before."""
        return self == before._replace(epoch=self.epoch, seq=self.seq)


class Late(NamedTuple):
    """A process that was late by its machine's load."""

    process: int  # row in safety.busy: supervisor, controller, tracker, then the robots' drivers in their order
    most_ns: int  # so far
    late_ns: int  # when the cause came; 0: it was in time then


class BusyMachine(NamedTuple):
    """Supervisor to all, once a second since somebody was late by the machine's load, and at every stop by it."""

    epoch: int  # of the supervisor's RunState
    seq: int
    cause: int  # safety.supervisor.Event that load explains, while the run stands for it; 0: it does not
    goes_on: int  # 1: the run is held by nothing but load, and goes on by itself
    resumed: int  # how often it did so far
    attempts: int  # how often the checks before the start began anew
    cores: int
    load: float  # processes that ran or were ready to, mean of a minute
    late: tuple[Late, ...]  # everybody who was late so far


class UnitTruth(NamedTuple):
    """A unit's simulated robots as they really are, for the simulated camera and for the summary."""

    seq: int
    stamp_ns: int  # [unit's clock]
    robots: tuple["Truth", ...]  # those of the unit that are simulated by whoever says this


class Truth(NamedTuple):
    """One simulated robot's true state."""

    place: int  # in the unit's order
    x_m: float  # [world]
    y_m: float
    psi_rad: float
    v_m_s: float  # [body]
    omega_rad_s: float


class UnitSensors(NamedTuple):
    """Unit to all: what its robots' sensors measure, beside their wheels. ``comms.sensors`` reads it."""

    seq: int
    stamp_ns: int  # [unit's clock]
    robots: tuple["RobotSensors", ...]  # those of the unit whose sensors are read
    numbers: tuple[float, ...]  # of each robot those that it has: gyro x, y, z [rad/s], accelerometer x, y, z [m/s^2],
    # magnetometer x, y, z [T], heading [rad], distances [m; NaN: nothing seen]; axes of the robot frame


class RobotSensors(NamedTuple):
    """Which of a message's numbers are one robot's."""

    place: int  # in the unit's order
    parts: int  # vehicles.sensors.GYRO, ACCELEROMETER, MAGNETOMETER, HEADING, added up
    distances: int  # how many


class TagPose(NamedTuple):
    """One robot in an image: planar pose of its centre in the world frame.

    A robot that was not seen is predicted from its motion for a while: ``coasted_ns`` is then the age of what was
    measured, and the pose is no measurement.

    Attributes:
        tag: The robot's tag.
        after_ns: This robot's own mid-exposure, minus the image's [ns] (rolling shutter).
        coasted_ns: Age of what was measured [ns]. 0: measured in this image.
        x_m: Position along x [m; world].
        y_m: Position along y [m; world].
        psi_rad: Heading [rad; world, CCW +].
        xx_m2: Variance of x. All six numbers of the covariance are 0 where nobody knows it.
        xy_m2: Covariance of x and y.
        yy_m2: Variance of y.
        xpsi_m_rad: Covariance of x and psi.
        ypsi_m_rad: Covariance of y and psi.
        psipsi_rad2: Variance of psi.
    """

    tag: int
    after_ns: int
    coasted_ns: int
    x_m: float
    y_m: float
    psi_rad: float
    xx_m2: float = 0.0
    xy_m2: float = 0.0
    yy_m2: float = 0.0
    xpsi_m_rad: float = 0.0
    ypsi_m_rad: float = 0.0
    psipsi_rad2: float = 0.0


class FleetPoses(NamedTuple):
    """Tracker to controller: everything seen in one image."""

    epoch: int  # drawn when the tracker started
    seq: int
    build: int  # config.slices.build
    exposure_ns: int  # mid-exposure [tracker's clock]
    sent_ns: int  # [tracker's clock]
    echo_tick: int  # newest tick of the controller's that the tracker knows; 0: none yet
    since_tick_ns: int  # mid-exposure minus that tick's instant, as the tracker sees it
    work_ns: int  # what the tracker did for this image took so long
    refused: int  # squares refused so far: a tag twice in an image, no square on the floor's plane
    poses: tuple[TagPose, ...]


class TrackerNews(NamedTuple):
    """Tracker to all: something happened to the camera or to a tag."""

    epoch: int
    seq: int
    stamp_ns: int  # [tracker's clock]
    event: int  # tracking.events.TrackerEvent
    tag: int  # tracking.events.NO_TAG where it is not about one
    value: float  # the event's own figure, as its description says


class TickRecord(NamedTuple):
    """Controller to all: what one tick consumed, decided and measured."""

    epoch: int  # drawn when the controller started
    build: int  # config.slices.build
    tick: int  # of the grid, from 1
    run_tick: int  # of those that the fleet was running; -1 while it is not
    stamp_ns: int  # the tick's instant on the grid [controller's clock]
    poses_epoch: int  # of the newest FleetPoses taken, used or not; 0: none yet
    poses_seq: int
    exposure_ns: int  # mid-exposure of the newest one used [tracker's clock]
    state_epoch: int  # of the newest RunState taken; 0: none yet
    state_seq: int
    command_seq: (
        int  # of the newest command before this tick's: those after it, up to the next record's, are this tick's
    )
    phase: int
    arrived: int  # 1: the behaviours of this phase have done all that they were to do
    overruns: int  # so far
    lateness_ns: int  # of this tick
    compute_ns: int  # of the tick before
    robots: tuple["RobotTick", ...]
    figures: tuple[float, ...]  # of the groups, as behaviours.described reads them; NaN: not told. Then, of each camera
    # but the first, epoch and number of the newest FleetPoses taken; 0: none yet


class RobotTick(NamedTuple):
    """One robot's part of a tick."""

    x_m: float  # filter's estimate of the centre at the tick [world]
    y_m: float
    psi_rad: float
    point_x_m: float  # point p when the command acts
    point_y_m: float
    u_x_m_s: float  # velocity of the point p that is asked for, as wheels and barrier let it [world]
    u_y_m_s: float
    left_rad_s: float
    right_rad_s: float
    saturated: float  # 1: the wheels could not do all of it
    measured: float  # 1: an image was used for this robot in this tick
    lost: float  # 1: no image for too long; it stands still
    filtered: float  # 1: the barrier changed its command; 2: it found no answer, and the robot stands
    blocked: float  # 1: the barrier has held it for so long that it will not get on by itself
    failed: float  # safety.supervisor.Event by which its group's behaviour failed, and stands; 0: it did not


class Picture(NamedTuple):
    """Tracker to whoever looks: what the camera sees, now and then."""

    epoch: int  # of the tracker
    seq: int
    exposure_ns: int  # as in the FleetPoses of the same image
    width: int  # of the camera's image [px]; the JPEG may be smaller
    height: int
    jpeg: bytes


class ScriptWish(NamedTuple):
    """Script to controller: what the robots of a group are to do."""

    epoch: int  # drawn when the script began
    seq: int
    kind: int  # behaviours.interface.WishKind
    order: int  # counts a script's journeys
    echo_tick: int  # tick of the controller's by which the script wished it
    robots: tuple["RobotWish", ...]  # in the group's order


class RobotWish(NamedTuple):
    """One robot's part of a wish."""

    told: int  # 1: it is about this robot; 0: this robot stands
    first: float  # as the kind says: v [m/s]; velocity along x [m/s]; x [m]
    second: float  # omega [rad/s]; velocity along y [m/s]; y [m]
    third: float  # psi [rad] of a pose


class Note(NamedTuple):
    """Script to all who look: something for people, that moves nothing."""

    epoch: int  # of the script
    seq: int
    echo_tick: int  # newest tick that the script knew; 0: none yet
    kind: int  # NoteKind
    text: bytes  # JSON


class NoteKind(IntEnum):
    """What a note is."""

    SAY = 0  # a line: text
    MARK = 1  # a shape on the floor: an object, as behaviours.described has it; without points it is taken away
    KEEP = 2  # figures of the run: an object


class RecorderStatus(NamedTuple):
    """Recorder to all."""

    epoch: int  # drawn when the recorder started
    seq: int
    messages: int  # that it took so far
    dropped: int  # that are not in the file: they came too fast, or the disk took nothing
    failed: int  # 1: the disk takes nothing now


class LeaseRequest(NamedTuple):
    """Controller to unit, a query: let me drive these robots."""

    session: int
    action: int  # safety.gate.LeaseAction


class Handed(NamedTuple):
    """Supervisor to unit, a query: the configuration of the run that begins. The answer is text: ok, or refused."""

    build: int  # config.slices.build of the supervisor
    packed: bytes  # as ``processes.handing`` packs it


class UnitLeases(NamedTuple):
    """Unit to controller, the answer."""

    robots: tuple["LeaseAnswer", ...]  # in the unit's order


class LeaseAnswer(NamedTuple):
    """One robot's lease after a request."""

    granted: int  # 1, or 0
    epoch: int  # of the lease that stands now
    session: int  # who holds it; 0: nobody


# Whatever counts has 64 bits: at a million a second it ends after 292,000 years. What is drawn has those it needs.
UNIT_COMMAND = ListLayout(UnitCommand, "QQQqq", WheelCommand, "Qdd")
UNIT_STATUS = ListLayout(UnitStatus, "QIQqqB", RobotStatus, "QQqqQBBQIqq" + "d" * 9)
UNIT_ENABLE = ListLayout(UnitEnable, "QQqB", Enable, "QBQd")
UNIT_TRUTH = ListLayout(UnitTruth, "Qq", Truth, "H" + "d" * 5)
UNIT_SENSORS = ListLayout(UnitSensors, "Qq", RobotSensors, "HBB", numbers=True)
UNIT_LEASES = ListLayout(UnitLeases, "", LeaseAnswer, "BQQ")
TRACKER_NEWS = Layout(TrackerNews, "IQqBH", 1)
SCRIPT_WISH = ListLayout(ScriptWish, "IQBQQ", RobotWish, "B" + "d" * 3)
NOTE = BlobLayout(Note, "IQQB")
RECORDER_STATUS = Layout(RecorderStatus, "IQQQB", 0)
HANDED = BlobLayout(Handed, "I")
LEASE_REQUEST = Layout(LeaseRequest, "QB", 0)
FLEET_POSES = ListLayout(FleetPoses, "IQIqqQqqQ", TagPose, "Hii" + "d" * 9)
TICK_RECORD = ListLayout(TickRecord, "IIQqqIQqIQQBBQqq", RobotTick, "d" * 15, numbers=True)
PICTURE = BlobLayout(Picture, "IQqHH")
BUSY_MACHINE = ListLayout(BusyMachine, "IQHBIIHd", Late, "Hqq")
RUN_STATE = ListLayout(RunState, "IQBHHdB", RobotState, "BBHB")
