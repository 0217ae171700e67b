"""The command ``track``: poses from a video, images or a camera, without a fleet and its configuration."""

import csv
import math
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import cv2
import typer
from rich.console import Console

from robofleet.bus.messages import TagPose
from robofleet.calibration.frames import live_config, open_camera
from robofleet.config.calibrated import CameraModel
from robofleet.config.files.names import SHIPPED
from robofleet.config.files.part import load_part
from robofleet.config.files.yamlfile import printable
from robofleet.core.arrays import Array
from robofleet.core.clock import S, stopwatch_ns
from robofleet.core.compiling import on_stderr, told
from robofleet.core.patterns import CONFIGURATIONS
from robofleet.core.refusal import RefusedError, need_extra, new_file
from robofleet.core.sentences import wrapped
from robofleet.gateways.videos.overlay import Overlay
from robofleet.gateways.videos.summary import Summary
from robofleet.studies.progress import bar
from robofleet.tracking.events import TrackerEvent, describe
from robofleet.tracking.sources import Camera, CameraError
from robofleet.tracking.tags import fit, motion
from robofleet.tracking.tracks import TrackedImage, Tracks
from robofleet.tracking.tracks import track as tracked

COLUMNS = (
    "t_s", "image", "tag", "x_m", "y_m", "psi_rad", "measured", "x_sigma_m", "y_sigma_m", "psi_sigma_rad",
)  # fmt: skip
_ANY = SHIPPED / "platoon.yaml"  # of which a V4L2 device takes all but itself
_STDOUT = "-"
_FILM, _PICTURE = ".mp4", ".png"
_FILM_PX, _PICTURE_PX = 1280, 3840
_USUAL_HZ = 30
_AV_LOG_QUIET = "-8"
_LINE_NS = 10 * S  # between lines that say how far a source without an end is
_MOST_TAGS = 2000
_MOST_TOLD = 10
_TOLD = {TrackerEvent.TAG_TWICE, TrackerEvent.TAG_JUMPED, TrackerEvent.TAG_MISTAKEN, TrackerEvent.TAG_CARRIED}


class _Source(NamedTuple):
    name: str
    opened: Path | Camera
    model: CameraModel | None


def track(
    source: Annotated[
        str,
        typer.Argument(
            metavar="SOURCE",
            help="A video, a folder of images, an image, a camera (0, /dev/video0), or a configuration.",
        ),
    ],
    ids: Annotated[str, typer.Option(metavar="IDS", help="The tags' numbers: 1-6, or 1,2,7.")],
    side_mm: Annotated[float, typer.Option(metavar="MM", help="Side of a tag's black square, without its white rim.")],
    camera: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The calibrated camera (cameras/NAME.yaml), for exact poses.")
    ] = None,
    fov: Annotated[
        float | None, typer.Option(metavar="DEG", help="Horizontal field of view of a camera without calibration.")
    ] = None,
    height_mm: Annotated[float, typer.Option(metavar="MM", help="Height of the tags above the floor.")] = 0.0,
    family: Annotated[str, typer.Option(metavar="NAME", help="36h11, 25h9, 16h5 or Standard41h12.")] = "36h11",
    times: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Times of the images, where file or names have none.")
    ] = None,
    rate: Annotated[float | None, typer.Option(metavar="HZ", help="Images per second, in place of all times.")] = None,
    max_speed: Annotated[
        float, typer.Option(metavar="M_S", help="Reject tags that move faster than this, in m/s.")
    ] = 2.0,
    out: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="A new CSV file, or - to print. Default: SOURCE-poses.csv; of a camera: -."),
    ] = None,
    film: Annotated[Path | None, typer.Option(metavar="FILE", help="A new .mp4 file: the images with tags.")] = None,
) -> None:
    """Measure the poses of AprilTags in a video.

    The tags lie flat, all at one height, on robots or anything else, and are seen from above. Neither a fleet nor a
    configuration is needed.

    Beside the CSV file stands a picture of what was found. Ctrl-C ends it; what was measured is kept.

    $ robofleet track robots.mp4 --ids 1-6 --side-mm 70

    $ robofleet track robots.mp4 --ids 1-6 --side-mm 70 --camera cameras/ceiling.yaml --film tags.mp4

    $ robofleet track /dev/video0 --ids 1-6 --side-mm 70 --fov 78
    """
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", _AV_LOG_QUIET)  # what is wrong is said below
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    tags = numbers(ids)
    given = _source(source, None if camera is None else load_part(camera, CameraModel))
    live = not isinstance(given.opened, Path)
    if live and (times is not None or rate is not None):
        raise RefusedError(f"{'--times' if times else '--rate'}: a camera has its own times: leave it out")
    if rate is not None and not 0.01 <= rate <= 1e4:
        raise RefusedError(f"--rate: {rate:g} is not between 0.01 and 10000 images a second")
    target = out or (_STDOUT if live else f"{Path(source).absolute().stem}-poses.csv")
    _new("--out", None if target == _STDOUT else Path(target))
    _new("--film", film)
    if film is not None:
        if film.suffix.lower() != _FILM:
            raise RefusedError(f"--film: {film}: name a file that ends with {_FILM}")
        need_extra("export", "av")
    try:
        with told((*motion.KERNELS, *fit.KERNELS), on_stderr()), Console(stderr=True).status("looking for the tags"):
            tracks = tracked(
                given.opened, ids=tags, side_m=side_mm / 1e3, camera=given.model, fov_deg=fov,
                height_m=height_mm / 1e3, family=family, times=times, rate_hz=rate, max_speed_m_s=max_speed,
            )  # fmt: skip
    except CameraError as error:
        raise RefusedError(str(error)) from error
    for note in tracks.notes:
        _say(note)
    with ExitStack() as held:
        if not isinstance(given.opened, Path):
            held.callback(given.opened.close)
        code = _written(tracks, tags, given.name, target, film, live=live)
    raise typer.Exit(code)


