"""The live view of a run, drawn by the launcher's process from what it hears on the bus."""

import sys
from types import TracebackType
from typing import Any, Self

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from robofleet.clock import Clock, S
from robofleet.comms.keys import CAMERA, NEWS, POSES, STATE, STATUS, TICK, TRUTH, key
from robofleet.comms.messages import (
    FLEET_POSES,
    ROBOT_STATUS,
    RUN_STATE,
    TICK_RECORD,
    TRACKER_NEWS,
    FleetPoses,
    RunState,
    TickRecord,
)
from robofleet.comms.messages import TRUTH as TRUTH_LAYOUT
from robofleet.config import slices
from robofleet.config.tree import Config
from robofleet.control.path import Path
from robofleet.processes.live_state import WAITING, arming, banner, keys
from robofleet.processes.terminal import Terminal
from robofleet.recording.causes import halt_cause, named, run_cause
from robofleet.recording.measures import path_errors, spacings, timed_errors
from robofleet.recording.run import Array, Recording
from robofleet.safety.advice import advised
from robofleet.safety.gate import GateStatus, Latch
from robofleet.tracking.events import describe

_REFRESH_NS = S // 5
_PLAIN_NS = 10 * S
_SHOWN_NS = 5 * S  # how long the tracker's news stay
_COLOURS = {"running": "bold green", "emergency stop": "bold red"}
_WINDOW = 300  # ticks, for the percentiles


