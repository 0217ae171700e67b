"""What RViz shows of a run: the arena, every robot with its frames and name, its distances, and the cameras' images."""

from typing import Any

import yaml

from robofleet.config.tree import Config
from robofleet.gateways.ros2 import topics
from robofleet.gateways.ros2.topics import Frames, Topic

Display = dict[str, Any]


def configuration(config: Config, namespace: str) -> str:
    """Return the configuration of RViz for a run whose gateway has this namespace; NamesError as ``ros_names``."""
    fixed, names = Frames(namespace).map, topics.ros_names(robot.id for robot in config.robots)

    def shown(kind: str, title: str, topic: Topic, *parts: object) -> Display:
        name, quality = f"/{namespace.strip('/')}/{topic.name.format(*parts)}".replace("//", "/"), topic.quality
        where = {
            "Value": name,
            "Depth": quality.depth,
            "Durability Policy": "Transient Local" if quality.latched else "Volatile",
            "History Policy": "Keep Last",
            "Reliability Policy": "Reliable" if quality.reliable else "Best Effort",
        }
        return _display(kind, title, Topic=where)

    displays = [
        _display("Grid", "Grid", **{"Cell Size": 0.5, "Plane Cell Count": 8, "Reference Frame": fixed}),
        _display(
            "TF", "Frames", **{"Show Names": False, "Show Arrows": False, "Marker Scale": 0.25, "Frame Timeout": 2}
        ),
        shown("Map", "Floor and obstacles", topics.FLOOR),
        shown("MarkerArray", "Arena and robots", topics.MARKERS),
    ]
    for robot in config.robots:
        model = shown("RobotModel", robot.id, topics.DESCRIPTION, names[robot.id])
        where = {"Description Source": "Topic", "Description Topic": model.pop("Topic")}
        displays.append(model | where | {"TF Prefix": Frames(namespace).link(names[robot.id], "").rstrip("/")})
        sensors = robot.vehicle.sensors
        if robot.sensors and sensors is not None and sensors.distances is not None:
            for number in range(len(sensors.distances.places)):
                displays.append(shown("Range", f"{robot.id}: {number}", topics.RANGE, names[robot.id], number))
    for view in config.views if config.tracker.source == "camera" else ():
        displays.append(shown("Image", f"Camera {view.camera.name}", topics.IMAGE, topics.ros_name(view.camera.name)))
    above = {"Class": "rviz_default_plugins/TopDownOrtho", "Name": "From above", "Scale": 300, "X": 0, "Y": 0,
             "Angle": 0, "Target Frame": fixed}  # fmt: skip
    whole = {
        "Panels": [{"Class": f"rviz_common/{name}", "Name": name} for name in ("Displays", "Views", "Time")],
        "Visualization Manager": {
            "Class": "",
            "Global Options": {"Background Color": "40; 40; 44", "Fixed Frame": fixed, "Frame Rate": 30},
            "Displays": displays,
            "Tools": [{"Class": f"rviz_default_plugins/{name}"} for name in ("MoveCamera", "Select", "Measure")],
            "Views": {"Current": above},
        },
        "Window Geometry": {"Width": 1400, "Height": 900},
    }
    return yaml.safe_dump(whole, sort_keys=False)


def _display(kind: str, title: str, **more: Any) -> Display:
    return {"Class": f"rviz_default_plugins/{kind}", "Name": title, "Enabled": True, **more}
