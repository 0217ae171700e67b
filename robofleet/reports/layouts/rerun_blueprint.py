"""A blueprint of rerun: the scene, the pictures and the log beside the plots. It needs the package rerun-sdk.

rerun uses a blueprint for recordings of the same application: a converted run has this one's.
"""

import tempfile
from pathlib import Path
from typing import Any

from robofleet.recording.run import Recording
from robofleet.recording.scenes.fleet_scene import pose_topic
from robofleet.recording.scenes.overlay import camera_topic
from robofleet.recording.scenes.robot_ticks import PACKAGE, message_name, topic
from robofleet.recording.scenes.shapes import WORLD
from robofleet.reports.layouts.plots import Plot, tabs

APPLICATION = "robofleet"
_ABOVE, _BEHIND = 0.75, 0.3  # of the arena's length: from where it is seen
TIMELINE = "message_log_time"  # as its importer calls the log time of a file's messages


def layout(recording: Recording) -> bytes:
    """Return the blueprint of a run's file; ModuleNotFoundError where rerun-sdk is missing, or too old."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "run.rbl"
        blueprint(recording).save(APPLICATION, file)
        return file.read_bytes()


def blueprint(recording: Recording) -> Any:
    """Return it as rerun's own; of a run that is on, too."""
    import rerun as rr  # noqa: PLC0415
    import rerun.blueprint as rrb  # noqa: PLC0415

    config, components = recording.config, _components(recording)
    plots = [rrb.Vertical(*(_view(plot, components) for plot in tab.plots), name=tab.title) for tab in tabs(recording)]
    poses: dict[Any, Any] = {pose_topic(robot.id): rr.TransformAxes3D(0.1).visualizer() for robot in config.members}
    shapes = [f"{topic}/**" for topic in ("/arena", "/fleet", "/references")]  # of a run that is on
    scene = rrb.Spatial3DView(
        name="Arena", origin="/", contents=[*poses, *shapes], overrides=poses,
        spatial_information=rrb.SpatialInformation(target_frame=WORLD),
        eye_controls=rrb.EyeControls3D(
            position=(0.0, -_BEHIND * max(config.arena.size_m), _ABOVE * max(config.arena.size_m)),
            look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0),
        ),
    )  # fmt: skip
    left = [scene, rrb.TextLogView(origin="/log", name="Log")]
    if config.tracker.source == "camera":
        topics = [camera_topic(view) for view in config.views]
        names = ["Camera"] if len(topics) == 1 else [f"Camera {name}" for name in config.camera_names]
        left[1:1] = [
            rrb.Spatial2DView(origin=f"{topic}/image", contents=[f"{topic}/image", f"{topic}/annotations"], name=name)
            for topic, name in zip(topics, names, strict=True)
        ]
    views = rrb.Horizontal(rrb.Vertical(*left), rrb.Tabs(*plots), column_shares=[2, 3])
    return rrb.Blueprint(views, rrb.TimePanel(timeline=TIMELINE, state="collapsed"), collapse_panels=True)


def _components(recording: Recording) -> dict[str, str]:
    """Return how rerun names the messages of each robot's topic, which it knows by their schema alone."""
    gauges = recording.gauges
    names = [(robot, message_name(gauges, gauge.group.name)) for gauge in gauges for robot in gauge.group.robots]
    return {topic(robot): f"{PACKAGE}.{name}:message" for robot, name in names}


def _view(plot: Plot, components: dict[str, str]) -> Any:
    import rerun as rr  # noqa: PLC0415
    import rerun.blueprint as rrb  # noqa: PLC0415
    from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping  # noqa: PLC0415

    lines: dict[Any, list[Any]] = {}
    for line in plot.lines:
        source = VisualizerComponentMapping(
            "Scalars:scalars", ComponentSourceKind.SourceComponent, source_component=components[line.topic],
            selector=f".{line.field}",
        )  # fmt: skip
        looks = rr.SeriesLines(names=line.label, colors=int(line.colour[1:] + "ff", 16))
        lines.setdefault(line.topic, []).append(looks.visualizer(mappings=[source]))
    return rrb.TimeSeriesView(origin="/", contents=sorted(lines), overrides=lines, name=plot.title)