class LiveView:
    """Call it with what came so far; it draws five times a second, or writes lines where stderr is no terminal."""

    def __init__(self, config: Config, clock: Clock, terminal: Terminal, *, quiet: bool) -> None:
        self._config, self._clock, self._terminal, self._quiet = config, clock, terminal, quiet
        self._ids = config.ids
        self._console = Console(stderr=True)
        self._live = Live(console=self._console, auto_refresh=False) if self._console.is_terminal else None
        self._path = Path.hermite(*slices.knots(config.groups[0]))
        self._next_ns = 0
        self._phase = self._page = ""
        self._reached_s = 0.0
        self._overruns_before: int | None = None

    def __enter__(self) -> Self:
        """Take the terminal."""
        if self._live is not None and not self._quiet:
            self._live.start()
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        """Give the terminal back."""
        if self._live is not None:
            self._live.stop()

    def __call__(self, recording: Recording, phase: str) -> None:
        """Show the run as it stands, if it is time to."""
        now_ns = self._clock.now_ns()
        if self._terminal.page != self._page and (self._quiet or self._live is None):
            print(self._terminal.page, file=sys.stderr)  # also for who wants no live view: it was asked for
        self._page = self._terminal.page
        if self._quiet or (now_ns < self._next_ns and phase == self._phase):
            return
        changed, self._phase = phase != self._phase, phase
        self._next_ns = now_ns + (_PLAIN_NS if self._live is None else _REFRESH_NS)
        if self._live is not None:
            self._live.update(self.picture(recording, phase), refresh=True)
        elif changed or phase == "running":
            print(self._line(recording), file=sys.stderr)

    def _line(self, recording: Recording) -> str:
        tick = self._newest(recording, TICK, TICK_RECORD)
        state = self._newest(recording, STATE, RUN_STATE)
        if self._phase == "held" and state is not None:
            cause = advised(run_cause(state, self._ids), state.cause)
            return f"held: {cause}: `robofleet resume` goes on, Ctrl-C ends the run"
        if self._phase in WAITING:
            return f"{self._phase}: {WAITING[self._phase]}"
        if self._phase != "running" or tick is None:
            return self._phase
        errors = " ".join(f"{robot.control_error_m * 1e3:.2f}" for robot in tick.robots)
        when = f"{self._time(tick):5.1f} s of {self._config.run.duration_s:g} s"
        return f"running {when}: control errors {errors} mm, {self._overruns(tick)} overruns"

    def picture(self, recording: Recording, phase: str) -> Group:
        """Return what the terminal shows."""
        tick = self._newest(recording, TICK, TICK_RECORD)
        duration_s = self._config.run.duration_s
        if tick is not None and tick.run_tick >= 0:
            self._reached_s = min(self._time(tick), duration_s)
        state = self._newest(recording, STATE, RUN_STATE)
        head = Text(f"{phase:<10}", _COLOURS.get(phase, "bold yellow"))
        head.append(f"{self._reached_s:5.1f} s of {duration_s:g} s   ", "default not bold")
        line = Table.grid()
        doing = arming(state, self._ids) if phase == "arming" and state is not None else WAITING.get(phase)
        line.add_row(head, Text(doing, "cyan") if doing else ProgressBar(duration_s, self._reached_s, width=50))
        parts: list[Any] = [line, keys(self._terminal, phase)]  # what a terminal that is too low cuts off comes last
        if state is not None and (seen := banner(state, self._ids, by_key=self._terminal.present)) is not None:
            parts += ["", seen]
        if tick is not None:
            parts += ["", self._health(recording, tick), "", self._robots(recording, tick, state)]
        return Group(*parts)

    def _robots(self, recording: Recording, tick: TickRecord, state: RunState | None) -> Table:
        table = Table("robot", box=None, padding=(0, 2, 0, 0), header_style="bold")
        for column in ("control mm", "path mm", "timed mm", "spacing mm", "wheels rad/s"):
            table.add_column(column, justify="right")
        table.add_column("gate")
        poses, estimated = self._poses(recording, tick)
        errors = self._errors(tick, poses) if tick.run_tick >= 0 else [["-"] * 4] * len(poses)
        for row, (robot, item) in enumerate(zip(self._config.platoon, tick.robots, strict=True)):
            wheels = f"{item.left_rad_s:6.2f} {item.right_rad_s:6.2f}"
            table.add_row(robot.id, *errors[row], wheels, self._gate(recording, row, state))
        if estimated:
            of = "" if len(estimated) == len(tick.robots) else f" of {', '.join(estimated)}"
            table.caption = f"estimated: no truth is known{of}"
        return table

    def _errors(self, tick: TickRecord, poses: Array) -> list[list[str]]:
        """Control error, distance from the path, distance from where it should be now, spacing; a row a robot."""
        ahead = self._config.controller.point_ahead_m * np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=-1)
        centres = poses[None, :, :2]
        points = centres + ahead
        reference = np.array([tick.robots[0].reference_parameter])
        path = path_errors(self._path, points)[0]
        timed = timed_errors(self._config, self._path, reference, points, centres)[0]
        gaps = ["", *(f"{gap * 1e3:.1f}" for gap in spacings(points)[0])]
        return [
            [f"{item.control_error_m * 1e3:.2f}", f"{off * 1e3:.1f}", f"{late * 1e3:.1f}", gap]
            for item, off, late, gap in zip(tick.robots, path, timed, gaps, strict=True)
        ]

    def _health(self, recording: Recording, tick: TickRecord) -> Text:
        arena = self._config.arena.name
        payloads = recording.messages.get(key(arena, TICK), [])[-_WINDOW:]
        heads = [head for payload in payloads if (head := TICK_RECORD.decode_head(payload)) is not None]
        compute, late = ([head[column] / 1e6 for head in heads] for column in (-1, -2))
        text = Text(f"tick      p99 {np.percentile(compute, 99):.2f} ms, late p99 {np.percentile(late, 99):.2f} ms, ")
        overruns = self._overruns(tick)
        text.append(f"{overruns} overruns\n", "red" if overruns else "")
        frames = [
            frame
            for payload in recording.messages.get(key(arena, POSES, CAMERA), [])[-_WINDOW:]
            if (frame := FLEET_POSES.decode(payload)) is not None
        ]
        text.append(_tracker_line(frames, len(self._config.robots)))
        news = self._newest(recording, NEWS, TRACKER_NEWS, CAMERA)
        if news is not None and frames and frames[-1].sent_ns - news.stamp_ns < _SHOWN_NS:
            text.append(f"\n          {describe(news.event, news.tag, news.value)}", "yellow")
        return text

    def _poses(self, recording: Recording, tick: TickRecord) -> tuple[Array, list[str]]:
        """Poses of the centres (N, 3), true ones where they are known, and whose are estimated."""
        poses, estimated = [], []
        for robot, item in zip(self._config.groups[0].robots, tick.robots, strict=True):
            truth = self._newest(recording, TRUTH, TRUTH_LAYOUT, robot)
            if truth is None:
                estimated.append(robot)
            its = item if truth is None else truth
            poses.append((its.x_m, its.y_m, its.psi_rad))
        return np.array(poses), estimated

    def _gate(self, recording: Recording, row: int, state: RunState | None) -> Text:
        """Why a robot may move, or why not: its latch, its own halt, else its gate."""
        status = self._newest(recording, STATUS, ROBOT_STATUS, self._ids[row])
        if status is None:
            return Text("silent", "red")
        if status.latch:
            return Text(named(Latch, status.latch), "bold red")
        if state is not None and (own := halt_cause(state, row)):
            return Text(own, "yellow")
        return Text(named(GateStatus, status.gate), "green" if status.gate == GateStatus.OPEN else "yellow")

    def _overruns(self, tick: TickRecord) -> int:
        """Return the ticks missed since the run started: what the start of all processes cost does not count."""
        if tick.run_tick < 0 or self._overruns_before is None:
            self._overruns_before = tick.overruns
        return tick.overruns - self._overruns_before

    def _time(self, tick: TickRecord) -> float:
        return tick.run_tick * self._config.controller.tick_s

    def _newest(self, recording: Recording, topic: Any, layout: Any, name: str = "") -> Any:
        messages = recording.messages.get(key(self._config.arena.name, topic, name))
        return layout.decode(messages[-1]) if messages else None


def _tracker_line(frames: list[FleetPoses], robots: int) -> str:
    if len(frames) < 2:
        return "tracker   no image yet"
    rate = (len(frames) - 1) * S / max(1, frames[-1].exposure_ns - frames[0].exposure_ns)
    found = sum(pose.coasted_ns == 0 for frame in frames for pose in frame.poses) / (len(frames) * robots)
    work = np.percentile([frame.work_ns / 1e6 for frame in frames], (50, 99))
    return (
        f"tracker   {rate:.1f} Hz, {100 * found:.1f} % of the tags seen, "
        f"{work[0]:.1f} ms each (p99 {work[1]:.1f}), {frames[-1].refused} refused"
    )
