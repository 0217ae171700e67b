"""Projectors above the floor: what is known of each, and what a simulated one really is."""

from collections.abc import Iterator
from typing import Annotated, Literal, get_args

from pydantic import Field

from robofleet.config.calibrated import Coefficient, Focal, Pixel, PoseSettings, Provenance
from robofleet.core.settings import Delay, Fraction, Model, Name, Pixels, Text, within

Complaint = tuple[str, str]  # dotted path, what is wrong and how to mend it
Shown = Literal[
    "floor", "grid", "paths", "references", "trails", "halos", "barrier", "names", "countdown", "background", "large"
]  # fmt: skip


def shown(words: bytes) -> tuple[str, ...] | None:
    """Return what is shown from its words; None where a word is none of ``Shown``."""
    show = tuple(words.decode(errors="replace").split())
    return show if set(show) <= set(get_args(Shown)) else None


class ProjectorOptics(Model):
    """A projector's lens, pose and delay: a camera whose light goes the other way."""

    width: Pixels
    """Width of its picture in pixels."""
    height: Pixels
    """Height of its picture in pixels."""
    focal_px: Annotated[tuple[Focal, Focal], Field(strict=False)]
    """Focal lengths along x and along y."""
    centre_px: Pixel
    """Principal point. Integer coordinates are the centres of pixels. It is far from the middle where a projector
    shifts its lens."""
    distortion: Annotated[tuple[Coefficient, Coefficient, Coefficient, Coefficient], Field(strict=False)]
    """OpenCV's coefficients k1 k2 p1 p2 of the way from the floor to the picture."""
    T_world_projector: PoseSettings
    """Pose of the projector: x to its picture's right, y down, z along its light."""
    delay_s: Delay = 0.0
    """Time from a picture's drawing until its light is on the floor."""


class ProjectorModel(ProjectorOptics):
    """A calibrated projector (a file of ``projectors``)."""

    calibrated: Provenance | None = None
    """How it was measured."""


class SimulatedProjectorSettings(Model):
    """What a simulated projector is. Its light falls on floor, tags and robots that the simulated cameras see."""

    model: ProjectorOptics
    """Its true lens and pose. Its ``delay_s`` is the projector's own, two to four pictures long."""
    brightness: Annotated[float, within(0.001, 100)] = 0.5
    """Light of a white picture in its middle, as a share of the room's full light."""
    black: Fraction = 0.002
    """Light of a black picture, as a share of a white one's."""
    gamma: Annotated[float, within(0.2, 5)] = 2.2
    """Power by which light grows with grey levels."""
    vignetting: Annotated[float, within(0, 0.9)] = 0.0
    """Share of the light that the picture's corners lack."""
    rate_hz: Annotated[float, within(1, 240)] = 60.0
    """Pictures of a run a second."""
    focus_px: Annotated[float, within(0.01, 200)] = 0.5
    """Standard deviation of the Gaussian that a pixel becomes on the floor, in pixels of the projector."""


class ProjectorSettings(Model):
    """A projector that lights the floor."""

    name: Name
    """Name of the projector. Each has its own."""
    width: Pixels
    """Width of its picture in pixels."""
    height: Pixels
    """Height of its picture in pixels."""
    calibration: ProjectorModel | None = None
    """What ``robofleet calibrate projector`` measured; null: not calibrated."""
    host: Text = "127.0.0.1"
    """Address at which its page is served. The browser of another computer reaches 127.0.0.1 through ``ssh -L``."""
    port: Annotated[int, Field(ge=1024, le=65535)] = 8420
    """TCP port of its page."""
    brightness: Fraction = 1.0
    """Grey of what a run's picture shows, as a share of white. Lower it where the light is too much for the cameras."""
    disc_gray: Fraction = 0.4
    """Constant grey of the disc around each robot, in which its tag is seen, as a share of white."""
    simulated: SimulatedProjectorSettings | None = None
    """A simulated projector in place of a browser's; null: a browser shows the pictures."""


class ProjectionSettings(Model):
    """What projectors show of a run, all the same; an operator changes it during the run."""

    show: Annotated[tuple[Shown, ...], Field(max_length=len(get_args(Shown)), strict=False)] = (
        "floor", "paths", "references", "trails", "halos", "names", "countdown", "background",
    )  # fmt: skip
    """``floor``: its edge, obstacles and keep-out zones. ``paths``: what groups and scripts draw: paths, goals, ways,
    marks. ``references``: where each robot is to be, and where it goes. ``halos``: a ring around each robot, its
    heading. ``barrier``: the discs that the barrier keeps apart. ``names``: with what a robot is stopped by.
    ``countdown``: the time that is left. ``large``: all of it twice as large, to be read from afar."""
    background: Text | None = None
    """An image that fills the arena: PNG, JPEG or WebP. A relative path starts at the folder in which robofleet
    starts."""


def complaints(projectors: tuple[ProjectorSettings, ...], cameras: tuple[tuple[str, str], ...]) -> Iterator[Complaint]:
    """Yield what is wrong with projectors, and between them; ``cameras``: path and source of each."""
    names: dict[str, int] = {}
    for i, projector in enumerate(projectors):
        path = f"projectors.{i}"
        if (first := names.setdefault(projector.name, i)) != i:
            yield f"{path}.name", f"{projector.name} is projectors.{first}'s already: give each its own name"
        simulated = projector.simulated
        models = ("calibration", projector.calibration), ("simulated.model", simulated and simulated.model)
        for key, model in models:
            if model and (model.width, model.height) != (projector.width, projector.height):
                taken, other = f"{projector.width} x {projector.height}", f"{model.width} x {model.height}"
                yield f"{path}.{key}", f"is for pictures of {other} px, not {taken}: mend one, or calibrate again"
        for camera, source in cameras if simulated else ():
            if source == "mujoco":
                yield f"{camera}.source", f"'mujoco' shows no light of {path}: take 'simulated'"
