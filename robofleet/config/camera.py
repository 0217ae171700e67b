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
    """Its course through the image."""
    width_px: Annotated[int, Field(ge=1, le=100)] = 2
    """Across."""
    gray: Gray = 40
    """Of its image."""
    at_s: NonNegative = 0.0
    """When it is put there; 0: before the checks, too."""


class Glare(Model):
    """A lamp's reflection: light added around a pixel, falling off as a Gaussian."""

    at_px: Vector2
    """Its middle."""
    radius_px: Positive
    """Standard deviation of the Gaussian."""
    gray: Positive = 400.0
    """What it adds at its middle; beyond 255 it saturates."""


class Outage(Model):
    """The camera sends the same picture again and again, or none.

    Time counts from the start of the run; 0: before the checks, too.
    """

    kind: Literal["frozen", "stalled"]
    """``frozen``: the same picture; ``stalled``: none."""
    at_s: NonNegative
    """When it begins."""
    duration_s: Positive
    """How long it lasts."""


class Knock(Model):
    """The camera is turned about its own axes, shifted and zoomed, at once or slowly, as one that warms up.

    Time counts from the start of the run; 0: before the checks, too.
    """

    at_s: NonNegative
    """When it begins."""
    over_s: NonNegative = 0.0
    """How long it takes; 0: at once."""
    rotation_deg: Annotated[tuple[Turn, Turn, Turn], Field(strict=False)] = (0.0, 0.0, 0.0)
    """About the camera's axes: x right, y down, z forward."""
    shift_m: Annotated[tuple[Shift, Shift, Shift], Field(strict=False)] = (0.0, 0.0, 0.0)
    """In the world frame."""
    focal_ratio: Annotated[float, Field(ge=0.5, le=2)] = 1.0
    """Of the focal lengths, after over before."""


class Cover(Model):
    """A sheet of plain paper on a robot's tag. Time counts from the start of the run; 0: before the checks, too."""

    robot: Name
    """Whose tag is covered."""
    at_s: NonNegative = 0.0
    """When it is laid there."""
    duration_s: Positive
    """How long it lies there."""


class Swap(Model):
    """Two robots' tags are exchanged. Time counts from the start of the run; 0: before the checks, too."""

    robots: Annotated[tuple[Name, Name], Field(strict=False)]
    """The two that wear each other's tag from then on."""
    at_s: NonNegative
    """When that is done."""


class TrueTagOffset(TagOffset):
    """Where a simulated robot's tag really is on it: from the centre of the axle, in the body's frame."""

    robot: Name
    """Which one."""


class SimulatedCameraSettings(Model):
    """What the simulated camera has to survive; nothing by default."""

    light: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Share of full light."""
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = None
    """Of the images' compression; null: they are not compressed."""
    projector_gray: Gray = 0
    """Strength of a projector's moving pattern, added to what it falls on."""
    cables: Annotated[tuple[Cable, ...], Field(strict=False)] = ()
    """Over the arena, near the camera."""
    glare: Annotated[tuple[Glare, ...], Field(strict=False)] = ()
    """Reflections of lamps."""
    posters: Annotated[tuple[FloorTag, ...], Field(strict=False)] = ()
    """Prints of tags that nobody surveyed, of any id."""
    covers: Annotated[tuple[Cover, ...], Field(strict=False)] = ()
    """Sheets of paper on robots' tags."""
    swaps: Annotated[tuple[Swap, ...], Field(strict=False)] = ()
    """Exchanges of two robots' tags."""
    outages: Annotated[tuple[Outage, ...], Field(strict=False)] = ()
    """When no new picture comes."""
    knocks: Annotated[tuple[Knock, ...], Field(strict=False)] = ()
    """When the camera is moved."""
    tag_offsets: Annotated[tuple[TrueTagOffset, ...], Field(strict=False)] = ()
    """Where tags really are on their robots; of a robot that is not named: as calibrated."""


class V4L2Settings(Model):
    """A camera of the kernel's (``camera.source: v4l2``)."""

    device: Annotated[str, Field(min_length=1)] = "/dev/video0"
    """A link in ``/dev/v4l/by-id`` stays when the camera is plugged in again."""
    format: Literal["MJPG", "GREY"] = "MJPG"
    """Of the pixels."""
    gain: int | None = 0
    """In the driver's units; null: this camera has no gain to set."""
    stamp: Literal["start", "end"] = "start"
    """What its driver stamps: the exposure's start, or the end of the transfer."""


class FilesSettings(Model):
    """A video, or a folder of images (``camera.source: files``). Paths count from where robofleet is started."""

    path: Annotated[str, Field(min_length=1)]
    """The video, or the folder."""
    stamps: str | None = None
    """A CSV of mid-exposures, see ``robofleet/tracking/files.py``; null: each image's name is its own, in ns."""


class BaslerSettings(Model):
    """A Basler camera through pylon (``camera.source: basler``)."""

    serial: str | None = None
    """Which camera; null: the only one that is plugged in."""
    gain: NonNegative = 0.0
    """In dB; of an older camera in the units of its GainRaw."""
    trigger_source: Literal["Software", "Line1", "Line2", "Line3"] = "Software"
    """With ``camera.trigger: tick``."""


class CameraSettings(Model):
    """The overhead camera. ``trigger: tick`` exposes a fixed time before every tick; ``free`` does not."""

    source: Annotated[str, Field(min_length=1)] = "simulated"
    """``simulated``, ``v4l2``, ``files``, ``basler``, or a class, ``module:Class``."""
    model: CameraModel
    """Its lens and where it hangs, as calibrated."""
    width: Annotated[int, Field(gt=0)]
    """Of its images, in pixels."""
    height: Annotated[int, Field(gt=0)]
    """Of its images, in pixels."""
    rate_hz: Positive
    """Of its images, where it has a clock of its own."""
    trigger: Literal["free", "tick"] = "tick"
    """``tick``: exposed ``trigger_lead_s`` before every tick; ``free``: at ``rate_hz``."""
    trigger_lead_s: Positive = 0.018
    """From mid-exposure to the tick."""
    exposure_s: Positive = 0.004
    """Of each row."""
    picture_rate_hz: NonNegative = 1.0
    """Of the pictures that the tracker shows and that are recorded; 0: none."""
    readout_s: NonNegative = 0.004
    """From the end of the (first row's) exposure until the image is here."""
    noise_gray: NonNegative = 3.0
    """Standard deviation of a pixel; 0: two images may be equal."""
    simulated: SimulatedCameraSettings = SimulatedCameraSettings()
    """What a simulated camera has to survive."""
    v4l2: V4L2Settings = V4L2Settings()
    """Of a camera of the kernel's."""
    files: FilesSettings | None = None
    """Of recorded images."""
    basler: BaslerSettings = BaslerSettings()
    """Of a Basler camera."""
