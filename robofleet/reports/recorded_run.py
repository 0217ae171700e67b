"""A recorded run in Python: ``robofleet.load``. What nobody asks for is not read."""

from collections.abc import Iterator, Mapping
from functools import cached_property, partial
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.keys import NOTE, PICTURE, TICK, key
from robofleet.bus.messages import PICTURE as PICTURE_LAYOUT
from robofleet.bus.notes import Marks
from robofleet.config.faults import did_you_mean
from robofleet.config.tree import Config
from robofleet.core.refusal import RefusedError
from robofleet.recording import notes
from robofleet.recording.reading import about, file_of, imported, trouble_of
from robofleet.recording.reading import parts as recording_parts
from robofleet.reports import run_tables
from robofleet.reports.arena_card import BAD, GOOD, TRAIL_POINTS, TRAIL_S, WAITING, ArenaView, Card
from robofleet.reports.run_tables import Library
from robofleet.reports.sampled import looks

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BEGINNING = 1 << 16  # [bytes] of messages among which the run's first tick is looked for


class RecordedImage(NamedTuple):
    """A camera's image of a recorded run.

    Attributes:
        t_s: Mid-exposure, since the run's first tick [s]; negative: before it.
        camera: The camera's name.
        image: (H, W) grey values 0 to 255, at most 1280 wide.
    """

    t_s: float
    camera: str
    image: NDArray[np.uint8]