def numbers(text: str) -> list[int]:
    """Return the numbers of a text as 1-4,7; RefusedError."""
    tags: list[int] = []
    for part in text.split(","):
        found = re.fullmatch(r"(\d{1,5})(?:-(\d{1,5}))?", part.strip())
        first, last = (int(found[1]), int(found[2] or found[1])) if found else (1, 0)
        if first > last or len(tags) + last - first >= _MOST_TAGS:
            raise RefusedError(f"--ids: {part!r} is no number and no range: write 1-6, or 1,2,7")
        tags += range(first, last + 1)
    return list(dict.fromkeys(tags))


def _source(source: str, model: CameraModel | None) -> _Source:
    """Return what is named: a file, or a camera that is opened."""
    device = f"/dev/video{source}" if source.isdecimal() and not Path(source).exists() else source
    if Path(source).suffix in CONFIGURATIONS:
        config = live_config(Path(source))
        if config.cameras:
            raise RefusedError(f"{source}: it has several cameras: name a configuration with one of them")
    elif device.startswith("/dev/"):
        sides = {} if model is None else {"width": model.width, "height": model.height}
        size = [f"camera.{part}{side}={px}" for side, px in sides.items() for part in ("", "model.")]
        changes = "camera.source=v4l2", f"camera.v4l2.device={device}", f"camera.rate_hz={_USUAL_HZ}", *size
        config = live_config(_ANY, changes)
    else:
        return _Source(source, Path(source), model)
    opened = open_camera(config)
    if model is None and Path(source).suffix in CONFIGURATIONS:
        model = config.camera.model
    if model is not None and model.camera not in ("", opened.identity):
        opened.close()
        raise RefusedError(
            f"--camera: it is for {model.camera!r}, this camera is {opened.identity!r}: plug in that one"
        )
    return _Source(device, opened, model)


