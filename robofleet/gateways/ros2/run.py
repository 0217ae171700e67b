"""What is said of the run as a whole: its state, diagnostics, and what is drawn of robots and arena."""

from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA, String
from visualization_msgs.msg import Marker, MarkerArray

from robofleet.bus.bus import Bus, Wake
from robofleet.bus.keys import STATE, TICK
from robofleet.bus.messages import RUN_STATE, TICK_RECORD, RunState
from robofleet.bus.statuses import Statuses
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S
from robofleet.gateways.ros2 import topics
from robofleet.gateways.ros2.graph import Graph
from robofleet.gateways.ros2.topics import Frames
from robofleet.gateways.served import Served
from robofleet.gateways.urdf import HEIGHT_M
from robofleet.recording.causes import halt_cause, named
from robofleet.recording.state_words import state_words
from robofleet.safety.gate import GateStatus, Latch
from robofleet.safety.supervisor import Phase

_EVERY_NS = S  # from one word of the diagnostics to the next
_OLD_NS = S  # a robot that said nothing for so long is stale
_OK, _WARN, _ERROR, _STALE = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE
_LEVELS = {Phase.HOLD: _WARN, Phase.FAULT: _ERROR, Phase.ESTOP: _ERROR}


class Run:
    """A run's state and diagnostics."""

    def __init__(self, graph: Graph, config: Config, bus: Bus, served: Served, wake: Wake) -> None:
        self._graph, self._config, self._served = graph, config, served
        self._states = bus.newest(STATE, wake=wake)
        self._ticks = bus.newest(TICK)
        self._robots = [robot.id for robot in config.bodies]
        self._statuses = Statuses(bus, config.units, self._robots)
        self._heard_ns: dict[str, int] = {}
        self._state = graph.publisher(topics.STATE)
        self._diagnostics = graph.publisher(topics.DIAGNOSTICS)
        self._newest: RunState | None = None
        self._phase = ""
        self._said_ns = 0

    def step(self, now_ns: int) -> None:
        """Say what is new."""
        payload = self._states.take()
        state = None if payload is None else RUN_STATE.decode(payload)
        if payload is not None and state is not None:
            self._newest = state
            self._served.take(payload, now_ns)
            phase = named(Phase, state.phase)
            if phase != self._phase:
                self._phase = phase
                self._state.publish(String(data=phase))
        if now_ns - self._said_ns >= _EVERY_NS:
            self._said_ns = now_ns
            message = DiagnosticArray(status=[self._of_run(), self._of_controller(), *self._of_robots(now_ns)])
            message.header.stamp = self._graph.stamp(now_ns)
            self._diagnostics.publish(message)

    def _of_run(self) -> DiagnosticStatus:
        state, name = self._newest, f"{self._config.arena.name}: run"
        if state is None:
            return DiagnosticStatus(level=_STALE, name=name, message="the supervisor says nothing")
        words = state_words(state, None, self._config.ids)
        level = _LEVELS.get(state.phase, _OK)  # type: ignore[call-overload]
        return DiagnosticStatus(
            level=level, name=name, message=f"{words.phase}: {words.advice}", values=_values(phase=self._phase)
        )

    def _of_controller(self) -> DiagnosticStatus:
        payload, name = self._ticks.take(), f"{self._config.arena.name}: controller"
        head = None if payload is None else TICK_RECORD.decode_head(payload)
        if head is None:
            return DiagnosticStatus(level=_STALE, name=name, message="no ticks")
        values = _values(
            tick=head.tick, overruns=head.overruns, lateness_ms=f"{head.lateness_ns / MS:.3f}",
            compute_ms=f"{head.compute_ns / MS:.3f}",
        )  # fmt: skip
        return DiagnosticStatus(level=_OK, name=name, message=f"{head.overruns} ticks missed so far", values=values)

    def _of_robots(self, now_ns: int) -> list[DiagnosticStatus]:
        statuses, found = self._statuses, []
        for number in statuses.take():
            for row in statuses.units[number].numbers.tolist():
                self._heard_ns[self._robots[row]] = now_ns
        for row, robot in enumerate(self._robots):
            say = partial(DiagnosticStatus, name=f"{self._config.arena.name}: {robot}", hardware_id=robot)
            if now_ns - self._heard_ns.get(robot, 0) > _OLD_NS + _EVERY_NS:
                found.append(say(level=_STALE, message="its driver says nothing"))
                continue
            status = statuses.robots[row]
            gate, latch = named(GateStatus, int(status["gate"])), named(Latch, int(status["latch"]))
            halted = "" if self._newest is None else halt_cause(self._newest, row)
            latched, closed = int(status["latch"]) != Latch.NONE, int(status["gate"]) != GateStatus.OPEN
            message = halted or (f"gate latched: {latch}" if latched else f"gate {gate}")
            values = _values(gate=gate, latch=latch, faults=int(status["faults"]), rejected=int(status["rejected"]))
            found.append(say(level=_ERROR if latched else _WARN if closed else _OK, message=message, values=values))
        return found


def _values(**values: Any) -> list[KeyValue]:
    return [KeyValue(key=key, value=str(value)) for key, value in values.items()]


def markers(config: Config, names: dict[str, str], frames: Frames) -> MarkerArray:
    """Return what is drawn: the arena's edge, and each robot's body and name, which move with its frame."""
    x, y = (size / 2.0 for size in config.arena.size_m)
    edge = _marker("arena", 0, frames.map, Marker.LINE_STRIP)
    edge.scale.x = 0.01
    edge.points = [Point(x=a * x, y=b * y) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1))]
    drawn = [edge]
    for number, robot in enumerate(config.bodies):
        frame, radius = frames.base(names[robot.id]), robot.vehicle.body_radius_m
        body, nose, title = (
            _marker(kind, number, frame, shape)
            for kind, shape in (("body", Marker.CYLINDER), ("ahead", Marker.ARROW), ("name", Marker.TEXT_VIEW_FACING))
        )
        body.pose.position.z = HEIGHT_M / 2.0
        body.scale.x = body.scale.y = 2.0 * radius
        body.scale.z = HEIGHT_M
        nose.pose.position.z = title.pose.position.z = HEIGHT_M
        nose.scale.x, nose.scale.y, nose.scale.z = 1.5 * radius, 0.2 * radius, 0.1 * radius
        title.scale.z, title.text = radius, robot.id
        drawn += [body, nose, title]
    return MarkerArray(markers=drawn)


def _marker(kind: str, number: int, frame: str, shape: int) -> Marker:
    shade = {"body": (0.2, 0.5, 0.8), "ahead": (0.9, 0.9, 0.9)}.get(kind, (0.8, 0.8, 0.8))
    message = Marker(ns=kind, id=number, type=shape, action=Marker.ADD, frame_locked=True)
    message.header.frame_id = frame
    message.pose.orientation.w = 1.0
    message.color = ColorRGBA(r=shade[0], g=shade[1], b=shade[2], a=1.0)
    return message