class RecordedRun:
    """A run that was recorded, as ``robofleet.load`` returns it.

    Each table and each image is read from the file when it is asked for, and is not kept here.
    """

    def __init__(self, run: str | Path, behaviours: str | Path | None = None) -> None:
        """Open it; ``robofleet.load`` is the same.

        Args:
            run: The run's folder, or its ``run.mcap``.
            behaviours: The folder of your own behaviours' modules.
        """
        self._run = Path(run)
        folder = None if behaviours is None else Path(behaviours)
        self._imports = partial(imported, folder)
        self._about = about(self._run, self._imports)

    def __repr__(self) -> str:
        """Return where it is, and who drove."""
        return f"<RecordedRun {self.file}: {', '.join(self.robots)}>"

    @property
    def file(self) -> Path:
        """The recording, ``run.mcap``."""
        return file_of(self._run)

    @property
    def config(self) -> Config:
        """The run's configuration."""
        return self._about.config

    @property
    def robots(self) -> tuple[str, ...]:
        """The robots of all groups, group by group."""
        return tuple(robot.id for robot in self.config.members)

    @property
    def groups(self) -> Mapping[str, tuple[str, ...]]:
        """The robots of each group, by the groups' names."""
        return {group.name: group.robots for group in self._about.groups}

    @property
    def tables(self) -> tuple[str, ...]:
        """The names of the tables."""
        return run_tables.names(self._about.groups)

    @cached_property
    def trouble(self) -> str | None:
        """Why the recording ends too early; None: it is whole. Everything before that place is read."""
        return trouble_of(self._run)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """What ``summary.json`` holds. Where it is missing, as after a kill, it is made anew from the recording."""
        from robofleet.reports import after  # noqa: PLC0415 - it loads what reports are drawn with

        return after.stored(self._run) or after.viewed(self._run, self._imports).summary

    @property
    def duration_s(self) -> float:
        """How long the run drove [s]."""
        return float(self.summary["duration_s"])

    def table(self, name: str, *, library: Library | None = None) -> Any:
        """Read a table.

        Args:
            name: ``poses``, ``commands``, ``ticks``, ``stops``, or the name of a group. ``tables`` lists them.
            library: ``pandas``, ``polars`` or ``numpy``. None: the first of these that is installed.

        Returns:
            A DataFrame; for numpy a dict of arrays by the columns' names.

        Raises:
            RobofleetError: There is no such table, the library is not installed, or the file cannot be read.
        """
        library = run_tables.chosen(library)
        parts = run_tables.parts(self._run, self._about.groups, name, self._imports)
        return run_tables.frame(run_tables.joined(parts), library)

    def images(self, camera: str | None = None) -> Iterator[RecordedImage]:
        """Read the camera's images that were recorded, in order: one every ``camera.picture_rate_hz``.

        Args:
            camera: Only this one of several cameras.

        Yields:
            The time, the camera and the image.

        Raises:
            RefusedError: There is no such camera.
            RecordingError: The file cannot be read.
        """
        names = self.config.camera_names
        if camera is not None and camera not in names:
            raise RefusedError(f"{self._run}: there is no camera {camera!r}: {did_you_mean(camera, names)}")
        return self._images(
            {key(self.config.arena.name, PICTURE, name): name for name in names if camera in {None, name}}
        )

    def _images(self, cameras: Mapping[str, str]) -> Iterator[RecordedImage]:
        from robofleet.tracking.pictures import picture_size  # noqa: PLC0415 - it loads OpenCV

        start_ns = self._start_ns
        sizes = {
            view.camera.name: picture_size(view.camera.model.width, view.camera.model.height)
            for view in self.config.views
        }
        for recording, own in recording_parts(self._run, self._imports, topics=(PICTURE,)):
            payloads = sorted(
                (at, name, payload)
                for full, name in cameras.items()
                for at, payload in recording.placed(full)
                if own.first <= at < own.until
            )
            for _, name, payload in payloads:
                picture = PICTURE_LAYOUT.decode(payload)
                if picture is not None and (image := _decoded(picture.jpeg, sizes[name])) is not None:
                    yield RecordedImage((picture.exposure_ns - start_ns) / 1e9, name, image)

    def plot(self) -> "Figure":
        """Draw the floor with every robot's path, and the groups' errors over time.

        Returns:
            A matplotlib figure; ``figure.axes`` has the floor, then one for each error.
        """
        from robofleet.reports import after, notebook_figures  # noqa: PLC0415 - they load matplotlib

        return notebook_figures.of_run(after.viewed(self._run, self._imports))

    def _repr_html_(self) -> str:
        """Return where the robots were at the end, and the figures at a glance."""
        from robofleet.reports.report import tiles  # noqa: PLC0415 - it loads matplotlib

        summary, outcome = self.summary, self.summary["outcome"]
        state = [
            f"{outcome} after {self.duration_s:.1f} s",
            summary["cause"],
            self.trouble and f"the file {self.trouble}",
        ]
        return Card(
            title=self._run.resolve().name,
            state=": ".join(filter(None, state)),
            colour={"completed": GOOD, "fault": BAD}.get(outcome, WAITING),
            arena=self._end,
            heads=("figure", "value", "unit", "bound"),
            rows=[(tile.label, tile.value, tile.unit, tile.note.text) for tile in tiles(summary) if tile.value != "–"],
        ).html()

    @cached_property
    def _end(self) -> ArenaView:
        """Where everything was when the run ended."""
        step = max(1, round(TRAIL_S / TRAIL_POINTS / self.config.controller.tick_s))
        robots = len(self.robots)
        trails, pose, references = (np.full(shape, np.nan) for shape in ((1, robots, 2), (robots, 3), (robots, 2)))
        marks = {name: Marks() for name in self.groups}
        for part in looks(self._run, self._imports, topics=(TICK, NOTE)):
            for name, of_group in marks.items():
                for note in notes.of_group(part.recording, name, part.own):
                    if note.mark is not None:
                        of_group.take(note.mark)
            if len(part.ticks):
                poses = part.poses()
                trails = np.concatenate([trails, poses[::step, :, :2]])[-TRAIL_POINTS:]
                pose, references = poses[-1], part.references[-1]
        shapes = [shape for group in self._about.groups for shape in (*group.shapes, *marks[group.name].shapes)]
        return ArenaView(config=self.config, shapes=shapes, poses=pose, trails=trails, references=references)

    @cached_property
    def _start_ns(self) -> int:
        parts = looks(self._run, self._imports, _BEGINNING, (TICK,))
        return next((part.start_ns for part in parts if part.start_ns is not None), 0)


def load(run: str | Path, *, behaviours: str | Path | None = None) -> RecordedRun:
    """Open a recorded run: its tables, its images, its figures. Also of a run that was killed.

    Args:
        run: The run's folder, or its ``run.mcap``.
        behaviours: The folder of your own behaviours' modules, if the run had such. Without it only what they measure
            after a run is missing.

    Returns:
        The run.

    Raises:
        RobofleetError: There is no recording, or it is of another version.
    """
    return RecordedRun(run, behaviours)


def _decoded(jpeg: bytes, size: tuple[int, int]) -> NDArray[np.uint8] | None:
    """Return a picture of this size; None where it is another one, or none: a stranger's may fill the memory."""
    from PIL import Image  # noqa: PLC0415 - tables need none

    try:
        with Image.open(BytesIO(jpeg), formats=("JPEG",)) as picture:
            return np.asarray(picture.convert("L")) if picture.size == size else None
    except (OSError, ValueError, Image.DecompressionBombError):
        return None
