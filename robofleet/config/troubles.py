"""Timed faults: what ``--faults FILE`` and a storm inject. Times count from the start of the run [s]."""

from typing import Annotated, Literal

from pydantic import Field

from robofleet.config.model import Fraction, Model, Name, NonNegative, Positive


class Timed(Model):
    """When: without ``at_s`` from before the checks on; without ``duration_s`` for good."""

    at_s: NonNegative | None = None
    duration_s: Positive | None = None


class RobotFault(Timed):
    """A robot's body, motors or battery. Simulated robots only."""

    kind: Literal["motor_stuck", "slip", "low_battery", "wired_stop"]
    robot: Name


class PoseFault(Timed):
    """What the tracker says of one robot."""

    kind: Literal["pose_dropout", "pose_noise", "duplicate_tag"]
    robot: Name
    sigma_m: NonNegative = 0.05  # pose_noise


class IdSwap(Timed):
    """Two robots exchange their tags."""

    kind: Literal["id_swap"]
    robots: tuple[Name, Name]


class CameraFault(Timed):
    """The camera or the whole of what the tracker says."""

    kind: Literal["camera_frozen", "camera_stalled", "pose_delay"]
    delay_s: NonNegative = 0.1  # pose_delay


class MessageFault(Timed):
    """Messages of one topic on their way to one robot (or to all), or everything on a link."""

    kind: Literal["lost", "late", "duplicated", "reordered", "not_a_number", "malformed"]
    topic: Literal["cmd", "enable", "status", "poses", "state", "tick"]
    robot: Name | None = None
    share: Fraction = 1.0  # of the messages
    burst_s: NonNegative = 0.0  # lost: in bursts of up to so long
    median_s: NonNegative = 0.002  # late: half the messages are later than this
    p99_s: NonNegative = 0.06  # and one in a hundred later than that


class NetworkCut(Timed):
    """Nothing passes between some processes and the rest; held back, it is delivered at the end."""

    kind: Literal["network_cut"]
    processes: Annotated[
        tuple[str, ...], Field(min_length=1, strict=False)
    ]  # controller, tracker, supervisor, driver-r1
    held_back: bool = False


class ProcessFault(Timed):
    """A process is killed (and started again at the end), or stopped (and continued)."""

    kind: Literal["killed", "stopped", "clock_step"]
    process: str
    step_s: float = 1.0  # clock_step


class WholeFault(Timed):
    """Things that concern the run."""

    kind: Literal["disk_full", "second_controller"]


Fault = Annotated[
    RobotFault | PoseFault | IdSwap | CameraFault | MessageFault | NetworkCut | ProcessFault | WholeFault,
    Field(discriminator="kind"),
]
