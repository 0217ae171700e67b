"""The camera of a configuration: where its images come from, and what a simulated one has to survive."""

from typing import Annotated, Literal

from pydantic import Field

from robofleet.config.calibrated import (
    CameraModel,
    FloorTag,
    TagOffset,
)
from robofleet.config.model import (
    Gray,
    Model,
    Name,
    NonNegative,
    Positive,
    Vector2,
)

Turn = Annotated[float, Field(ge=-30, le=30)]  # about x right, y down or z forward
Shift = Annotated[float, Field(ge=-0.5, le=0.5)]


class Cable(Model):
    """Something thin over the arena, near the camera: it hides what is below."""

    points_px: Annotated[tuple[Vector2, ...], Field(min_length=2, strict=False)]
    width_px: Annotated[int, Field(ge=1, le=100)] = 2
    gray: Gray = 40
    at_s: NonNegative = 0.0  # from then on; time counts from the start of the run; 0: before the checks, too


class Glare(Model):
    """A lamp's reflection: light added around a pixel, falling off as a Gaussian."""

    at_px: Vector2
    radius_px: Positive
    gray: Positive = 400.0  # at its middle: beyond 255 it saturates


class Outage(Model):
    """The camera sends the same picture again and again, or none.

    Time counts from the start of the run; 0: before the checks, too.
    """

    kind: Literal["frozen", "stalled"]
    at_s: NonNegative
    duration_s: Positive


class Knock(Model):
    """The camera is turned about its own axes, shifted and zoomed, at once or slowly, as one that warms up.

    Time counts from the start of the run; 0: before the checks, too.
    """

    at_s: NonNegative
    over_s: NonNegative = 0.0
    rotation_deg: Annotated[tuple[Turn, Turn, Turn], Field(strict=False)] = (0.0, 0.0, 0.0)  # [camera]
    shift_m: Annotated[tuple[Shift, Shift, Shift], Field(strict=False)] = (0.0, 0.0, 0.0)  # [world]
    focal_ratio: Annotated[float, Field(ge=0.5, le=2)] = 1.0  # of the focal lengths, after over before


class Cover(Model):
    """A sheet of plain paper on a robot's tag. Time counts from the start of the run; 0: before the checks, too."""

    robot: Name
    at_s: NonNegative = 0.0
    duration_s: Positive


class Swap(Model):
    """Two robots' tags are exchanged. Time counts from the start of the run; 0: before the checks, too."""

    robots: Annotated[tuple[Name, Name], Field(strict=False)]
    at_s: NonNegative


class TrueTagOffset(TagOffset):
    """Where a simulated robot's tag really is on it."""

    robot: Name


class SimulatedCameraSettings(Model):
    """What the simulated camera has to survive; nothing by default."""

    light: Annotated[float, Field(gt=0, le=1)] = 1.0  # of full light
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = None
    projector_gray: Gray = 0  # strength of a projector's moving pattern, added to what it falls on
    cables: Annotated[tuple[Cable, ...], Field(strict=False)] = ()
    glare: Annotated[tuple[Glare, ...], Field(strict=False)] = ()
    posters: Annotated[tuple[FloorTag, ...], Field(strict=False)] = ()  # prints that nobody surveyed, of any id
    covers: Annotated[tuple[Cover, ...], Field(strict=False)] = ()
    swaps: Annotated[tuple[Swap, ...], Field(strict=False)] = ()
    outages: Annotated[tuple[Outage, ...], Field(strict=False)] = ()
    knocks: Annotated[tuple[Knock, ...], Field(strict=False)] = ()
    tag_offsets: Annotated[tuple[TrueTagOffset, ...], Field(strict=False)] = ()  # default: as calibrated


class V4L2Settings(Model):
    """A camera of the kernel's (``camera.source: v4l2``)."""

    device: Annotated[str, Field(min_length=1)] = "/dev/video0"  # a link in /dev/v4l/by-id stays when it is replugged
    format: Literal["MJPG", "GREY"] = "MJPG"
    gain: int | None = 0  # in the driver's units; null: this camera has no gain to set
    stamp: Literal["start", "end"] = "start"  # what its driver stamps: the exposure's start, or the end of the transfer


class FilesSettings(Model):
    """A video, or a folder of images (``camera.source: files``). Paths count from where robofleet is started."""

    path: Annotated[str, Field(min_length=1)]
    stamps: str | None = None  # CSV of mid-exposures, see tracking/files.py; null: each image's name is its own, in ns


class BaslerSettings(Model):
    """A Basler camera through pylon (``camera.source: basler``)."""

    serial: str | None = None  # null: the only one that is plugged in
    gain: NonNegative = 0.0  # [dB]; of an older camera in the units of its GainRaw
    trigger_source: Literal["Software", "Line1", "Line2", "Line3"] = "Software"  # with ``camera.trigger: tick``


class CameraSettings(Model):
    """The overhead camera. ``trigger: tick`` exposes a fixed time before every tick; ``free`` does not."""

    source: Annotated[str, Field(min_length=1)] = "simulated"
    model: CameraModel
    width: Annotated[int, Field(gt=0)]
    height: Annotated[int, Field(gt=0)]
    rate_hz: Positive
    trigger: Literal["free", "tick"] = "tick"
    trigger_lead_s: Positive = 0.018  # from mid-exposure to the tick
    exposure_s: Positive = 0.004
    picture_rate_hz: NonNegative = 1.0  # of the pictures that the tracker shows and that are recorded; 0: none
    readout_s: NonNegative = 0.004  # from the end of the (first row's) exposure until the image is here
    noise_gray: NonNegative = 3.0  # of a pixel; 0: of no pixel, so that two images may be equal
    simulated: SimulatedCameraSettings = SimulatedCameraSettings()
    v4l2: V4L2Settings = V4L2Settings()
    files: FilesSettings | None = None
    basler: BaslerSettings = BaslerSettings()
