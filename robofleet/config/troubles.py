"""Timed faults: what ``--faults FILE`` and a storm inject.

Times count from the start of the run, the first time that the fleet is RUNNING [s]. A process is named as its log is:
controller, tracker, supervisor, router, driver-r1.
"""

from typing import Annotated, Literal

from pydantic import Field

from robofleet.core.settings import MANY, Instant, Lasting, Lateness, Model, Name, Text, within

MessageTopic = Literal["cmd", "enable", "status", "poses", "state", "tick"]
Share = Annotated[float, within(1e-9, 1)]
_Push = Annotated[float, within(-10, 10)]


class Timed(Model):
    """When a fault acts. Times count from the start of the run."""

    at_s: Instant | None = None
    """Time at which the fault begins; null: at the first moment, before the checks."""
    duration_s: Lasting | None = None
    """How long the fault lasts; null: to the end."""


class BodyFault(Timed):
    """A simulated robot's motors do not turn, or its wheels slip."""

    kind: Literal["motor_stuck", "slip"]
    """``motor_stuck``: the motors stand still whatever is commanded. ``slip``: half of the wheels' travel is lost."""
    robot: Name
    """Id of the robot."""


class RunawayFault(Timed):
    """A wheel of a simulated robot turns by itself, whatever is commanded."""

    kind: Literal["motor_runs"]
    """Name of the fault."""
    robot: Name
    """Id of the robot."""
    wheel: Literal["left", "right"]
    """Which wheel turns."""
    speed_rad_s: Annotated[float, within(-1000, 1000)]
    """Speed of the wheel, forward positive."""


class Push(Timed):
    """A hand pushes a simulated robot over the floor, whatever its wheels do."""

    kind: Literal["pushed"]
    """Name of the fault."""
    robot: Name
    """Id of the robot."""
    velocity_m_s: Annotated[tuple[_Push, _Push], Field(strict=False)]
    """Velocity along x and along y [world frame]."""


class ReadingFault(Timed):
    """A robot reports a low battery or a pressed emergency stop of its own."""

    kind: Literal["low_battery", "wired_stop"]
    """``low_battery``: a battery at 5 %. ``wired_stop``: the robot's own emergency stop is pressed."""
    robot: Name
    """Id of the robot."""


class TouchFault(Timed):
    """A sensor of a twin's robot reports a contact or a missing floor."""

    kind: Literal["bumper_hit", "wheel_lifted", "cliff"]
    """Which sensor reports."""
    robot: Name
    """Id of the robot."""


class LinkFault(Timed):
    """A twin's serial cable is unplugged, or its firmware hangs. At the end of the fault both are as before."""

    kind: Literal["unplugged", "firmware_hangs"]
    """``unplugged``: the port is gone. ``firmware_hangs``: the firmware reads, answers and changes nothing; the motors
    go on."""
    robot: Name
    """Id of the robot."""


class LineFault(Timed):
    """Lines between a driver and a twin, in both directions, are cut, changed or delayed. A line is whatever is written
    at once: a write of the driver, or an answer of the robot."""

    kind: Literal["line_cut", "line_garbage", "line_late"]
    """``line_cut``: the line loses its end. ``line_garbage``: some of its bytes are changed. ``line_late``: it arrives
    ``delay_s`` late."""
    robot: Name | None = None
    """Id of the robot; null: every twin."""
    share: Share = 0.01
    """Share of the lines that the fault strikes."""
    delay_s: Lateness = 0.05
    """Delay of a late line."""


class PoseFault(Timed):
    """The tracker does not see a robot's tag, or sees it twice and rejects both."""

    kind: Literal["pose_dropout", "duplicate_tag"]
    """``pose_dropout``: the tag is not seen. ``duplicate_tag``: the tag is seen twice."""
    robot: Name
    """Id of the robot."""


class PoseNoise(Timed):
    """The measured pose of a robot is noisy."""

    kind: Literal["pose_noise"]
    """Name of the fault."""
    robot: Name
    """Id of the robot."""
    sigma_m: Annotated[float, within(1e-9, 100)]
    """Standard deviation of the position along each axis."""
    sigma_rad: Annotated[float, within(0, 10)] = 0.0
    """Standard deviation of the heading."""


