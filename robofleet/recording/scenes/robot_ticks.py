"""Each robot's ticks as plain numbers, one channel a robot: what viewers plot without code.

The figures are those of ``metrics.csv``, made by the same functions, from the messages as they come: some seconds of
them at once, which costs a fraction of what single ticks would.
"""

from array import array
from bisect import bisect_left
from collections.abc import Sequence

from robofleet.behaviours import described
from robofleet.bus.keys import STATUS, TICK, TRUTH, key
from robofleet.bus.messages import TICK_RECORD
from robofleet.config.tree import Config
from robofleet.recording.channels import of_protobuf
from robofleet.recording.columns import COLUMNS, own_name, own_names, own_table, table
from robofleet.recording.gauge import Gauge
from robofleet.recording.run import Recording, Run
from robofleet.recording.scenes.scalars import Scalar, Scalars

BATCH = 64  # ticks: in real time some seconds, which is what a kill may lose of them
LARGE_BATCH = 1024  # in lockstep: what a batch costs by itself is shared by more
_HELD_TICKS = 10  # wait until every robot's truth of that instant must have come
PACKAGE, MESSAGE = "robofleet", "RobotTick"


def topic(robot: str) -> str:
    return f"/robots/{robot}/tick"


def message_name(gauges: Sequence[Gauge], group: str) -> str:
    """Return what the ticks of a group's robots are called; with several groups, each has a message of its own."""
    return MESSAGE if len(gauges) == 1 else f"{MESSAGE}_{group.replace('-', '_')}"


def _described(gauges: Sequence[Gauge], gauge: Gauge) -> Scalars:
    own = (
        Scalar(own_name(name), "<f4", f"{curve.meaning or curve.title} [{curve.unit or '1'}]; NaN: not known")
        for name, curve in gauge.columns.items()
    )
    fields = (
        Scalar("tick", "<u4", "the controller's tick, as in rf/<arena>/tick"),
        Scalar("run_tick", "<i4", "of the ticks in which the fleet was running, from 0; -1: it was not"),
        *(Scalar(column.name, "<f4", f"{column.meaning}; NaN: not known") for column in COLUMNS),
        *own,
    )
    return Scalars(PACKAGE, message_name(gauges, gauge.group.name), fields)


class RobotTicks:
    """Makes each robot's ticks of the bus's messages, which it is given in order."""

    def __init__(self, config: Config, groups: tuple[described.Group, ...], batch: int = BATCH) -> None:
        self._batch = batch
        arena, robots = config.arena.name, config.members
        self._tick_key = key(arena, TICK)
        self._size = TICK_RECORD.dtype(len(robots), described.size(groups, len(config.camera_names))).itemsize
        self._status_keys = {key(arena, STATUS, unit) for unit in config.units}
        self._truth_keys = {key(arena, TRUTH, unit) for unit in config.units}
        self._statuses: dict[str, bytes] = {}  # the newest ones since the tick before
        self._window = Recording(config, file_groups=groups)
        self._came: array[int] = array("Q")  # when each tick of the window did [ns]
        gauges = self._window.gauges  # and what they compute with is loaded by that
        self._messages = [_described(gauges, gauge) for gauge in gauges]
        self._own = [own_names([gauge]) for gauge in gauges]
        self.channels = [
            of_protobuf(topic(robot), message.name, message.descriptor)
            for group, message in zip(groups, self._messages, strict=True)
            for robot in group.robots
        ]

    def update(self, full: str, payload: bytes, log_ns: int) -> Sequence[tuple[str, int, bytes]]:
        """Return (topic, instant, message) of what is complete since the last call."""
        if full in self._truth_keys:
            self._window.add(full, payload)
        elif full in self._status_keys:
            self._statuses[full] = payload
        elif full == self._tick_key and len(payload) == self._size:
            for own, status in self._statuses.items():
                self._window.add(own, status)
            self._statuses.clear()
            self._window.add(full, payload)
            self._came.append(log_ns)
            if len(self._came) == self._batch + _HELD_TICKS:
                return self._take(self._batch)
        return ()

    def rest(self) -> Sequence[tuple[str, int, bytes]]:
        return self._take(len(self._came)) if self._came else ()

    def _take(self, count: int) -> list[tuple[str, int, bytes]]:
        run = Run(self._window, every_tick=True)
        ticks, values = run.ticks[:count], table(run)[:count]
        common = {name: ticks[name][:, None] for name in ("tick", "run_tick")}
        by_robot: list[list[bytes]] = []
        for part, message, names in zip(run.parts, self._messages, self._own, strict=True):
            robot_values = {column.name: values[:, part.rows, index] for index, column in enumerate(COLUMNS)}
            own = own_table(part, names)[:count]
            robot_values |= {name: own[..., index] for index, name in enumerate(names)}
            n = len(part.group.robots)
            messages = message.messages((count, n), common | robot_values)
            by_robot += [messages[k::n] for k in range(n)]
        places = [(topic, came) for came in self._came[:count] for topic, *_ in self.channels]
        self._forget(count)
        in_order = (robot_message for tick in zip(*by_robot, strict=True) for robot_message in tick)
        return [(*index, message) for index, message in zip(places, in_order, strict=True)]

    def _forget(self, count: int) -> None:
        """Drop the messages that later ticks do not need."""
        window = self._window
        needed = window.places(self._tick_key)[max(0, count - _HELD_TICKS)]
        for full in self._status_keys | self._truth_keys:
            window.forget(full, max(0, bisect_left(window.places(full), needed) - 1))
        window.forget(self._tick_key, count)
        del self._came[:count]
