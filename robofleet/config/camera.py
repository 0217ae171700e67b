"""The camera of a configuration: where its images come from, and what a simulated one has to survive."""

from typing import Annotated, Literal

from pydantic import Field

from robofleet.config.calibrated import CameraModel, FloorTag, Pixel, TagOffset
from robofleet.core.patterns import OVERHEAD
from robofleet.core.settings import (
    MANY,
    Delay,
    Gray,
    Height,
    Instant,
    Lasting,
    Model,
    Name,
    Named,
    Pixels,
    Text,
    within,
)

Turn = Annotated[float, Field(ge=-30, le=30)]  # about x right, y down or z forward
Stretch = Annotated[float, Field(ge=-0.05, le=0.05)]
Gain = Annotated[float, within(-(2**31), 2**31 - 1)]
ControlValue = Annotated[int, within(-(2**31), 2**31 - 1)]
StampedInstant = Literal["start", "transfer", "end"]
Shift = Annotated[float, Field(ge=-0.5, le=0.5)]


class Cable(Model):
    """A thin object between camera and arena. It hides what is behind it."""

    points_px: Annotated[tuple[Pixel, ...], Field(min_length=2, max_length=MANY, strict=False)]
    """Its course through the image."""
    width_px: Annotated[int, Field(ge=1, le=100)] = 2
    """Width of its image."""
    gray: Gray = 40
    """Grey level of its image."""
    at_s: Instant = 0.0
    """Time at which it appears; 0: before the checks."""


class Glare(Model):
    """Reflection of a lamp: light that is added around a pixel and falls off as a Gaussian."""

    at_px: Pixel
    """Centre of the reflection."""
    radius_px: Annotated[float, within(0.1, 1e4)]
    """Standard deviation of the Gaussian."""
    gray: Annotated[float, within(1e-3, 1e5)] = 400.0
    """Grey levels that are added at the centre. A sum above 255 saturates."""


class Shadow(Model):
    """The straight edge of a shadow on floor and robots. It lies still in the image, as the lens shows it."""

    at_px: Pixel
    """A pixel on the edge."""
    angle_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    """Direction into the shadow: 0 to the image's right, 90 down."""
    softness_px: Annotated[float, within(0.1, 1e4)] = 3.0
    """Standard deviation of the Gaussian that blurs the edge."""
    light: Annotated[float, within(0, 1)] = 0.5
    """Share of the light that is left in the shadow."""


class Outage(Model):
    """The camera repeats one image, or sends none. Times count from the start of the run; 0: from before the checks
    on."""

    kind: Literal["frozen", "stalled"]
    """``frozen``: the same image again and again. ``stalled``: no image."""
    at_s: Instant
    """Time at which it begins."""
    duration_s: Lasting
    """How long it lasts."""


class Knock(Model):
    """The camera is turned about its own axes, shifted or zoomed: at once, or slowly as when it warms up. Times count
    from the start of the run; 0: from before the checks on."""

    at_s: Instant
    """Time at which it begins."""
    over_s: Instant = 0.0
    """How long the change takes; 0: at once."""
    rotation_deg: Annotated[tuple[Turn, Turn, Turn], Field(strict=False)] = (0.0, 0.0, 0.0)
    """Rotation about the camera's axes: x right, y down, z forward."""
    shift_m: Annotated[tuple[Shift, Shift, Shift], Field(strict=False)] = (0.0, 0.0, 0.0)
    """Shift in the world frame."""
    focal_ratio: Annotated[float, Field(ge=0.5, le=2)] = 1.0
    """Focal lengths after the change, divided by those before it."""


class Cover(Model):
    """A sheet of plain paper covers a robot's tag. Times count from the start of the run; 0: from before the checks
    on."""

    robot: Name
    """Id of the robot whose tag is covered."""
    at_s: Instant = 0.0
    """Time at which the sheet is laid there."""
    duration_s: Lasting
    """How long the sheet lies there."""


class Swap(Model):
    """Somebody exchanges the tags of two robots. Times count from the start of the run; 0: from before the checks
    on."""

    robots: Annotated[tuple[Name, Name], Field(strict=False)]
    """Ids of the two robots."""
    at_s: Instant
    """Time of the exchange."""


class TrueTagOffset(TagOffset):
    """True pose of the tag on a simulated robot, from the centre of the axle, in the body's frame."""

    robot: Name
    """Id of the robot."""
    height_m: Height | None = None
    """True height of the tag above the floor; null: as configured."""


class TruePrint(Model):
    """How a simulated robot's tag was really printed."""

    robot: Name | None = None
    """Id of the robot; null: every robot that no other item names."""
    stretch: Annotated[tuple[Stretch, Stretch], Field(strict=False)] = (0.0, 0.0)
    """Shares by which the print is too long along its right, and along its top."""
    bow_m: Annotated[float, Field(ge=-0.05, le=0.05)] = 0.0
    """How far the middles of the left and right edges of its square lie below its centre."""


