"""Timed faults: what ``--faults FILE`` and a storm inject.

Times count from the start of the run, the first time that the fleet is RUNNING [s]. A process is named as its log is:
controller, tracker, supervisor, router, driver-r1.
"""

from typing import Annotated, Literal

from pydantic import Field

from robofleet.config.model import MANY, Instant, Lasting, Lateness, Model, Name, Text, within

MessageTopic = Literal["cmd", "enable", "status", "poses", "state", "tick"]
Share = Annotated[float, within(1e-9, 1)]
_Push = Annotated[float, within(-10, 10)]


class Timed(Model):
    """When something goes wrong; times count from the start of the run."""

    at_s: Instant | None = None
    """null: from the first moment, before the checks."""
    duration_s: Lasting | None = None
    """null: for good."""


class BodyFault(Timed):
    """A simulated robot's motors stand still whatever they are told, or half of its wheels' travel is lost as slip."""

    kind: Literal["motor_stuck", "slip"]
    """``motor_stuck``: the motors stand; ``slip``: half of the travel is lost."""
    robot: Name
    """Whose."""


class RunawayFault(Timed):
    """A simulated robot's wheel turns by itself, whatever it is told."""

    kind: Literal["motor_runs"]
    """What goes wrong."""
    robot: Name
    """Whose."""
    wheel: Literal["left", "right"]
    """Which one."""
    speed_rad_s: Annotated[float, within(-1000, 1000)]
    """How fast; forward is positive."""


class Push(Timed):
    """A hand pushes a simulated robot over the floor, whatever its wheels do."""

    kind: Literal["pushed"]
    """What goes wrong."""
    robot: Name
    """Whose."""
    velocity_m_s: Annotated[tuple[_Push, _Push], Field(strict=False)]
    """Along x and y [world frame]."""


class ReadingFault(Timed):
    """What a robot says of itself: a battery at 5 %, or its own e-stop pressed."""

    kind: Literal["low_battery", "wired_stop"]
    """``low_battery``: at 5 %; ``wired_stop``: its own e-stop is pressed."""
    robot: Name
    """Whose."""


class TouchFault(Timed):
    """A twin's robot is touched: what it feels, and says."""

    kind: Literal["bumper_hit", "wheel_lifted", "cliff"]
    """What it feels."""
    robot: Name
    """Whose."""


class LinkFault(Timed):
    """A twin's serial line is pulled out and plugged in again at the end, or its firmware hangs until then."""

    kind: Literal["unplugged", "firmware_hangs"]
    """``unplugged``: the port is gone; ``firmware_hangs``: nothing is read, answered or changed, motors go on."""
    robot: Name
    """Whose."""


class LineFault(Timed):
    """Lines between a driver and a twin, both ways, lose their end, get bytes that nobody sent, or come late.

    A line is what is said at once, whatever the protocol: a write of the driver, an answer of the robot.
    """

    kind: Literal["line_cut", "line_garbage", "line_late"]
    """``line_cut``: from some byte on; ``line_garbage``: some bytes are others; ``line_late``: by ``delay_s``."""
    robot: Name | None = None
    """Whose; null: every twin's."""
    share: Share = 0.01
    """Of the lines."""
    delay_s: Lateness = 0.05
    """How late."""


class PoseFault(Timed):
    """The tracker does not see a robot's tag, or sees it twice and believes neither."""

    kind: Literal["pose_dropout", "duplicate_tag"]
    """``pose_dropout``: not seen; ``duplicate_tag``: seen twice."""
    robot: Name
    """Whose."""


class PoseNoise(Timed):
    """A robot's pose is measured badly."""

    kind: Literal["pose_noise"]
    """What goes wrong."""
    robot: Name
    """Whose."""
    sigma_m: Annotated[float, within(1e-9, 100)]
    """Standard deviation, along each axis."""
    sigma_rad: Annotated[float, within(0, 10)] = 0.0
    """Standard deviation of the heading."""


class IdSwap(Timed):
    """Two robots wear each other's tag."""

    kind: Literal["id_swap"]
    """What goes wrong."""
    robots: Annotated[tuple[Name, Name], Field(strict=False)]
    """Which two."""


class CameraFault(Timed):
    """The camera gives the same picture again and again, or none."""

    kind: Literal["camera_frozen", "camera_stalled"]
    """``camera_frozen``: the same picture; ``camera_stalled``: none."""


class PoseDelay(Timed):
    """What the tracker says comes late, all of it and in order."""

    kind: Literal["pose_delay"]
    """What goes wrong."""
    delay_s: Lateness
    """How late."""


class OfMessages(Timed):
    """Something that is done to messages."""

    topics: Annotated[tuple[MessageTopic, ...], Field(min_length=1, max_length=MANY, strict=False)]
    """Which messages."""
    robot: Name | None = None
    """Those to and from this one; null: everybody's."""


class MessageFault(OfMessages):
    """Messages arrive twice, behind the next one, with a NaN, or cut short. ``robot``: those to and from this one."""

    kind: Literal["duplicated", "reordered", "not_a_number", "malformed"]
    """``reordered``: behind the next one; ``malformed``: cut short."""
    share: Share = 1.0
    """Of the messages."""


class Lost(OfMessages):
    """Messages do not arrive, one by one, or all of a robot's together in bursts of up to ``burst_s``."""

    kind: Literal["lost"]
    """What goes wrong."""
    share: Share = 1.0
    """Of the messages; with bursts, of the time."""
    burst_s: Instant = 0.0
    """The longest burst; 0: one message at a time."""


class Late(OfMessages):
    """Messages arrive late by a log-normal time, each by its own: one may overtake another."""

    kind: Literal["late"]
    """What goes wrong."""
    median_s: Lateness = 0.002
    """Half of them are later."""
    p99_s: Lateness = 0.06
    """One in a hundred is later."""


class NetworkCut(Timed):
    """Nothing passes between some processes and the others; what is ``held_back`` arrives at the end, all at once."""

    kind: Literal["network_cut"]
    """What goes wrong."""
    processes: Annotated[tuple[Text, ...], Field(min_length=1, max_length=MANY, strict=False)]
    """Those on one side of the cut."""
    held_back: bool = False
    """Whether what was said meanwhile arrives at the end."""


class ProcessFault(Timed):
    """A process is killed and started again at the end, or it is stopped and goes on then."""

    kind: Literal["killed", "stopped"]
    """``killed``: and started again at the end; ``stopped``: and continued then."""
    process: Text
    """Which one."""


class ClockStep(Timed):
    """A process's clock jumps, and back at the end. In lockstep only: no process may set a real clock."""

    kind: Literal["clock_step"]
    """What goes wrong."""
    process: Text
    """Whose clock."""
    step_s: Annotated[float, within(-1e6, 1e6)]
    """Forward, or back if negative."""


class WholeFault(Timed):
    """The disk takes nothing any more, or a second controller wants to drive the same robots (in lockstep only)."""

    kind: Literal["disk_full", "second_controller"]
    """``disk_full``: nothing can be written; ``second_controller``: it wants the same robots."""


Fault = Annotated[
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