def _written(tracks: Tracks, tags: list[int], name: str, target: str, film: Path | None, *, live: bool) -> int:
    """Write the poses, and what is drawn of them, until the images end; returns the exit code."""
    overlay, summary = Overlay(tags, tracks.camera.size, Path(name).name, _PICTURE_PX), Summary(tags)
    happened: dict[tuple[int, int], str] = {}
    middle: tuple[TrackedImage, dict[int, Array]] | None = None

    def take(image: TrackedImage) -> None:
        nonlocal middle
        outlines = tracks.outlines(image.poses)
        add(image)
        overlay.add(image.t_s, outlines)
        summary.add(image.t_s, image.poses)
        if filmed is not None:
            filmed(image, outlines)
        if _is_middle(image.number, tracks.count):
            middle = image._replace(image=image.image.copy()), outlines
        for event, tag, value in image.happenings:
            if event in _TOLD:
                happened.setdefault((event, tag), f"{image.t_s:.2f} s: {describe(event, tag, value)}")
        counted()

    with ExitStack() as held:
        add = held.enter_context(_csv(target))
        filmed = None if film is None else held.enter_context(_filmed(film, tags, tracks, name))
        counted = held.enter_context(_counting(tracks.count))
        code, why = _followed(tracks, take, target, live=live)
    for line in [*happened.values()][:_MOST_TOLD] + [why] * bool(why):
        _say(line)
    Console(stderr=target == _STDOUT).print(summary.table(f"{printable(name)}: {summary.images:,} images"))
    for tag in summary.unseen:
        _say(f"tag {tag} was never seen")
    written = [] if target == _STDOUT else [Path(target)]
    if middle is not None and written:
        written.append(Path(target).with_suffix(_PICTURE))
        image, outlines = middle
        picture = overlay.drawn(image.t_s, image.image, outlines, whole=True)
        cv2.imwrite(str(written[-1]), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    for file in [*written, *([] if film is None else [film])]:
        print(printable(str(file)))
    return code


def _followed(tracks: Tracks, take: Callable[[TrackedImage], None], target: str, *, live: bool) -> tuple[int, str]:
    """Take each image; returns the exit code, and why there are no more."""
    try:
        for image in tracks:
            take(image)
    except CameraError as error:
        return 1, f"{error}; all images before it are kept"
    except OSError as error:
        return 1, f"{target}: cannot be written: {error.strerror}: make room, or name another place"
    except KeyboardInterrupt:
        return (0, "") if live else (1, "ended by Ctrl-C; all images so far are kept")
    return 0, ""


def _is_middle(number: int, count: int) -> bool:
    """Return whether an image is the middle one, or may be that, where there are not so many, or nobody counted."""
    return number == count // 2 or ((not count or number < count // 2) and number & (number + 1) == 0)


@contextmanager
def _csv(target: str) -> Iterator[Callable[[TrackedImage], None]]:
    """Give what writes the poses of an image."""
    with ExitStack() as held:
        if target == _STDOUT:
            file = sys.stdout
        else:
            file = held.enter_context(Path(target).open("x", encoding="ascii", newline=""))
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(COLUMNS)

        def add(image: TrackedImage) -> None:
            rows.writerows(_row(image, pose) for pose in image.poses)
            if target == _STDOUT:
                file.flush()

        yield add


def _row(image: TrackedImage, pose: TagPose) -> tuple[Any, ...]:
    known = pose.xx_m2 > 0.0
    sigmas = (f"{math.sqrt(v):.3g}" if known else "" for v in (pose.xx_m2, pose.yy_m2, pose.psipsi_rad2))
    t_s = image.t_s + pose.after_ns / S
    position = f"{pose.x_m:.6f}", f"{pose.y_m:.6f}", f"{pose.psi_rad:.6f}"
    return f"{t_s:.6f}", image.number, pose.tag, *position, int(pose.coasted_ns == 0), *sigmas


@contextmanager
def _filmed(file: Path, tags: list[int], tracks: Tracks, name: str) -> Iterator[Callable[[TrackedImage, Any], None]]:
    """Give what adds an image to a film."""
    from robofleet.gateways.exports import video  # noqa: PLC0415 - it needs the extra export

    overlay = Overlay(tags, tracks.camera.size, Path(name).name, _FILM_PX)
    rate_hz = Fraction(tracks.rate_hz or _USUAL_HZ).limit_denominator(1001)
    with video.mp4(file, overlay.width, overlay.height, rate_hz) as take:

        def add(image: TrackedImage, outlines: dict[int, Array]) -> None:
            overlay.add(image.t_s, outlines)
            take(overlay.drawn(image.t_s, image.image, outlines))

        yield add


@contextmanager
def _counting(count: int) -> Iterator[Callable[[], None]]:
    """Give what shows that an image is done."""
    if count:
        with bar("images", count) as shown:
            yield shown.add
        return
    done, next_ns = 0, stopwatch_ns() + _LINE_NS

    def add() -> None:
        nonlocal done, next_ns
        done += 1
        if stopwatch_ns() >= next_ns:
            next_ns = stopwatch_ns() + _LINE_NS
            print(f"images: {done:,}", file=sys.stderr, flush=True)

    yield add


def _new(option: str, file: Path | None) -> None:
    """Refuse a file that is there already, or cannot be written."""
    if file is None:
        return
    for each in (file, *([file.with_suffix(_PICTURE)] if option == "--out" else [])):
        if each.exists():
            raise RefusedError(f"{option}: {each} exists already: name another file")
    new_file(option, file)


def _say(text: str) -> None:
    print(wrapped(printable(text), sys.stderr), file=sys.stderr, flush=True)