class Breathing(Model):
    """The focus hunts: the focal length's logarithm is a sine in time. Each image is drawn anew, so it is slow."""

    ratio: Annotated[float, within(1e-6, 0.1)]
    """Largest share by which the focal length changes."""
    period_s: Annotated[float, within(0.01, 1e4)] = 1.3
    """Period of the sine."""


class Daylight(Model):
    """How light it is at a time."""

    at_s: Instant
    """Time from the start of the run."""
    light: Annotated[float, within(1e-3, 100)]
    """Share of full light."""


class SimulatedCameraSettings(Model):
    """Lens, electronics and troubles of the simulated camera. By default the lens is sharp, and all else is ideal."""

    lens_sigma_px: Annotated[float, within(0.3, 3)] = 0.5
    """Standard deviation of the Gaussian that a point of light becomes. A pixel's own square adds to it."""
    breathing: Breathing | None = None
    """A focus that hunts; null: the focal length stays."""
    vignetting: Annotated[float, within(0, 0.9)] = 0.0
    """Share of the light that the image's corners lack, beside the lamps' own unevenness."""
    shadows: Annotated[tuple[Shadow, ...], Field(max_length=MANY, strict=False)] = ()
    """Edges of shadows."""
    bayer: bool = False
    """Whether the sensor sees one colour in each pixel (RGGB), and the others are interpolated."""
    denoising_gray: Annotated[float, within(0, 255)] = 0.0
    """Strength of the camera's spatial denoising, a bilateral filter of 5 x 5 pixels: the difference of greys that it
    takes for noise; 0: none."""
    temporal_denoising: Annotated[float, within(0, 0.95)] = 0.0
    """Share of the image before in each image."""
    tone_curve: Literal["linear", "gamma", "srgb"] = "linear"
    """How grey levels grow with the light: evenly, by the power 1/2.2, or as sRGB."""
    sharpening: Annotated[float, within(0, 10)] = 0.0
    """Strength of the camera's sharpening: how many times the difference to the blurred image is added."""
    prints: Annotated[tuple[TruePrint, ...], Field(max_length=MANY, strict=False)] = ()
    """True prints of the robots' tags. A robot that is not named has an exact one."""

    light: Annotated[float, within(1e-3, 1)] = 1.0
    """Share of full light."""
    daylight: Annotated[tuple[Daylight, ...], Field(max_length=MANY, strict=False)] = ()
    """Instead of ``light``: times between which the light changes evenly."""
    jpeg_quality: Annotated[int, Field(ge=1, le=100)] | None = None
    """Quality of the images' JPEG compression; null: no compression."""
    projector_gray: Gray = 0
    """Strength of a projector's moving pattern, which is added to the image of the floor and the robots."""
    cables: Annotated[tuple[Cable, ...], Field(max_length=MANY, strict=False)] = ()
    """Thin objects between camera and arena."""
    glare: Annotated[tuple[Glare, ...], Field(max_length=MANY, strict=False)] = ()
    """Reflections of lamps. A wide and faint one is a veil."""
    posters: Annotated[tuple[FloorTag, ...], Field(max_length=MANY, strict=False)] = ()
    """Prints of tags that nobody surveyed, of any id."""
    covers: Annotated[tuple[Cover, ...], Field(max_length=MANY, strict=False)] = ()
    """Sheets of paper on robots' tags."""
    swaps: Annotated[tuple[Swap, ...], Field(max_length=MANY, strict=False)] = ()
    """Exchanges of two robots' tags."""
    outages: Annotated[tuple[Outage, ...], Field(max_length=MANY, strict=False)] = ()
    """Times without a new image."""
    knocks: Annotated[tuple[Knock, ...], Field(max_length=MANY, strict=False)] = ()
    """Movements of the camera."""
    tag_offsets: Annotated[tuple[TrueTagOffset, ...], Field(max_length=MANY, strict=False)] = ()
    """True poses of the tags on their robots. A robot that is not named has its tag where its calibration says."""


class V4L2Settings(Model):
    """A camera of the Linux kernel (``camera.source: v4l2``)."""

    device: Named = "/dev/video0"
    """Device of the camera. A link in ``/dev/v4l/by-id`` keeps its name when the camera is plugged in again."""
    format: Literal["MJPG", "GREY", "YUYV", "UYVY", "NV12", "Y10", "Y16"] = "MJPG"
    """Pixel format; only the luminance is used. Bytes a pixel: MJPG about 0.2, GREY 1, NV12 1.5, others 2."""
    gain: ControlValue | None = 0
    """Gain in the camera's own units; null: the camera has no gain control."""
    focus: ControlValue | None = None
    """Focus in the camera's own units, of a camera that can move its lens; null: its default, often infinity. The
    calibration of the lens belongs to it."""
    controls: Annotated[dict[Named, ControlValue | None], Field(max_length=MANY)] = Field(default={})
    """Values of controls by the names that ``v4l2-ctl --list-ctrls`` prints, instead of those that robofleet sets
    (``configs/cameras/V4L2.md``); null: the control stays as it is."""
    stamp: StampedInstant | None = None
    """Which instant the camera's kernel driver stamps: ``start`` of the exposure, start of the ``transfer`` (taken for
    the end of the first row's exposure), or ``end`` of the transfer; null: as the driver says."""


