"""Timed faults: what ``--faults FILE`` and a storm inject.

Times count from the start of the run, the first time that the fleet is RUNNING [s]. A process is named as its log is:
controller, tracker, supervisor, router, driver-r1.
"""

from typing import Annotated, Literal

from pydantic import Field

from robofleet.config.model import Model, Name, NonNegative, Positive

MessageTopic = Literal["cmd", "enable", "status", "poses", "state", "tick"]
Share = Annotated[float, Field(gt=0, le=1)]


class Timed(Model):
    """When: without ``at_s`` from the first moment, before the checks; without ``duration_s`` for good."""

    at_s: NonNegative | None = None
    duration_s: Positive | None = None


class BodyFault(Timed):
    """A simulated robot's motors stand still whatever they are told, or half of its wheels' travel is lost as slip."""

    kind: Literal["motor_stuck", "slip"]
    robot: Name


class ReadingFault(Timed):
    """What a robot says of itself: a battery at 5 %, or its own e-stop pressed."""

    kind: Literal["low_battery", "wired_stop"]
    robot: Name


class PoseFault(Timed):
    """The tracker does not see a robot's tag, or sees it twice and believes neither."""

    kind: Literal["pose_dropout", "duplicate_tag"]
    robot: Name


class PoseNoise(Timed):
    """A robot's pose is measured badly."""

    kind: Literal["pose_noise"]
    robot: Name
    sigma_m: Positive
    sigma_rad: NonNegative = 0.0


class IdSwap(Timed):
    """Two robots wear each other's tag."""

    kind: Literal["id_swap"]
    robots: Annotated[tuple[Name, Name], Field(strict=False)]


class CameraFault(Timed):
    """The camera gives the same picture again and again, or none."""

    kind: Literal["camera_frozen", "camera_stalled"]


class PoseDelay(Timed):
    """What the tracker says comes late, all of it and in order."""

    kind: Literal["pose_delay"]
    delay_s: Positive


class MessageFault(Timed):
    """Messages arrive twice, behind the next one, with a NaN, or cut short. ``robot``: those to and from this one."""

    kind: Literal["duplicated", "reordered", "not_a_number", "malformed"]
    topics: Annotated[tuple[MessageTopic, ...], Field(min_length=1, strict=False)]
    robot: Name | None = None
    share: Share = 1.0


class Lost(Timed):
    """Messages do not arrive, one by one, or all of a robot's together in bursts of up to ``burst_s``."""

    kind: Literal["lost"]
    topics: Annotated[tuple[MessageTopic, ...], Field(min_length=1, strict=False)]
    robot: Name | None = None
    share: Share = 1.0  # of the messages; with bursts, of the time
    burst_s: NonNegative = 0.0


class Late(Timed):
    """Messages arrive late by a log-normal time, each by its own: one may overtake another."""

    kind: Literal["late"]
    topics: Annotated[tuple[MessageTopic, ...], Field(min_length=1, strict=False)]
    robot: Name | None = None
    median_s: Positive = 0.002
    p99_s: Positive = 0.06


class NetworkCut(Timed):
    """Nothing passes between some processes and the others; what is ``held_back`` arrives at the end, all at once."""

    kind: Literal["network_cut"]
    processes: Annotated[tuple[str, ...], Field(min_length=1, strict=False)]
    held_back: bool = False


class ProcessFault(Timed):
    """A process is killed and started again at the end, or it is stopped and goes on then."""

    kind: Literal["killed", "stopped"]
    process: str


class ClockStep(Timed):
    """A process's clock jumps, and back at the end. In lockstep only: no process may set a real clock."""

    kind: Literal["clock_step"]
    process: str
    step_s: float = Field(allow_inf_nan=False)


class WholeFault(Timed):
    """The disk takes nothing any more, or a second controller wants to drive the same robots (in lockstep only)."""

    kind: Literal["disk_full", "second_controller"]


Fault = Annotated[
    BodyFault
    | ReadingFault
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
