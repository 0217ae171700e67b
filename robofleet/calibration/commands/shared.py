"""What the commands share: how a camera, a size and a configuration's changes are given, and where pages go."""

import re
from collections.abc import Callable, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from robofleet.calibration.frames import live_config
from robofleet.calibration.store import CalibrationError
from robofleet.config.tree import Config
from robofleet.core.patterns import NAME_PATTERN
from robofleet.runs import folder as folders

if TYPE_CHECKING:
    from robofleet.calibration.robots.results import Rows

ReportFile = Annotated[
    Path | None,
    typer.Option("--report", metavar="FILE", help="File of the report. Default: runs/<time>-<name>/report.html."),
]
CameraName = Annotated[
    str,
    typer.Argument(
        metavar="CAMERA",
        help="The camera's name as in camera.model (ceiling: file cameras/ceiling.yaml), or its file, NAME.yaml.",
    ),
]
ConfigsFolder = Annotated[
    Path | None,
    typer.Option(
        "--configs", metavar="DIR", help="Folder that contains cameras/. Default: the folder of --live, else configs."
    ),
]
ConfigsRobots = Annotated[
    Path,
    typer.Option("--configs", metavar="DIR", help="Folder of the configuration; the robots' files are in robots/."),
]
Live = Annotated[
    Path | None, typer.Option(metavar="CONFIG", help="Take images now, with the camera of this configuration.")
]
Overrides = Annotated[
    list[str],
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Change a key of CONFIG, for example camera.exposure_s=0.002. Repeatable."
    ),
]

_NUMBER = r"\d{1,6}(?:\.\d{1,6})?"
_LARGEST = 1000.0


def report_file(requested: Path | None, command: str) -> Path:
    return requested or folders.new(command) / "report.html"


def live(
    config: Path | None, overrides: Sequence[str], read: Callable[[Path, Sequence[str]], Config] = live_config
) -> Config | None:
    """Return the configuration whose camera takes the images; None if files are given."""
    if config is not None:
        return read(config, overrides)
    if overrides:
        raise CalibrationError("--set: it changes a configuration: name one with --live")
    return None


def camera_file(camera: str, configs: Path | None, config: Path | None) -> Path:
    """Return the file of a camera that is given by its name or by its file; it need not be there."""
    if camera.endswith(".yaml"):
        return Path(camera)
    if not re.fullmatch(NAME_PATTERN, camera):
        raise CalibrationError(
            f"{camera!r} is not a camera: give its name (a small letter, then small letters, digits, - or _), "
            "or its file, which ends in .yaml"
        )
    return (configs or (Path("configs") if config is None else config.parent)) / "cameras" / f"{camera}.yaml"


def known_camera(camera: str, configs: Path | None, config: Path | None) -> Path:
    file = camera_file(camera, configs, config)
    if not file.exists():
        others = sorted(other.stem for other in file.parent.glob("*.yaml"))
        near = get_close_matches(file.stem, others, n=1)
        hint = f"did you mean {near[0]}?" if near else f"there are: {', '.join(others) or 'none'}"
        raise CalibrationError(f"there is no camera {file} ({hint}): `robofleet calibrate intrinsics` writes one")
    return file


def size(text: str, option: str) -> tuple[float, float]:
    """Return the two sides of ``3.5x2.3``; CalibrationError, which names the option, for anything else."""
    found = re.fullmatch(rf"\s*({_NUMBER})\s*[xX]\s*({_NUMBER})\s*", text)
    if found is None:
        raise CalibrationError(f"{option}: {text!r} is not a size: write two numbers with an x between, as 3.5x2.3")
    sides = float(found[1]), float(found[2])
    if not all(0.0 < side <= _LARGEST for side in sides):
        raise CalibrationError(f"{option}: {text!r}: each side must be more than 0 and at most {_LARGEST:g}")
    return sides


def count(text: str, option: str) -> tuple[int, int]:
    """Return columns and rows of ``11x8``; CalibrationError, which names the option, for anything else."""
    found = re.fullmatch(r"\s*(\d{1,3})\s*[xX]\s*(\d{1,3})\s*", text)
    if found is None:
        raise CalibrationError(f"{option}: {text!r} is not COLUMNSxROWS: write two whole numbers, as 11x8")
    return int(found[1]), int(found[2])


def show(table: "Rows") -> None:
    head, rows = table
    shown = Table(*head)
    for row in rows:
        shown.add_row(*map(Text, row))
    Console().print(shown)
