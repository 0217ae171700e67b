"""Recorded runs as a LeRobot dataset, version 3.0, without LeRobot: each stretch of driving is an episode.

A row stands at each tick of the controller's grid, and has the newest image that was exposed until then.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import parquet

from robofleet.bus.keys import STATUS, TICK
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.core.files import write_text
from robofleet.core.refusal import RefusedError
from robofleet.core.valid_json import dumps
from robofleet.gateways.exports.video import encoder, mp4
from robofleet.recording.columns import COLUMNS
from robofleet.reports.recorded_run import RecordedImage, RecordedRun
from robofleet.reports.sampled import looks
from robofleet.tracking.pictures import picture_size

STATE = ("x_m", "y_m", "psi_rad", "left_measured_rad_s", "right_measured_rad_s")
ACTION = ("left_commanded_rad_s", "right_commanded_rad_s")
_STOOD_S = 1.0  # without a tick of a run that drives: another episode begins
_FILES_IN_CHUNK = 1000
_PATH = "chunk-{chunk_index:03d}/file-{file_index:03d}"
_DATA, _VIDEO = f"data/{_PATH}.parquet", f"videos/{{video_key}}/{_PATH}.mp4"
_KEYFRAME_EVERY = 2  # images: whoever trains reads them in any order
_QUANTILES = (0.01, 0.1, 0.5, 0.9, 0.99)
_SAMPLED_IMAGES, _SAMPLED_PIXEL = 100, 8  # of an episode, for its statistics: so many images, each n-th pixel
_COUNTERS = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
_CODECS = {"libx264": "h264", "libopenh264": "h264"}

Counter = Callable[[], None]


@dataclass(frozen=True, kw_only=True)
class Episode:
    """A stretch in which the fleet drove without a rest."""

    run: RecordedRun
    t_s: Array  # (K,) of its rows, since the run's first tick
    state: NDArray[np.float32]  # (K, n)
    action: NDArray[np.float32]
    task: str


class _Camera(NamedTuple):
    key: str  # of its feature
    name: str
    width: int
    height: int


def episodes(runs: Sequence[Path], task: str | None = None) -> list[Episode]:
    """Return the episodes of some runs.

    ``task``: what the robots were to do, in words; None: the names of the groups' behaviours.

    Raises:
        RecordingError: A recording cannot be read.
        RefusedError: The runs differ in robots, cameras or tick, or nobody drove.
    """
    recorded = [RecordedRun(run) for run in runs]
    for run, other in zip(runs[1:], recorded[1:], strict=True):
        if _kind(other.config) != _kind(recorded[0].config):
            raise RefusedError(f"{run}: its robots, cameras or tick differ from those of {runs[0]}: export it alone")
    found = [episode for run in recorded for episode in _episodes(run, task)]
    if not found:
        raise RefusedError(f"{runs[0]}: no robot drove in it: there is no episode")
    return found


def write(
    episodes: Sequence[Episode], folder: Path, counting: Callable[[int], Counter] = lambda _: lambda: None
) -> None:
    """Write the dataset of episodes of runs of one kind, into a folder that is not there yet.

    ``counting``: returns, for so many images, what is called for each.

    Raises:
        RecordingError: A recording cannot be read.
        RefusedError: A camera has no image.
        OSError: A file cannot be written.
    """
    config = episodes[0].run.config
    tasks = list(dict.fromkeys(episode.task for episode in episodes))
    cameras, rate_hz = _cameras(config), 1 / Fraction(str(config.controller.tick_s))
    total, rows, everything = 0, list[dict[str, Any]](), dict[str, list[Array]]()
    shots = _Shots(cameras, folder, rate_hz, counting(len(cameras) * sum(len(episode.t_s) for episode in episodes)))
    for number, episode in enumerate(episodes):
        chunk, file = divmod(number, _FILES_IN_CHUNK)
        at = {"chunk_index": chunk, "file_index": file}
        columns = _columns(episode, number, total, tasks.index(episode.task), rate_hz)
        _write_rows(columns, folder / _DATA.format(**at))
        measured = columns | shots.write(episode, at)
        total += len(episode.t_s)
        rows.append(_row(episode, number, total, at, cameras, rate_hz) | _flat(_statistics(measured)))
        for key, values in measured.items():
            everything.setdefault(key, []).append(values)
    _write(
        folder / "meta" / "episodes" / (_PATH.format(chunk_index=0, file_index=0) + ".parquet"),
        pa.Table.from_pylist(rows),
    )
    _write(folder / "meta" / "tasks.parquet", _tasks(tasks))
    joined = {key: np.concatenate(values) for key, values in everything.items()}
    write_text(folder / "meta" / "stats.json", dumps(_statistics(joined), indent=2))
    info = {
        "codebase_version": "v3.0", "robot_type": config.members[0].driver, "total_episodes": len(episodes),
        "total_frames": total, "total_tasks": len(tasks), "chunks_size": _FILES_IN_CHUNK,
        "data_files_size_in_mb": 100, "video_files_size_in_mb": 200, "fps": _number(rate_hz),
        "splits": {"train": f"0:{len(episodes)}"}, "data_path": _DATA, "video_path": _VIDEO if cameras else None,
        "features": _features(config, cameras, rate_hz),
    }  # fmt: skip
    write_text(folder / "meta" / "info.json", dumps(info, indent=2))


def _kind(config: Config) -> tuple[Any, ...]:
    return config.controller.tick_s, [robot.id for robot in config.members], _cameras(config)


def _cameras(config: Config) -> list[_Camera]:
    if config.tracker.source != "camera" or not config.camera.picture_rate_hz:
        return []
    found = []
    for view in config.views:
        width, height = picture_size(view.camera.model.width, view.camera.model.height)
        name = view.camera.name
        found.append(_Camera(f"observation.images.{name}", name, width // 2 * 2, height // 2 * 2))
    return found


def _episodes(run: RecordedRun, task: str | None) -> Iterator[Episode]:
    """Yield the stretches of a run; a tick that the controller missed repeats the one before."""
    columns = {column.name: column for column in COLUMNS}
    parts = [
        (part.ticks["tick"].astype(np.int64), part.clock_time_s, *(
            np.stack([columns[name].values(part) for name in names], axis=-1).reshape(len(part.ticks), -1)
            for names in (STATE, ACTION)
        ))
        for part in looks(run.file, topics=(TICK, STATUS))
    ]  # fmt: skip
    ticks, t_s, state, action = (np.concatenate(column) for column in zip(*parts, strict=True))
    tick_s = run.config.controller.tick_s
    words = task or ", ".join(dict.fromkeys(group.behaviour for group in run.config.groups))
    for stretch in np.split(np.arange(len(ticks)), np.flatnonzero(np.diff(ticks) * tick_s > _STOOD_S) + 1):
        if not len(stretch):
            continue
        grid = np.arange(ticks[stretch[0]], ticks[stretch[-1]] + 1)
        rows = stretch[np.searchsorted(ticks[stretch], grid, "right") - 1]
        yield Episode(
            run=run, t_s=t_s[stretch[0]] + (grid - grid[0]) * tick_s, state=state[rows].astype(np.float32),
            action=action[rows].astype(np.float32), task=words,
        )  # fmt: skip


def _columns(episode: Episode, number: int, first: int, task: int, rate_hz: Fraction) -> dict[str, NDArray[Any]]:
    count = np.arange(len(episode.t_s))
    counters = {
        "timestamp": count * float(1 / rate_hz), "frame_index": count, "episode_index": np.full_like(count, number),
        "index": first + count, "task_index": np.full_like(count, task),
    }  # fmt: skip
    return {"observation.state": episode.state, "action": episode.action} | {
        key: counters[key].astype(dtype) for key, dtype in _COUNTERS.items()
    }


def _write_rows(columns: dict[str, NDArray[Any]], file: Path) -> None:
    arrays = {
        key: pa.array(values) if values.ndim == 1
        else pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
        for key, values in columns.items()
    }  # fmt: skip
    _write(file, pa.table(arrays))


def _write(file: Path, table: pa.Table) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(table, str(file))


class _Shots:
    """Writes the videos of episodes, which come in the order of their runs."""

    def __init__(self, cameras: Sequence[_Camera], folder: Path, rate_hz: Fraction, counted: Counter) -> None:
        self._cameras, self._folder, self._rate_hz, self._counted = cameras, folder, rate_hz, counted
        self._run: RecordedRun | None = None
        self._newest: dict[str, _Newest] = {}

    def write(self, episode: Episode, at: dict[str, int]) -> dict[str, Array]:
        """Write an episode's videos; returns of each some pixels [0, 1] (n, 1), for its statistics."""
        if episode.run is not self._run:
            self._run = episode.run
            self._newest = {camera.key: _Newest(episode.run, camera) for camera in self._cameras}
        return {camera.key: self._video(episode.t_s, camera, at) for camera in self._cameras}

    def _video(self, t_s: Array, camera: _Camera, at: dict[str, int]) -> Array:
        file = self._folder / _VIDEO.format(video_key=camera.key, **at)
        file.parent.mkdir(parents=True, exist_ok=True)
        pixels, every = [], max(1, len(t_s) // _SAMPLED_IMAGES)
        with mp4(file, camera.width, camera.height, self._rate_hz, keyframe_every=_KEYFRAME_EVERY) as add:
            for row, t in enumerate(t_s.tolist()):
                image = self._newest[camera.key].at(t)[: camera.height, : camera.width]
                add(image)
                self._counted()
                if row % every == 0:
                    pixels.append(image[::_SAMPLED_PIXEL, ::_SAMPLED_PIXEL].reshape(-1, 1) / 255.0)
        return np.concatenate(pixels)


class _Newest:
    """The newest image of a camera at instants that only rise."""

    def __init__(self, run: RecordedRun, camera: _Camera) -> None:
        self._images: Iterator[RecordedImage] = run.images(camera.name)
        self._next = next(self._images, None)
        if self._next is None:
            raise RefusedError(
                f"{run.file}: there is no image of {camera.name}: record some with camera.picture_rate_hz"
            )
        self._image = self._next.image

    def at(self, t: float) -> NDArray[np.uint8]:
        """Return the newest image exposed until ``t``; the first one before it was exposed."""
        while self._next is not None and self._next.t_s <= t:
            self._image, self._next = self._next.image, next(self._images, None)
        return self._image


def _row(
    episode: Episode, number: int, end: int, at: dict[str, int], cameras: Sequence[_Camera], rate_hz: Fraction
) -> dict[str, Any]:
    """Return what the table of episodes says of one that ends before row ``end``."""
    count = len(episode.t_s)
    row = {
        "episode_index": number, "tasks": [episode.task], "length": count, "dataset_from_index": end - count,
        "dataset_to_index": end, "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0,
        **{f"data/{key}": value for key, value in at.items()},
    }  # fmt: skip
    for camera in cameras:
        video = at | {"from_timestamp": 0.0, "to_timestamp": float(count / rate_hz)}
        row |= {f"videos/{camera.key}/{key}": value for key, value in video.items()}
    return row


def _statistics(columns: dict[str, NDArray[Any]]) -> dict[str, dict[str, Any]]:
    """Return smallest and largest value, mean, deviation and quantiles of each feature; unknown values do not count."""
    found = {}
    for key, values in columns.items():
        figures = {
            "min": np.nanmin(values, axis=0), "max": np.nanmax(values, axis=0), "mean": np.nanmean(values, axis=0),
            "std": np.nanstd(values, axis=0),
        }  # fmt: skip
        quantiles = np.nanquantile(values, _QUANTILES, axis=0)
        figures |= {f"q{round(100 * q):02d}": row for q, row in zip(_QUANTILES, quantiles, strict=True)}
        shape = (3, 1, 1) if key.startswith("observation.images.") else None
        found[key] = {
            name: (np.atleast_1d(figure) if shape is None else np.broadcast_to(figure, shape)).astype(float).tolist()
            for name, figure in figures.items()
        } | {"count": [len(values)]}
    return found


def _flat(statistics: dict[str, dict[str, Any]]) -> dict[str, Any]:
    return {f"stats/{key}/{name}": value for key, figures in statistics.items() for name, value in figures.items()}


def _tasks(tasks: Sequence[str]) -> pa.Table:
    """Return the table of tasks, whose index pandas makes of the words."""
    table = pa.table({"task_index": pa.array(range(len(tasks)), pa.int64()), "task": pa.array(tasks, pa.string())})
    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    described = {
        "index_columns": ["task"], "column_indexes": [], "pandas_version": "2.2.0",
        "columns": [
            {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
            for name, (kind, numpy) in kinds.items()
        ],
    }  # fmt: skip
    return table.replace_schema_metadata({"pandas": dumps(described)})


def _features(config: Config, cameras: Sequence[_Camera], rate_hz: Fraction) -> dict[str, Any]:
    robots = [robot.id for robot in config.members]
    vectors = {
        key: [f"{robot}.{name}" for robot in robots for name in names]
        for key, names in (("observation.state", STATE), ("action", ACTION))
    }
    features: dict[str, Any] = {
        key: {"dtype": "float32", "shape": [len(names)], "names": names} for key, names in vectors.items()
    }
    codec = _CODECS.get(encoder(), encoder())
    for camera in cameras:
        features[camera.key] = {
            "dtype": "video", "shape": [camera.height, camera.width, 3], "names": ["height", "width", "channels"],
            "info": {
                "video.height": camera.height, "video.width": camera.width, "video.codec": codec,
                "video.pix_fmt": "yuv420p", "video.is_depth_map": False, "video.fps": _number(rate_hz),
                "video.channels": 3, "has_audio": False,
            },
        }  # fmt: skip
    return features | {key: {"dtype": dtype, "shape": [1], "names": None} for key, dtype in _COUNTERS.items()}


def _number(rate_hz: Fraction) -> float:
    return int(rate_hz) if rate_hz.denominator == 1 else float(rate_hz)
