"""A layout of Foxglove and of Lichtblick, which read the same JSON: panels by their ids, and where they are."""

from collections.abc import Mapping, Sequence
from typing import Any

from robofleet.config.tree import Config
from robofleet.core.valid_json import dumps
from robofleet.recording.run import Recording
from robofleet.recording.scenes.overlay import camera_topic
from robofleet.recording.scenes.robot_ticks import topic
from robofleet.recording.scenes.shapes import WORLD
from robofleet.reports.layouts.plots import Plot, tabs

_SCENE = "3D!scene"
_IMAGE = "Image!camera"
_LOG = "RosOut!log"  # both call the log's panel so
_STATES = "StateTransitions!states"
_TABS = "Tab!plots"
_BUTTONS = {"stop": "EMERGENCY STOP"}
_FLAGS = "lost", "filtered", "saturated", "failed"

Panel = dict[str, Any]


def layout(recording: Recording, services: Sequence[str] = (), request: Mapping[str, str] | None = None) -> bytes:
    """Return the layout of a run's file; of a run that is on, with buttons that call services with a request."""
    config = recording.config
    panels: dict[str, Panel] = {_SCENE: _scene(config), _LOG: {"topicToRender": "/log", "minLogLevel": 1}}
    panels[_STATES] = {"isSynced": True, "paths": _flags(config)}
    shown: list[Panel] = []
    for tab in tabs(recording):
        ids = [f"Plot!{tab.title.lower()}{k}" for k in range(len(tab.plots))]
        panels |= {own: _plot(plot) for own, plot in zip(ids, tab.plots, strict=True)}
        shown.append({"title": tab.title, "layout": _split("column", *ids)})
    shown.append({"title": "States", "layout": _STATES})
    panels[_TABS] = {"activeTabIdx": 0, "tabs": shown}
    left: list[str | Panel] = [_SCENE, _LOG]
    if config.tracker.source == "camera":
        images = {f"{_IMAGE}{row or ''}": _image(camera_topic(view)) for row, view in enumerate(config.views)}
        panels |= images
        left[1:1] = images
    for service in services:
        panels[f"CallService!{service}"] = _button(service, request or {})
    if services:
        left.append(_split("row", *(f"CallService!{service}" for service in services)))
    whole = {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split("row", _split("column", *left), _TABS),
    }
    return (dumps(whole, indent=1) + "\n").encode()


def _split(direction: str, *parts: str | Panel) -> str | Panel:
    """Share a space equally."""
    first, *rest = parts
    if not rest:
        return first
    share = 100 / len(parts)
    return {"direction": direction, "first": first, "second": _split(direction, *rest), "splitPercentage": share}


def _scene(config: Config) -> Panel:
    size = config.arena.size_m
    camera = {
        "distance": 1.3 * max(size), "perspective": False, "phi": 0, "thetaOffset": 90, "target": [0, 0, 0],
        "targetOffset": [0, 0, 0], "targetOrientation": [0, 0, 0, 1], "fovy": 45, "near": 0.01, "far": 5000,
    }  # fmt: skip
    topics = "/arena", "/fleet", "/references"
    return {
        "cameraState": camera, "followMode": "follow-none", "followTf": WORLD,
        "topics": {name: {"visible": True} for name in topics}, "layers": {}, "scene": {}, "transforms": {},
        "publish": {}, "imageMode": {},
    }  # fmt: skip


def _image(topic: str) -> Panel:
    shown = {"imageTopic": f"{topic}/image", "annotations": {f"{topic}/annotations": {"visible": True}}}
    return {"imageMode": shown, "topics": {}, "layers": {}, "scene": {}, "transforms": {}, "publish": {}}


def _button(service: str, request: Mapping[str, str]) -> Panel:
    return {
        "serviceName": service, "requestPayload": dumps(request), "layout": "vertical", "editingMode": False,
        "timeoutSeconds": 10, "buttonText": _BUTTONS.get(service, service.capitalize()),
        "buttonColor": "#c62828" if service == "stop" else "#37474f", "buttonTooltip": "",
    }  # fmt: skip


def _plot(plot: Plot) -> Panel:
    return {
        "foxglovePanelTitle": plot.title,
        "lichtblickPanelTitle": plot.title,
        "paths": [
            {
                "value": f"{line.topic}.{line.field}", "label": line.label, "color": line.colour, "enabled": True,
                "timestampMethod": "receiveTime",
            }
            for line in plot.lines
        ],
        "xAxisVal": "timestamp", "isSynced": True, "showLegend": True, "legendDisplay": "floating",
        "showPlotValuesInLegend": False, "showXAxisLabels": True, "showYAxisLabels": True, "sidebarDimension": 240,
    }  # fmt: skip


def _flags(config: Config) -> list[Panel]:
    return [
        {"value": f"{topic(robot.id)}.{flag}", "label": f"{robot.id} {flag}", "timestampMethod": "receiveTime"}
        for robot in config.members
        for flag in _FLAGS
    ]
