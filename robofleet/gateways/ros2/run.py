"""What is said of the run as a whole: its state, diagnostics, and what is drawn of robots and arena."""

from collections.abc import Iterator
from functools import partial
from typing import Any

from robofleet.bus.keys import STATE, STATUS, TICK
from robofleet.bus.messages import TICK_RECORD
from robofleet.bus.observer import Observer, Source
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S
from robofleet.gateways.place import Served
from robofleet.gateways.ros2 import topics
from robofleet.gateways.ros2.graph import Graph, Messages
from robofleet.gateways.urdf import BASE, HEIGHT_M
from robofleet.recording.causes import halt_cause, named
from robofleet.recording.state_words import state_words
from robofleet.safety.latches import GateStatus, Latch
from robofleet.safety.supervisor import Phase

_DIAGNOSTICS_PERIOD_NS = S
_STALE_NS = 2 * S  # a robot that said nothing for so long is stale
_LEVELS = {Phase.HOLD: "WARN", Phase.FAULT: "ERROR", Phase.ESTOP: "ERROR"}


class Run:
    """A run's state and diagnostics."""

    def __init__(self, graph: Graph, config: Config, observer: Observer, served: Served) -> None:
        """The observer observes STATUS of every unit."""
        self._graph, self._config, self._observer, self._served = graph, config, observer, served
        observer.declare([STATE])
        observer.declare([TICK], TICK_RECORD.decode_head)
        self._state = graph.publisher(topics.STATE)
        self._diagnostics = graph.publisher(topics.DIAGNOSTICS)
        self._phase = ""
        self._published_ns = 0

    def step(self, now_ns: int, updated: set[Source]) -> None:
        if STATE in updated:
            state = self._observer[STATE]
            self._served.take(state.epoch, now_ns)
            phase = named(Phase, state.phase)
            if phase != self._phase:
                self._phase = phase
                self._state.publish(self._graph.messages.String(data=phase))
        if now_ns - self._published_ns >= _DIAGNOSTICS_PERIOD_NS:
            self._published_ns = now_ns
            found = [self._of_run(), self._of_controller(now_ns), *self._of_robots(now_ns)]
            message = self._graph.messages.DiagnosticArray(status=found)
            message.header.stamp = self._graph.stamp(now_ns)
            self._diagnostics.publish(message)

    def _status(self, level: str, values: dict[str, Any] | None = None, **fields: str) -> Any:
        """Return a DiagnosticStatus of a level by its name, with values in words."""
        messages = self._graph.messages
        pairs = [messages.KeyValue(key=key, value=str(value)) for key, value in (values or {}).items()]
        return messages.DiagnosticStatus(level=getattr(messages.DiagnosticStatus, level), values=pairs, **fields)

    def _of_run(self) -> Any:
        state, name = self._observer[STATE], f"{self._config.arena.name}: run"
        if state is None:
            return self._status("STALE", name=name, message="the supervisor says nothing")
        words = state_words(state, None, self._config.ids)
        level = _LEVELS.get(state.phase, "OK")
        return self._status(level, {"phase": self._phase}, name=name, message=f"{words.phase}: {words.advice}")

    def _of_controller(self, now_ns: int) -> Any:
        head, name = self._observer[TICK], f"{self._config.arena.name}: controller"
        if not self._observer.alive(TICK, now_ns, _DIAGNOSTICS_PERIOD_NS):
            return self._status("STALE", name=name, message="no ticks")
        values = {
            "tick": head.tick, "overruns": head.overruns, "lateness_ms": f"{head.lateness_ns / MS:.3f}",
            "compute_ms": f"{head.compute_ns / MS:.3f}",
        }  # fmt: skip
        return self._status("OK", values, name=name, message=f"{head.overruns} ticks missed so far")

    def _of_robots(self, now_ns: int) -> Iterator[Any]:
        for row, robot in enumerate(self._config.bodies):
            unit = self._config.unit_of[robot.id]
            say = partial(self._status, name=f"{self._config.arena.name}: {robot.id}", hardware_id=robot.id)
            if not self._observer.alive((STATUS, unit), now_ns, _STALE_NS):
                yield say("STALE", message="its driver says nothing")
                continue
            status = self._observer[STATUS, unit][1][self._config.units[unit].index(robot.id)]
            gate, latch = named(GateStatus, int(status["gate"])), named(Latch, int(status["latch"]))
            state = self._observer[STATE]
            halted = "" if state is None else halt_cause(state, row)
            latched, closed = int(status["latch"]) != Latch.NONE, int(status["gate"]) != GateStatus.OPEN
            message = halted or (f"gate latched: {latch}" if latched else f"gate {gate}")
            counts = {name: int(status[name]) for name in ("faults", "rejected")}
            level = "ERROR" if latched else "WARN" if closed else "OK"
            yield say(level, {"gate": gate, "latch": latch, **counts}, message=message)


def markers(graph: Graph, config: Config, names: dict[str, str]) -> Any:
    """Return what is drawn: the arena's edge, and each robot's body and name, which move with its frame."""
    x, y = (size / 2.0 for size in config.arena.size_m)
    messages, frames = graph.messages, graph.frames
    kinds = messages.Marker
    edge = _marker(messages, "arena", 0, frames.map, kinds.LINE_STRIP)
    edge.scale.x = 0.01
    edge.points = [messages.Point(x=a * x, y=b * y) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))]
    drawn = [edge]
    for number, robot in enumerate(config.bodies):
        frame, radius = frames.link(names[robot.id], BASE), robot.vehicle.body_radius_m
        body, nose, title = (
            _marker(messages, kind, number, frame, shape)
            for kind, shape in (("body", kinds.CYLINDER), ("ahead", kinds.ARROW), ("name", kinds.TEXT_VIEW_FACING))
        )
        body.pose.position.z = HEIGHT_M / 2.0
        body.scale.x = body.scale.y = 2.0 * radius
        body.scale.z = HEIGHT_M
        nose.pose.position.z = title.pose.position.z = HEIGHT_M
        nose.scale.x, nose.scale.y, nose.scale.z = 1.5 * radius, 0.2 * radius, 0.1 * radius
        title.scale.z, title.text = radius, robot.id
        drawn += [body, nose, title]
    return messages.MarkerArray(markers=drawn)


def _marker(messages: Messages, kind: str, number: int, frame: str, shape: int) -> Any:
    shade = {"body": (0.2, 0.5, 0.8), "ahead": (0.9, 0.9, 0.9)}.get(kind, (0.8, 0.8, 0.8))
    message = messages.Marker(ns=kind, id=number, type=shape, action=messages.Marker.ADD, frame_locked=True)
    message.header.frame_id = frame
    message.pose.orientation.w = 1.0
    message.color = messages.ColorRGBA(r=shade[0], g=shade[1], b=shade[2], a=1.0)
    return message
