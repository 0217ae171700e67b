"""The live view of a run, drawn by the launcher's process from what it hears on the bus."""

import sys
from functools import cached_property
from typing import Any, Self

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from robofleet.bus.keys import BUSY, NEWS, POSES, STATE, TICK, key
from robofleet.bus.messages import FLEET_POSES, TICK_RECORD, FleetPoses, RunState, TickRecord
from robofleet.config.tree import Config
from robofleet.core.clock import Clock, S
from robofleet.operator.terminal import live_robots
from robofleet.operator.terminal.live_state import ENDED, ENDS, UNDER_WAY, WAITING, banner, keys
from robofleet.operator.terminal.on_the_way import OnTheWay
from robofleet.operator.terminal.qr_code import qr_code
from robofleet.operator.terminal.start_view import StartLines, start_bar
from robofleet.operator.terminal.terminal import Terminal
from robofleet.recording.run import Recording
from robofleet.recording.run_clock import LiveClock, time_words
from robofleet.recording.state_words import StateWords, busy_notice, state_words
from robofleet.runs.console import READY
from robofleet.safety.supervisor import Phase
from robofleet.tracking.events import describe

_REFRESH_NS = S // 5
_PLAIN_NS = 10 * S
_NEWS_SHOWN_NS = 5 * S
_DOING = WAITING | UNDER_WAY | ENDS
_COLOURS = {
    "running": "bold green",
    "positioning": "bold green",
    "parking": "bold green",
    "completed": "bold green",
    "emergency stop": "bold red",
}
_WINDOW_TICKS = 300  # for the percentiles
_TIME_COLUMNS, _BAR_END_COLUMN, _LEAST_BAR_COLUMNS = 23, 79, 10


