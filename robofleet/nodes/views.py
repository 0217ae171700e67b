"""What several cameras see together: views that nothing ties to one another measure in frames that may differ."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from robofleet.config.camera import CameraSettings
from robofleet.config.faults import Complaint
from robofleet.config.tree import Config
from robofleet.core.arrays import Array
from robofleet.tracking.camera import CameraGeometry

_SURVEY_INPUTS = slice(1, 2)  # among the inputs of a camera's pose: after the camera's own file, before the images
_SAMPLES_A_SIDE = 60  # of the arena


class FloorView:
    """The floor at the height of the tags, as one camera sees it."""

    def __init__(self, config: Config, camera: CameraSettings) -> None:
        self._geometry, self._size = CameraGeometry.from_model(camera.model), (camera.width, camera.height)
        self._height_m = config.tracker.tag_height_m

    def sees(self, places: Array, reach_m: float = 0.0) -> NDArray[np.bool_]:
        """Return which places (N, 2) [m] it sees, with all that is within ``reach_m`` along x and y."""
        found = np.ones(len(places), np.bool_)
        for corner in np.unique(reach_m * np.array([(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)]), axis=0):
            points = np.column_stack([places + corner, np.full(len(places), self._height_m)])
            found &= self._geometry.sees(points, self._size)
        return found


def complaints(config: Config) -> Iterator[Complaint]:
    """Yield the cameras that share neither a part of the floor nor a survey with those before them."""
    cameras = config.camera_keys
    if len(cameras) < 2 or any(camera.model.T_world_camera is None for _, camera in cameras):
        return
    x, y = (np.linspace(-side / 2, side / 2, _SAMPLES_A_SIDE) for side in config.arena.size_m)
    floor = np.stack([*map(np.ravel, np.meshgrid(x, y))], axis=1)
    seen = [FloorView(config, camera).sees(floor) for _, camera in cameras]
    surveys = [_surveys(config, camera) for _, camera in cameras]
    tied, more = set[int](), {0}
    while more:
        tied |= more
        left = set(range(len(cameras))) - tied
        more = {k for k in left if any(surveys[k] & surveys[j] or (seen[k] & seen[j]).any() for j in tied)}
    for k, (path, camera) in enumerate(cameras):
        if k not in tied:
            yield (
                f"{path}.model",
                f"{camera.name} overlaps with none of the other cameras and shares no survey with them: place all "
                "of them by one survey, with robofleet calibrate arena",
            )


def _surveys(config: Config, camera: CameraSettings) -> set[str]:
    """Return the hash of the survey that a camera was placed by; ``floor tags`` where it sees some of
    ``tracker.floor_tags``."""
    arena, tags = camera.model.arena, config.tracker.floor_tags
    surveys = set() if arena is None else set(list(arena.inputs.values())[_SURVEY_INPUTS])
    at = np.array([(tag.x_m, tag.y_m, tag.height_m) for tag in tags])
    geometry, size = CameraGeometry.from_model(camera.model), (camera.width, camera.height)
    return surveys | ({"floor tags"} if tags and geometry.sees(at, size).any() else set())
