"""Where each robot is: camera model, tags, filter.

For programs that have a video and no fleet: ``track`` gives the poses of AprilTags in a video, a folder of images or a
camera's images. The command ``robofleet track`` is made of it. All other names of this room are internal.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robofleet.tracking.plane import PlacedCamera
    from robofleet.tracking.tracks import TrackedImage, Tracks, track

__all__ = ["PlacedCamera", "TrackedImage", "Tracks", "track"]

_MODULES = {"PlacedCamera": "plane"} | dict.fromkeys(("TrackedImage", "Tracks", "track"), "tracks")


def __getattr__(name: str) -> Any:  # they load OpenCV, which a robot's own computer does not have
    if name not in _MODULES:
        raise AttributeError(f"module 'robofleet.tracking' has no attribute {name!r}")
    return getattr(import_module(f"robofleet.tracking.{_MODULES[name]}"), name)