class LiveView:
    """Call it with what came so far; it draws five times a second, or writes lines where stderr is no terminal."""

    def __init__(self, config: Config, clock: Clock, terminal: Terminal, *, quiet: bool) -> None:
        self._config, self._clock, self._terminal, self._quiet = config, clock, terminal, quiet
        self._ids = config.ids
        self._console = Console(stderr=True)
        self._live = Live(console=self._console, auto_refresh=False) if self._console.is_terminal else None
        self._start_lines = StartLines(long_ones=quiet)
        self._next_ns = 0
        self._phase = self._code = ""
        self._addresses: dict[str, str] = {}
        self._clock_of_run = LiveClock(config.controller.tick_s)
        self._overruns_before: int | None = None
        self._shown: tuple[str, bool] = ("", False)  # the phase, and whether it goes on by itself
        self._noticed = False  # that the machine is busy

    def __enter__(self) -> Self:
        if self._live is not None and not self._quiet:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()

    def __call__(self, recording: Recording, phase: str) -> None:
        """Show the run as it stands, if it is time to."""
        if phase == READY and not self._quiet:
            _ = recording.groups, self._way  # loads the behaviours: a launcher that stalls later is no operator
        payloads = recording.messages.get(key(self._config.arena.name, TICK))
        if payloads and (head := TICK_RECORD.decode_head(payloads[-1])) is not None:
            self._clock_of_run.take(head)
        now_ns = self._clock.now_ns()
        addresses = dict(self._terminal.addresses)
        for command, line in addresses.items():
            if line != self._addresses.get(command) and (self._quiet or self._live is None):
                print(line, file=sys.stderr)  # also for who wants no live view: it was asked for
        self._addresses = addresses
        self._show_code()
        starting = self._terminal.starting
        if starting is not None and phase != READY and (self._quiet or self._live is None):
            self._start_lines(starting, phase)
        if not (self._quiet or self._noticed or self._live is not None):
            self._notice(recording)
        if self._quiet:
            self._phase = phase
        shown = phase, phase == "held" and self._goes_on(recording)
        if self._quiet or (now_ns < self._next_ns and shown == self._shown):
            return
        changed, self._shown, self._phase = shown != self._shown, shown, phase
        self._next_ns = now_ns + (_PLAIN_NS if self._live is None else _REFRESH_NS)
        if self._live is not None:
            self._live.update(self.picture(recording, phase), refresh=True)
        elif (changed and starting is None) or phase == "running":
            print(self._line(recording), file=sys.stderr)

    def _show_code(self) -> None:
        """Show the page's address once to a phone: above the picture, which does not repeat it."""
        if self._terminal.code not in ("", self._code):
            self._code = self._terminal.code
            if (code := qr_code(self._code, self._console)) is not None:
                self._console.print(code)

    def _notice(self, recording: Recording) -> None:
        """Say once that the machine is busy, as soon as that is known."""
        if (busy := recording.newest(BUSY)) is not None:
            self._noticed = True
            print(busy_notice(busy, self._ids), file=sys.stderr)

    def _goes_on(self, recording: Recording) -> bool:
        state = recording.newest(STATE)
        if state is not None and state.phase != Phase.HOLD:
            return self._shown[1]  # it goes on just now: the phase that is shown follows
        return state is not None and self._words(recording, state).goes_on

    def _line(self, recording: Recording) -> str:
        tick = self._tick(recording)
        state = recording.newest(STATE)
        if self._phase == "held" and state is not None:
            words = self._words(recording, state)
            held = f"held: {words.advice}, at {self._time()}"
            if words.goes_on:
                return f"{held}; the run goes on by itself"
            return f"{held}: `robofleet resume` goes on, Ctrl-C ends the run"
        if self._phase in _DOING:
            return f"{self._phase}: {_DOING[self._phase]}"
        if self._phase != "running" or tick is None:
            return self._phase
        when = self._time(self._config.run.duration_s)
        figures = "; ".join([*live_robots.lines(recording.groups, tick), f"{self._overruns(tick)} overruns"])
        return f"running {when}: {figures}"

    def picture(self, recording: Recording, phase: str) -> Group:
        tick = self._tick(recording)
        duration_s = self._config.run.duration_s
        reached_s = min(self._clock_of_run.run_s or 0.0, duration_s)
        state = recording.newest(STATE)
        if state is not None:
            self._way.hear(state.phase)
        to_go_m = self._way.to_go_m(tick)
        head = Text(f"{phase:<12}", _COLOURS.get(phase, "bold yellow"))
        words = None if state is None else self._words(recording, state)
        doing = words.check if phase == "arming" and words is not None else _DOING.get(phase)
        doing = (self._way.words(to_go_m) or doing) if phase in UNDER_WAY else doing
        if phase not in UNDER_WAY:  # on the way it stands
            head.append(f"{self._time(duration_s):>{_TIME_COLUMNS}}", "default not bold")
        head.append("  ")
        bar_columns = max(_LEAST_BAR_COLUMNS, _BAR_END_COLUMN - len(head))
        line = Table.grid()
        line.add_column(no_wrap=True)
        line.add_row(head, Text(doing, "cyan") if doing else ProgressBar(duration_s, reached_s, width=bar_columns))
        starting = self._terminal.starting
        first = line if starting is None else start_bar(starting)
        parts: list[Any] = [first, keys(self._terminal, phase)]  # what a low terminal cuts off is last
        by_key, held = self._terminal.present, self._way.phase
        if state is not None and words is not None and (seen := banner(state, words, by_key=by_key, way=held)):
            parts += ["", seen]
        elif (busy := recording.newest(BUSY)) is not None:
            parts += ["", Text(busy_notice(busy, self._ids), "yellow")]
        if tick is not None and phase not in ENDED:  # then the summary follows
            statuses = [recording.newest_status(robot.id) for robot in self._config.members]
            way = live_robots.Way(self._way, to_go_m) if self._way.phase is not None else None
            robots = live_robots.tables(recording.groups, tick, statuses, state, way, starting=starting is not None)
            parts += ["", self._health(recording, tick), *robots]
        return Group(*parts)

    def _tick(self, recording: Recording) -> TickRecord | None:
        """Return the newest tick; None where it is not about this configuration's robots."""
        tick: TickRecord | None = recording.newest(TICK)
        return tick if tick is not None and len(tick.robots) == len(self._config.members) else None

    @cached_property
    def _way(self) -> OnTheWay:
        return OnTheWay(self._config)

    def _words(self, recording: Recording, state: RunState) -> StateWords:
        return state_words(state, recording.newest(BUSY), self._ids)

    def _health(self, recording: Recording, tick: TickRecord) -> Table:
        arena = self._config.arena.name
        payloads = recording.messages.get(key(arena, TICK), [])[-_WINDOW_TICKS:]
        heads = [head for payload in payloads if (head := TICK_RECORD.decode_head(payload)) is not None]
        compute, late = [head.compute_ns / 1e6 for head in heads], [head.lateness_ns / 1e6 for head in heads]
        ticks = Text(f"p99 {np.percentile(compute, 99):.2f} ms, late p99 {np.percentile(late, 99):.2f} ms, ")
        overruns = self._overruns(tick)
        ticks.append(f"{overruns} overruns", "red" if overruns else "")
        table = Table.grid(padding=(0, 3, 0, 0))
        table.add_row("tick", ticks)
        cameras = self._config.camera_names
        for camera in cameras:
            table.add_row("tracker" if len(cameras) == 1 else camera, self._tracker(recording, camera))
        return table

    def _tracker(self, recording: Recording, camera: str) -> Text:
        frames = [
            frame
            for payload in recording.messages.get(key(self._config.arena.name, POSES, camera), [])[-_WINDOW_TICKS:]
            if (frame := FLEET_POSES.decode(payload)) is not None
        ]
        tracker = Text(_tracker_line(frames, len(self._config.robots)))
        news = recording.newest(NEWS, camera)
        if news is not None and frames and frames[-1].sent_ns - news.stamp_ns < _NEWS_SHOWN_NS:
            tracker.append(f"\n{describe(news.event, news.tag, news.value)}", "yellow")
        return tracker

    def _overruns(self, tick: TickRecord) -> int:
        """Return the ticks missed since the run started: what the start of all processes cost does not count."""
        if tick.run_tick < 0 or self._overruns_before is None:
            self._overruns_before = tick.overruns
        return tick.overruns - self._overruns_before

    def _time(self, whole_s: float | None = None) -> str:
        return time_words(self._clock_of_run.run_s or 0.0, self._clock_of_run.clock_s, whole_s)


def _tracker_line(frames: list[FleetPoses], robots: int) -> str:
    if len(frames) < 2:
        return "no image yet"
    rate = (len(frames) - 1) * S / max(1, frames[-1].exposure_ns - frames[0].exposure_ns)
    found = sum(pose.coasted_ns == 0 for frame in frames for pose in frame.poses) / (len(frames) * robots)
    work = np.percentile([frame.work_ns / 1e6 for frame in frames], (50, 99))
    return (
        f"{rate:.1f} Hz, {100 * found:.1f} % of the tags seen, "
        f"{work[0]:.1f} ms each (p99 {work[1]:.1f}), {frames[-1].refused} refused"
    )
