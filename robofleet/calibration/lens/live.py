"""Captures a board with a live camera: shows what was seen, and asks for the view that would help most."""

from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from robofleet.calibration.frames import MIRRORED
from robofleet.calibration.lens.gathering import FIRST, Gathering
from robofleet.calibration.lens.intrinsics import ARENA_MM, FOCAL, Conditions, Measured, measure
from robofleet.calibration.lens.views import COLUMNS, ROWS, Coverage, Lean, Offer
from robofleet.calibration.store import CalibrationError
from robofleet.config.files.yamlfile import Source, read_yaml
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.tracking.sources import Camera, CameraError

_ARROWS = {Lean.LEFT: "<", Lean.RIGHT: ">", Lean.UPPER: "^", Lean.LOWER: "v", Lean.FLAT: "o"}


def capture(
    camera: Camera, gathering: Gathering, conditions: Callable[[tuple[int, int]], Conditions], screen: "Screen"
) -> None:
    """Take a camera's images until its lens is determined, they end, or the operator stops it with Ctrl-C.

    ``conditions``: of a measurement, from the images' width and height [px].
    """
    measured: Measured | None = None
    try:
        while measured is None or measured.faults():
            image = camera.read().image
            offer = gathering.take(f"image {len(gathering.fates) + 1}", image)
            if offer is Offer.NEW and len(gathering.views) >= FIRST:
                measured = measure(gathering.views, conditions(gathering.size))
            screen.show(gathering, measured, offer)
    except (EOFError, KeyboardInterrupt):
        return
    except (CameraError, OSError) as error:
        raise CalibrationError(f"the camera failed: {error}: look at its cable, and start again") from error


class Screen:
    """What the operator sees while capturing; lines, one a view, where it is no terminal."""

    def __init__(self, console: Console) -> None:
        self._console, self._warned = console, False
        self._live = Live(console=console, auto_refresh=False) if console.is_terminal else None

    def __enter__(self) -> "Screen":
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, gathering: Gathering, measured: Measured | None, offer: Offer) -> None:
        if self._live is not None:
            self._live.update(picture(gathering, measured, offer), refresh=True)
        elif offer is Offer.NEW or (gathering.mirrored and not self._warned):
            self._warned = gathering.mirrored
            self._console.print(Group(*_lines(gathering, measured)))


def picture(gathering: Gathering, measured: Measured | None, offer: Offer) -> RenderableType:
    """Return the image's cells with their corners and leans, and what is wanted next."""
    parts: list[RenderableType] = [Text(f"this image: {offer.value}", "green" if offer is Offer.NEW else "yellow")]
    if measured is not None:
        parts.append(_grid(measured.coverage))
        parts.append(Text("corners seen; edge that was away: < left, > right, ^ upper, v lower, o none", "dim"))
    return Group(*parts, *_lines(gathering, measured))


def _grid(coverage: Coverage) -> Table:
    table = Table(show_header=False, show_lines=True, padding=(0, 1))
    for _ in range(COLUMNS):
        table.add_column(width=7, justify="center")
    leans = list(Lean)
    for row in range(ROWS):
        cells = []
        for column in range(COLUMNS):
            arrows = "".join(_ARROWS[lean] for k, lean in enumerate(leans) if coverage.leans[row, column, k])
            count = coverage.corners[row, column]
            style = "dim" if not coverage.needed[row, column] else "red" if coverage.empty[row, column] else "green"
            cells.append(Text(f"{count:.0f}\n{arrows}", style))
        table.add_row(*cells)
    return table


def _lines(gathering: Gathering, measured: Measured | None) -> list[Text]:
    count = f"{len(gathering.views)} views of {len(gathering.fates)} images"
    if gathering.mirrored:
        return [Text(f"{count}; {MIRRORED}", "bold red")]
    if measured is None:
        return [Text(f"{count}; next: show the board anywhere, and hold it still")]
    figures = f"places +-{measured.arena_mm:.2f} mm (wanted {ARENA_MM:g}), focal length +-{measured.focal_sigma:.2%}"
    lines = [Text(f"{count}; {figures} (wanted {FOCAL:.1%})")]
    if measured.outliers:
        lines.append(Text(f"left out: {', '.join(view.name for view, _ in measured.outliers)}", "yellow"))
    done = not measured.faults()
    lines.append(Text("done" if done else f"next: {measured.wanted}", "bold green" if done else "bold"))
    return lines


def lens_config(file: Path, overrides: Sequence[str] = ()) -> Config:
    """Read a configuration for its camera alone: whatever its model was, it is what is to be measured."""
    try:
        tree, _ = read_yaml(file, Source(str(file)))
    except FileNotFoundError:
        tree = None
    camera = None if tree is None else tree.child("camera")
    changed = {key: value for key, _, value in (override.partition("=") for override in overrides)}
    nodes = {name: None if camera is None else camera.child(name) for name in ("width", "height")}
    sides = {name: changed.get(f"camera.{name}") or (node and node.value) for name, node in nodes.items()}
    if not all(str(side).isdecimal() for side in sides.values()):
        return load_config(file, overrides)  # says what is wrong
    size = ", ".join(f"{name}: {side}" for name, side in sides.items())
    pose = "T_world_camera: {position_m: [0.0, 0.0, 1.0], rotation_rad: [3.0, 0.0, 0.0]}"
    nominal = f"{{{size}, focal_px: [1000.0, 1000.0], centre_px: [0.0, 0.0], distortion: [], {pose}}}"
    return load_config(file, [*overrides, f"camera.model={nominal}"])
