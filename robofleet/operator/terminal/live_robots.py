"""The robots in the terminal: a table for each group, and their first figures in a line."""

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from rich.table import Table
from rich.text import Text

from robofleet.behaviours.described import Group
from robofleet.behaviours.interface import Figure
from robofleet.bus.messages import RobotStatus, RobotTick, RunState, TickRecord
from robofleet.operator.terminal import live_figures
from robofleet.operator.terminal.on_the_way import OnTheWay
from robofleet.recording.causes import driven_out, named, own_state
from robofleet.recording.state_words import ROBOT_WORDS
from robofleet.reports.tables import Fitting
from robofleet.safety.latches import GateStatus, Latch

_ROBOT, _POSE, _WHEELS, _BATTERY, _STATE = "robot", "pose", "wheels", "battery", "state"
_TO_GO = "way"
_COMMON = _ROBOT, _POSE, _WHEELS, _BATTERY  # columns of every robot; then its behaviour's figures, then its state
_HEADS = {_POSE: "x m    y m   deg", _WHEELS: "wheels rad/s", _BATTERY: "battery\n%"}
_LEAST_FIRST = _BATTERY, _POSE, _WHEELS  # to be left out of a narrow terminal; then the figures, the last one first
_STATE_WIDTH = 12  # columns; longer words are broken into lines
_HEAD_WIDTH = 13  # columns of a figure's name: longer ones are broken into lines
_UNKNOWN = "-"


def lines(groups: Sequence[Group], tick: TickRecord) -> Iterator[str]:
    """Yield each group's first live figure, of all its robots."""
    every, figures, first = live_figures.columns(groups), live_figures.told(groups, tick).figures, 0
    for group in groups:
        rows = figures[first : (first := first + len(group.robots))]
        for k in live_figures.own(group, every)[:1]:
            words = " ".join(live_figures.words(every[k], value) or _UNKNOWN for value in rows[:, k])
            prefix = f"{group.name}: " if len(groups) > 1 else ""
            yield f"{prefix}{live_figures.title(every[k])} {words} {live_figures.unit(every[k])}".rstrip()


class Way(NamedTuple):
    """The way that the robots are on, to their start or to the park."""

    on: OnTheWay
    to_go_m: Sequence[float | None]  # of the members


def tables(
    groups: Sequence[Group], tick: TickRecord, statuses: Sequence[RobotStatus | None], state: RunState | None,
    way: Way | None = None, *, starting: bool = False,
) -> Iterator[str | Text | Fitting]:  # fmt: skip
    """Yield a table for each group, with its name where there are several; statuses: of the members.

    On the way no behaviour tells figures: the tables have the way instead.
    """
    every, figures = live_figures.columns(groups), live_figures.told(groups, tick).figures
    widest, row = max(len(robot) for group in groups for robot in group.robots), 0
    for group in groups:
        yield ""
        if len(groups) > 1:
            does = "" if group.name == group.behaviour else f"  {group.behaviour}"
            yield Text(group.name, "bold").append(does, "not bold dim")
        own: list[int] = live_figures.own(group, every) if way is None else []
        rows: list[tuple[str | Text, ...]] = []
        for robot in group.robots:
            item, status = tick.robots[row], statuses[row]
            texts = [live_figures.words(every[k], figures[row, k]) or _UNKNOWN for k in own]
            texts += [] if way is None else [_to_go(way, row)]
            rows.append(
                (
                    robot.ljust(widest),
                    *_common(item, status),
                    *texts,
                    _state(item, status, state, row, starting=starting),
                )
            )
            row += 1
        heads = {live_figures.title(every[k]): _head(every[k]) for k in own}
        yield _table(rows, heads | ({} if way is None else {_TO_GO: _TO_GO}))


def _to_go(way: Way, row: int) -> str:
    to_go_m = way.to_go_m[row]
    return _UNKNOWN if to_go_m is None else way.on.robot_words(to_go_m)


def _table(rows: Sequence[Sequence[str | Text]], figures: Mapping[str, str]) -> Fitting:
    titles = list(figures)
    names = [*_COMMON, *titles, _STATE]
    heads = [*(_HEADS.get(name, name) for name in _COMMON), *figures.values(), _STATE]

    def make(left_out: Sequence[str]) -> Table:
        table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
        kept = [k for k, name in enumerate(names) if name not in left_out]
        for k in kept:
            left = names[k] in (_ROBOT, _STATE)
            table.add_column(heads[k], justify="left" if left else "right", no_wrap=names[k] != _STATE)
        table.columns[-1].min_width = min(_STATE_WIDTH, max(len(_STATE), *(len(row[-1]) for row in rows)))
        for row in rows:
            table.add_row(*(row[k] for k in kept))
        return table

    return Fitting(make, [*_LEAST_FIRST, *reversed(titles[1:])])


def _head(figure: Figure) -> str:
    words = f"{live_figures.title(figure)} {live_figures.unit(figure)}".rstrip()
    return "\n".join(textwrap.wrap(words, _HEAD_WIDTH))


def _common(item: RobotTick, status: RobotStatus | None) -> tuple[str, str, str]:
    pose = f"{item.x_m:z6.3f} {item.y_m:z6.3f} {math.degrees(item.psi_rad):z5.0f}"
    battery = _UNKNOWN if status is None or status.battery < 0.0 else f"{100 * status.battery:.0f}"
    return _UNKNOWN if item.lost else pose, f"{item.left_rad_s:6.2f} {item.right_rad_s:6.2f}", battery


def _begins(item: RobotTick, status: RobotStatus | None) -> str:
    """Return what has not begun of a robot, or is tried, while the run starts; an empty string for all else."""
    if status is not None and status.latch:
        return ROBOT_WORDS["drill"] if status.latch == Latch.DRILL else ""
    return ROBOT_WORDS["starting"] if status is None or item.lost else ""


def _state(
    item: RobotTick, status: RobotStatus | None, state: RunState | None, row: int, *, starting: bool
) -> Text:  # fmt: skip
    """Why a robot may move, or why not: its latch, its own halt or its group's, its gate, the barrier."""
    if starting and (words := _begins(item, status)):
        return Text(words)
    if status is not None and status.latch:
        return Text(ROBOT_WORDS["latched"].format(named(Latch, status.latch)), "bold red")
    if item.lost:
        return Text(ROBOT_WORDS["lost"], "red")
    if own := own_state(state, row, item):
        out = state is not None and driven_out(state, row)
        return Text(own if out else ROBOT_WORDS["halted"].format(own), "yellow")
    if status is None:
        return Text(ROBOT_WORDS["silent"], "red")
    moves = "drives" if not item.filtered else "kept_apart" if item.filtered == 1.0 else "unsafe"
    word = moves if status.gate == GateStatus.OPEN else "stands"
    return Text(ROBOT_WORDS[word], {"drives": "green", "kept_apart": "cyan"}.get(word, "yellow"))
