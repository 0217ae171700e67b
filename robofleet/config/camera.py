"""The camera of a configuration: where its images come from, and what a simulated one has to survive."""

from typing import Annotated, Literal

from pydantic import Field

from robofleet.config.calibrated import (
    CameraModel,
    FloorTag,
    Pixel,
    TagOffset,
)
from robofleet.config.model import MANY, Delay, Gray, Instant, Lasting, Model, Name, Named, Pixels, Text, within

Turn = Annotated[float, Field(ge=-30, le=30)]  # about x right, y down or z forward
Shift = Annotated[float, Field(ge=-0.5, le=0.5)]


class Cable(Model):
    """Something thin over the arena, near the camera: it hides what is below."""

    points_px: Annotated[tuple[Pixel, ...], Field(min_length=2, max_length=MANY, strict=False)]
    """Its course through the image."""
    width_px: Annotated[int, Field(ge=1, le=100)] = 2
    """Across."""
    gray: Gray = 40
    """Of its image."""
    at_s: Instant = 0.0
    """When it is put there; 0: before the checks, too."""


class Glare(Model):
    """A lamp's reflection: light added around a pixel, falling off as a Gaussian."""

    at_px: Pixel
    """Its middle."""
    radius_px: Annotated[float, within(0.1, 1e4)]
    """Standard deviation of the Gaussian."""
    gray: Annotated[float, within(1e-3, 1e5)] = 400.0
    """What it adds at its middle; beyond 255 it saturates."""


class Outage(Model):
    """The camera sends the same picture again and again, or none.

    Time counts from the start of the run; 0: before the checks, too.
    """

    kind: Literal["frozen", "stalled"]
    """``frozen``: the same picture; ``stalled``: none."""
    at_s: Instant
    """When it begins."""
    duration_s: Lasting
    """How long it lasts."""


class Knock(Model):
    """The camera is turned about its own axes, shifted and zoomed, at once or slowly, as one that warms up.

    Time counts from the start of the run; 0: before the checks, too.
    """

    at_s: Instant
    """When it begins."""
    over_s: Instant = 0.0
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
    at_s: Instant = 0.0
    """When it is laid there."""
    duration_s: Lasting
    """How long it lies there."""


class Swap(Model):
    """Two robots' tags are exchanged. Time counts from the start of the run; 0: before the checks, too."""

    robots: Annotated[tuple[Name, Name], Field(strict=False)]
    """The two that wear each other's tag from then on."""
    at_s: Instant
    """When that is done."""


class TrueTagOffset(TagOffset):
    """Where a simulated robot's tag really is on it: from the centre of the axle, in the body's frame."""

    robot: Name
    """Which one."""


class SimulatedCameraSettings(Model):
    """What the simulated camera has to survive; nothing by default."""

    light: Annotated[float, within(1e-3, 1)] = 1.0
    """Share of full light."""
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = None
    """Of the images' compression; null: they are not compressed."""
    projector_gray: Gray = 0
    """Strength of a projector's moving pattern, added to what it falls on."""
    cables: Annotated[tuple[Cable, ...], Field(max_length=MANY, strict=False)] = ()
    """Over the arena, near the camera."""
    glare: Annotated[tuple[Glare, ...], Field(max_length=MANY, strict=False)] = ()
    """Reflections of lamps."""
    posters: Annotated[tuple[FloorTag, ...], Field(max_length=MANY, strict=False)] = ()
    """Prints of tags that nobody surveyed, of any id."""
    covers: Annotated[tuple[Cover, ...], Field(max_length=MANY, strict=False)] = ()
    """Sheets of paper on robots' tags."""
    swaps: Annotated[tuple[Swap, ...], Field(max_length=MANY, strict=False)] = ()
    """Exchanges of two robots' tags."""
    outages: Annotated[tuple[Outage, ...], Field(max_length=MANY, strict=False)] = ()
    """When no new picture comes."""
    knocks: Annotated[tuple[Knock, ...], Field(max_length=MANY, strict=False)] = ()
    """When the camera is moved."""
    tag_offsets: Annotated[tuple[TrueTagOffset, ...], Field(max_length=MANY, strict=False)] = ()
    """Where tags really are on their robots; of a robot that is not named: as calibrated."""


class V4L2Settings(Model):
    """A camera of the kernel's (``camera.source: v4l2``)."""

    device: Named = "/dev/video0"
    """A link in ``/dev/v4l/by-id`` stays when the camera is plugged in again."""
    format: Literal["MJPG", "GREY"] = "MJPG"
    """Of the pixels."""
    gain: Annotated[int, within(-(2**31), 2**31 - 1)] | None = 0
    """In the driver's units; null: this camera has no gain to set."""
    stamp: Literal["start", "end"] = "start"
    """What its driver stamps: the exposure's start, or the end of the transfer."""


class FilesSettings(Model):
    """A video, or a folder of images (``camera.source: files``). Paths count from where robofleet is started."""

    path: Named
    """The video, or the folder."""
    stamps: Text | None = None
    """A CSV of mid-exposures, see ``robofleet/tracking/files.py``; null: each image's name is its own, in ns."""


class BaslerSettings(Model):
    """A Basler camera through pylon (``camera.source: basler``)."""

    serial: Text | None = None
    """Which camera; null: the only one that is plugged in."""
    gain: Annotated[float, within(0, 1e5)] = 0.0
    """In dB; of an older camera in the units of its GainRaw."""
    trigger_source: Literal["Software", "Line1", "Line2", "Line3"] = "Software"
    """With ``camera.trigger: tick``."""


class CameraSettings(Model):
    """The overhead camera. ``trigger: tick`` exposes a fixed time before every tick; ``free`` does not."""

    source: Named = "simulated"
    """``simulated``, ``v4l2``, ``files``, ``basler``, or a class, ``module:Class``."""
    model: CameraModel
    """Its lens and where it hangs, as calibrated."""
    width: Pixels
    """Of its images, in pixels."""
    height: Pixels
    """Of its images, in pixels."""
    rate_hz: Annotated[float, within(0.01, 1e4)]
    """Of its images, where it has a clock of its own."""
    trigger: Literal["free", "tick"] = "tick"
    """``tick``: exposed ``trigger_lead_s`` before every tick; ``free``: at ``rate_hz``."""
    trigger_lead_s: Annotated[float, within(1e-6, 1)] = 0.018
    """From mid-exposure to the tick."""
    exposure_s: Annotated[float, within(1e-7, 1)] = 0.004
    """Of each row."""
    picture_rate_hz: Annotated[float, within(0, 1000)] = 1.0
    """Of the pictures that the tracker shows and that are recorded; 0: none."""
    readout_s: Delay = 0.004
    """From the end of the (first row's) exposure until the image is here."""
    noise_gray: Annotated[float, within(0, 255)] = 3.0
    """Standard deviation of a pixel; 0: two images may be equal."""
    simulated: SimulatedCameraSettings = SimulatedCameraSettings()
    """What a simulated camera has to survive."""
    v4l2: V4L2Settings = V4L2Settings()
    """Of a camera of the kernel's."""
    files: FilesSettings | None = None
    """Of recorded images."""
    basler: BaslerSettings = BaslerSettings()
    """Of a Basler camera."""
