"""The commands ``export`` and ``film``: a recorded run in files of other programs."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Annotated

import typer
from rich.console import Console

from robofleet.config.files.yamlfile import printable
from robofleet.config.tree import Config
from robofleet.core.refusal import RefusedError, need_extra, new_place
from robofleet.recording.reading import about
from robofleet.reports.commands import Modules, RunFolder, importing, readable
from robofleet.runs.folder import chosen
from robofleet.studies.progress import bar

FORMATS = {"csv": ("pyarrow",), "parquet": ("pyarrow",), "rosbag2": ("rosbags",), "lerobot": ("av", "pyarrow")}
_VIDEO, _GIF = ".mp4", ".gif"
_VIEWS = ("camera", "arena")
_FLUENT_HZ = 5.0  # a camera's images that come less often are no film
_WIDTHS_PX = 160, 3840


def export(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN...", help="The run's folder, or its run.mcap.")],
    to: Annotated[str, typer.Option(metavar="FORMAT", help="csv, parquet, rosbag2 or lerobot.")],
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="A new folder; default: RUN/FORMAT.")] = None,
    task: Annotated[
        str | None, typer.Option(metavar="TEXT", help="lerobot: what the robots do; default: their behaviours' names.")
    ] = None,
    behaviours: Modules = None,
) -> None:
    """Write a run as tables, ROS 2 bag or LeRobot dataset.

    Several runs become one LeRobot dataset, each with its episodes. Runs that were killed can be exported too.

    $ robofleet export runs/20260102T030405Z-platoon --to parquet

    $ robofleet export runs/20260102T030405Z-platoon runs/20260102T030707Z-platoon --to lerobot --out dataset
    """
    if to not in FORMATS:
        raise RefusedError(f"--to: {to!r} is not known: take one of {', '.join(FORMATS)}")
    need_extra("export", *FORMATS[to])
    if len(runs) > 1 and to != "lerobot":
        raise RefusedError(f"--to {to}: it is made of one run: name one run")
    if len(runs) > 1 and out is None:
        raise RefusedError("--out: name the folder of a dataset of several runs")
    if task is not None and to != "lerobot":
        raise RefusedError(f"--task: {to} has no tasks: leave it out")
    with readable():
        about(runs[0])
        target = out or _beside(runs[0], to)
        with importing(behaviours) as imports, _whole(target) as folder:
            if to in {"csv", "parquet"}:
                from robofleet.gateways.exports import tables  # noqa: PLC0415 - only where its packages are needed

                with Console(stderr=True).status(f"{to} ..."):
                    (tables.write_csv if to == "csv" else tables.write_parquet)(runs[0], folder, imports)
            elif to == "rosbag2":
                from robofleet.gateways.exports import rosbag2  # noqa: PLC0415

                with Console(stderr=True).status(f"{to} ..."):
                    rosbag2.write(runs[0], folder)
            else:
                _lerobot(runs, folder, task)
    print(printable(str(target)))


def _lerobot(runs: Sequence[Path], folder: Path, task: str | None) -> None:
    from robofleet.gateways.exports import lerobot  # noqa: PLC0415

    episodes = lerobot.episodes(runs, task)
    with _counting() as counting:
        lerobot.write(episodes, folder, counting)


def film(
    run: RunFolder = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A new .mp4 or .gif file; default: RUN/film.mp4.")
    ] = None,
    from_s: Annotated[
        float, typer.Option("--from", metavar="S", help="Start of the film, in seconds after the first tick.")
    ] = 0,
    to_s: Annotated[
        float | None, typer.Option("--to", metavar="S", help="End of the film, in seconds after the first tick.")
    ] = None,
    speed: Annotated[float, typer.Option(metavar="X", help="Speed of the film; 2 is twice as fast as the run.")] = 1.0,
    width: Annotated[int, typer.Option(metavar="PX", help="Width of the film.")] = 1280,
    view: Annotated[
        str | None,
        typer.Option(metavar="VIEW", help="camera or arena; default: camera, if it has 5 images per second or more."),
    ] = None,
    camera: Annotated[str | None, typer.Option(metavar="NAME", help="Which of several cameras.")] = None,
    title: Annotated[
        str | None, typer.Option(metavar="TEXT", help="Words above it; default: the arena's name.")
    ] = None,
) -> None:
    """Make a film of a run: MP4 or GIF.

    It shows the camera's images, or the arena, with robots, trails and references.

    A camera's film is fluent if the run recorded enough images: `--set camera.picture_rate_hz=15`.

    $ robofleet film runs/20260102T030405Z-platoon --speed 4

    $ robofleet film runs/20260102T030405Z-platoon --out lap.gif --view arena --speed 8 --width 720
    """
    run = chosen(run)
    target = out or _beside(run, "film.mp4")
    ending = target.suffix.lower()
    if ending not in {_VIDEO, _GIF}:
        raise RefusedError(f"--out: {target}: name a file that ends with {_VIDEO} or {_GIF}")
    need_extra("export", "av")
    _within("--speed", speed, 0.01, 1000)
    _within("--width", width, *_WIDTHS_PX)
    if view is not None and view not in _VIEWS:
        raise RefusedError(f"--view: {view!r} is not known: take one of {', '.join(_VIEWS)}")
    with readable():
        from robofleet.gateways.exports.film import Wanted, make  # noqa: PLC0415

        config = about(run).config
        wanted = Wanted(
            from_s=from_s, to_s=to_s, speed=speed, width=width, title=title or config.arena.name,
            camera=_camera(run, config, view, camera),
        )  # fmt: skip
        with _whole(target) as file, _counting() as counting:
            make(run, file, wanted, counting)
    print(printable(str(target)))


def _camera(run: Path, config: Config, view: str | None, name: str | None) -> Config | None:
    """Return the view of the camera whose images are shown; None: the arena is drawn."""
    found = {each.camera.name: each for each in config.views}
    if name is not None and name not in found:
        raise RefusedError(f"--camera: there is no {name!r}: take one of {', '.join(found)}")
    has_images = config.tracker.source == "camera" and config.camera.picture_rate_hz > 0
    if view == "camera" and not has_images:
        raise RefusedError(f"{run}: it has no images of a camera: take --view arena")
    fluent = has_images and config.camera.picture_rate_hz >= _FLUENT_HZ
    if view == "arena" or not (view == "camera" or name is not None or fluent):
        return None
    return found[name or config.camera_names[0]]


def _within(option: str, value: float, least: float, most: float) -> None:
    if not least <= value <= most:
        raise RefusedError(f"{option}: {value:g} is not between {least:g} and {most:g}")


def _beside(run: Path, name: str) -> Path:
    return (run if run.is_dir() else run.parent) / name


@contextmanager
def _counting() -> Iterator[Callable[[int], Callable[[], None]]]:
    """Give what shows, for so many images, how many are done."""
    with ExitStack() as shown:
        yield lambda total: shown.enter_context(bar("images", total)).add


@contextmanager
def _whole(target: Path) -> Iterator[Path]:
    """Give a path to write to, which takes the target's place in the end, if nothing is raised."""
    if os.path.lexists(target):
        raise RefusedError(f"--out: {target} exists already: name another place")
    new_place("--out", target.parent)
    beside = Path(mkdtemp(prefix=".", suffix=".new", dir=target.parent))
    try:
        yield beside / target.name
        (beside / target.name).rename(target)
    except OSError as error:
        raise RefusedError(
            f"{target}: cannot be written: {error.strerror or error}: make room, or name another place"
        ) from error
    finally:
        rmtree(beside, ignore_errors=True)