class IdSwap(Timed):
    """Two robots wear each other's tag."""

    kind: Literal["id_swap"]
    """Name of the fault."""
    robots: Annotated[tuple[Name, Name], Field(strict=False)]
    """Ids of the two robots."""


class CameraFault(Timed):
    """The camera repeats one image, or sends none."""

    kind: Literal["camera_frozen", "camera_stalled"]
    """``camera_frozen``: the same image again and again. ``camera_stalled``: no image, or no poses
    of ``tracker.source: mocap``."""


class PoseDelay(Timed):
    """All messages of the tracker arrive late, in order."""

    kind: Literal["pose_delay"]
    """Name of the fault."""
    delay_s: Lateness
    """Delay of each message."""


class OfMessages(Timed):
    """A fault that strikes messages."""

    topics: Annotated[tuple[MessageTopic, ...], Field(min_length=1, max_length=MANY, strict=False)]
    """Topics of the messages."""
    robot: Name | None = None
    """Only messages to and from this robot; null: all."""


class MessageFault(OfMessages):
    """Messages arrive twice, in the wrong order, with a NaN, or cut short."""

    kind: Literal["duplicated", "reordered", "not_a_number", "malformed"]
    """``duplicated``: twice. ``reordered``: behind the next one. ``not_a_number``: with a NaN. ``malformed``: cut
    short."""
    share: Share = 1.0
    """Share of the messages that the fault strikes."""


class Lost(OfMessages):
    """Messages do not arrive: one by one, or all messages of a robot together in bursts."""

    kind: Literal["lost"]
    """Name of the fault."""
    share: Share = 1.0
    """Share of the messages that are lost; with bursts, share of the time."""
    burst_s: Instant = 0.0
    """Longest burst; 0: messages are lost one by one."""


class Late(OfMessages):
    """Messages arrive late by log-normal times. Each has its own time, so one may overtake another."""

    kind: Literal["late"]
    """Name of the fault."""
    median_s: Lateness = 0.002
    """Delay that half of the messages exceed."""
    p99_s: Lateness = 0.06
    """Delay that one message in a hundred exceeds."""


class NetworkCut(Timed):
    """No message passes between some processes and the others."""

    kind: Literal["network_cut"]
    """Name of the fault."""
    processes: Annotated[tuple[Text, ...], Field(min_length=1, max_length=MANY, strict=False)]
    """Names of the processes on one side of the cut, as their logs are named."""
    held_back: bool = False
    """``true``: the messages of that time arrive together at the end. ``false``: they are lost."""


class ProcessFault(Timed):
    """A process is killed and started again at the end, or stopped and continued at the end."""

    kind: Literal["killed", "stopped"]
    """``killed``: killed, and started again at the end. ``stopped``: stopped, and continued at the end."""
    process: Text
    """Name of the process, as its log is named: ``tracker``, ``driver-r1``."""


class ClockStep(Timed):
    """A process's clock jumps, and jumps back at the end. Only lockstep has this fault: a process may not set a real
    clock."""

    kind: Literal["clock_step"]
    """Name of the fault."""
    process: Text
    """Name of the process whose clock jumps."""
    step_s: Annotated[float, within(-1e6, 1e6)]
    """Size of the jump, forward positive."""


class WholeFault(Timed):
    """The disk is full, or a second controller tries to drive the same robots (in lockstep only)."""

    kind: Literal["disk_full", "second_controller"]
    """``disk_full``: nothing can be written. ``second_controller``: a second controller asks for the same robots."""


InjectedFault = Annotated[
    BodyFault
    | RunawayFault
    | Push
    | ReadingFault
    | TouchFault
    | LinkFault
    | LineFault
    | PoseFault
    | PoseNoise
    | IdSwap
    | CameraFault
    | PoseDelay
    | MessageFault
    | Lost
    | Late
    | NetworkCut
    | ProcessFault
    | ClockStep
    | WholeFault,
    Field(discriminator="kind"),
]