class FilesSettings(Model):
    """A video or a folder of images (``camera.source: files``). Relative paths start at the folder in which robofleet
    is started."""

    path: Named
    """Video, or folder of images."""
    stamps: Text | None = None
    """CSV file with the times of mid-exposure, as ``robofleet/tracking/cameras/stamps.py`` describes; null: the video's
    own; of a folder, the images' names in ns."""
    rate_hz: Annotated[float, within(0.01, 1e4)] | None = None
    """Images per second, in place of these times."""


class BaslerSettings(Model):
    """A Basler camera, through pylon (``camera.source: basler``)."""

    serial: Text | None = None
    """Serial number of the camera; null: the only one that is plugged in."""
    gain: Annotated[float, within(0, 1e5)] = 0.0
    """Gain in dB; of an older camera in the units of its GainRaw."""
    trigger_source: Literal["Software", "Line1", "Line2", "Line3"] = "Software"
    """Source of the trigger with ``camera.trigger: tick``."""


class ExposureSettings(Model):
    """Aim and limits of ``camera.exposure_control: auto``."""

    white_gray: Annotated[int, within(100, 225)] = 200
    """Grey level of the white paper of the brightest tag."""
    blur_px: Annotated[float, within(0.05, 10)] = 1.0
    """Largest motion of the fastest robot's image during one exposure. It limits the exposure time; gain gives the
    rest."""
    gain: Annotated[tuple[Gain, Gain], Field(strict=False)] | None = None
    """Least and greatest gain in the camera's own units (simulated: dB); null: the camera's limits."""


class CameraSettings(Model):
    """A camera above the floor."""

    name: Name = OVERHEAD
    """Name of the camera: of its poses, pictures and process. Each of several cameras has its own."""
    source: Named = "simulated"
    """Source of the images: ``simulated``, ``mujoco``, ``v4l2``, ``files``, ``basler``, or a class as
    ``module:Class``. ``mujoco``: as ``simulated``, but MuJoCo's renderer draws floor, robots and tags."""
    model: CameraModel
    """Calibration of the camera: its lens and its pose."""
    width: Pixels
    """Width of the images in pixels."""
    height: Pixels
    """Height of the images in pixels."""
    rate_hz: Annotated[float, within(0.01, 1e4)]
    """Images per second, if the camera has a clock of its own."""
    trigger: Literal["free", "tick"] = "tick"
    """``tick``: each image is exposed ``trigger_lead_s`` before a tick. ``free``: the camera takes images at
    ``rate_hz``."""
    trigger_lead_s: Annotated[float, within(1e-6, 1)] = 0.018
    """Time from mid-exposure to the tick."""
    exposure_s: Annotated[float, within(1e-7, 1)] = 0.004
    """Exposure time of each row; with ``exposure_control: auto`` the first one."""
    exposure_control: Literal["fixed", "auto"] | None = None
    """``auto``: exposure time and gain follow the light slowly, and white paper stays below saturation. null: ``auto``
    with ``v4l2`` and ``basler``, since daylight changes too much in an hour; ``fixed`` with others, and
    with a Basler that a line triggers, since that trigger cannot move with the exposure."""
    exposure: ExposureSettings = ExposureSettings()
    """Aim and limits of ``exposure_control: auto``."""
    picture_rate_hz: Annotated[float, within(0, 1000)] = 1.0
    """Rate of the small pictures that the page shows and the recorder keeps; 0: none."""
    readout_s: Delay = 0.004
    """Time from the end of the first row's exposure to the arrival of the image."""
    noise_gray: Annotated[float, within(0, 255)] = 3.0
    """Standard deviation of a pixel's noise. With 0, two images may be equal, and equal images look like a frozen
    camera."""
    simulated: SimulatedCameraSettings = SimulatedCameraSettings()
    """Troubles of a simulated camera."""
    v4l2: V4L2Settings = V4L2Settings()
    """Settings of a camera of the Linux kernel."""
    files: FilesSettings | None = None
    """Settings for recorded images."""
    basler: BaslerSettings = BaslerSettings()
    """Settings of a Basler camera."""

    @property
    def rendered(self) -> bool:
        """Whether the images are of simulated robots."""
        return self.source in ("simulated", "mujoco")

    @property
    def adjusts_exposure(self) -> bool:
        """Whether exposure time and gain follow the light."""
        if self.exposure_control is None:
            return self.source == "v4l2" or (self.source == "basler" and not self.triggered_by_line)
        return self.exposure_control == "auto"

    @property
    def triggered_by_line(self) -> bool:
        """Whether something outside of this computer triggers a Basler camera."""
        return self.source == "basler" and self.trigger == "tick" and self.basler.trigger_source != "Software"
