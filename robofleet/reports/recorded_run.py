"""A recorded run in Python: ``robofleet.load``. What nobody asks for is not read."""

from collections.abc import Iterator, Mapping
from functools import cached_property, partial
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.keys import PICTURE, TICK, key
from robofleet.bus.messages import PICTURE as PICTURE_LAYOUT
from robofleet.config.faults import did_you_mean
from robofleet.config.tree import Config
from robofleet.core.refusal import RefusedError
from robofleet.recording.reading import about, file_of, imported, trouble_of
from robofleet.recording.reading import parts as recording_parts
from robofleet.reports import after, run_tables
from robofleet.reports.run_tables import Library
from robofleet.reports.sampled import looks
from robofleet.tracking.pictures import picture_size

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
        """Read what the run is made of; as ``load``."""
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
        return after.stored(self._run) or after.summary(self._run, self._imports)

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
            RobofleetError: There is no such camera, or the file cannot be read.
        """
        names = self.config.camera_names
        if camera is not None and camera not in names:
            raise RefusedError(f"{self._run}: there is no camera {camera!r}: {did_you_mean(camera, names)}")
        return self._images(
            {key(self.config.arena.name, PICTURE, name): name for name in names if camera in {None, name}}
        )

    def _images(self, cameras: Mapping[str, str]) -> Iterator[RecordedImage]:
        start_ns = self._start_ns
        sizes = {
            view.camera.name: picture_size(view.camera.model.width, view.camera.model.height)
            for view in self.config.views
        }
        for recording, own in recording_parts(self._run, self._imports, topics=(PICTURE,)):
            placed = [
                (place, name, payload)
                for full, name in cameras.items()
                for place, payload in recording.placed(full)
                if own.first <= place < own.until
            ]
            for _, name, payload in sorted(placed):
                picture = PICTURE_LAYOUT.decode(payload)
                if picture is not None and (image := _decoded(picture.jpeg, sizes[name])) is not None:
                    yield RecordedImage((picture.exposure_ns - start_ns) / 1e9, name, image)

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
