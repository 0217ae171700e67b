"""Refuses robots whose pose no source can give: neither a camera or motion capture, nor the robot itself."""

from collections.abc import Iterator

from robofleet.config.faults import Complaint
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.core.plugins import PluginError, load
from robofleet.tracking.sources import ScheduledCamera
from robofleet.vehicles.interface import SimulatedDriver


def complaints(config: Config) -> Iterator[Complaint]:
    """Yield the robots whose poses could never come."""
    source, cameras = config.tracker.source, [camera.source for _, camera in config.camera_keys]
    real = [camera for camera in cameras if camera != "simulated"]
    capture = config.tracker.mocap.system if source == "mocap" else ""
    if source == "camera" and not config.seen:
        yield "tracker.source", "there is no robot that the camera could see, all are simulated: take truth"
    for i, robot in enumerate(config.robots):
        try:
            mend = f"give {robot.id} a driver" if robot.twin is None else f"remove {robot.id}'s twin"
            tells, looks = _tells(robot), source == "camera" and any(map(_looks, cameras))
        except PluginError:
            continue  # said already
        if tells and looks and robot.reality == "real":
            yield f"robots.{i}.reality", f"{cameras[0]!r} cannot see {robot.id}, which is simulated: write simulated"
        elif not tells and robot.reality == "simulated":
            yield f"robots.{i}.reality", f"nobody knows where {robot.id} is, {robot.driver!r} cannot tell: write real"
        elif not tells and source == "truth":
            yield f"robots.{i}.driver", f"{robot.driver!r} cannot tell where {robot.id} is: take tracker.source camera"
        elif not tells and capture == "simulated":
            yield (
                f"robots.{i}.driver",
                f"a simulated motion capture cannot measure {robot.id}: name tracker.mocap.system",
            )
        elif tells and capture not in ("", "mock", "simulated") and robot.reality == "real":
            yield f"robots.{i}.driver", f"{capture!r} cannot measure a simulated robot: {mend}"
        elif not tells and source == "camera" and not real:
            yield f"robots.{i}.driver", f"a simulated camera cannot see {robot.id}: take a real one, or give it a twin"


def _tells(robot: Robot) -> bool:
    """Return whether a robot says where it truly is: there is none, or its twin."""
    return robot.twin is not None or issubclass(load("robofleet.drivers", robot.driver), SimulatedDriver)


def _looks(camera: str) -> bool:
    """Return whether a camera's images are of what exists now."""
    return not issubclass(load("robofleet.cameras", camera), ScheduledCamera)
