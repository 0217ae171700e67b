"""Messages whose version, sizes and counts are right and whose content is hostile, on every topic of a fleet.

    python -m tools.measure.runs.hostile_messages --messages 10000 [--config configs/teleop.yaml] [--seed N]

A fleet in lockstep hears them between its own, and with it who listens to a run (``hostile_listeners``), and an
operator's stop. What was recorded must make a report. Fields take the ends of their
types, values of all enums and beyond them, NaN and infinity, instants and numbers of other times. Every process must
step on. Then the fleet must start again, or say why not. It prints how many messages went where, and how the fleets
were afterwards.
"""

import math
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from robofleet.bus.keys import QUERIES, RECORDER, TOPICS, Topic, key
from robofleet.bus.layouts import VERSION, Layout
from robofleet.bus.messages import RECORDER_STATUS, RecorderStatus
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import S
from robofleet.operator.estop import EmergencyStop
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.supervisor import Phase
from tools.measure.program import program
from tools.measure.runs.hostile_listeners import listeners

CONFIGS = Path(__file__).parents[3] / "configs"
SHIPPED = ("platoon", "two-cameras", "script", "teleop", "go-to")
TRUTH = "tracker.source=truth"
_PERIOD_S = 0.011  # between two rounds, of one message on each topic
_FEW = 2  # topics
_ROUNDS = 250  # of one fleet
_SELDOM = 6  # of so many fleets one has all listeners
_WORDS = *b"start stop hold resume park reset arm status estop pictures".split(), b"leave r1", b"", b"\xff" * 99
_FLOATS = (
    0.0, -0.0, 1.0, -1.0, 2.0, 0.5, 1e-9, 5e-324, 1e6, -1e6, 1e300, -1e300, math.pi, math.nan, math.inf, -math.inf,
)  # fmt: skip


@dataclass
class Figures:
    messages: Counter[str] = field(default_factory=Counter)  # by topic
    fleets: int = 0
    starts: int = 0  # before and after the attacks
    phases: set[str] = field(default_factory=set)  # in which messages came
    endings: Counter[str] = field(default_factory=Counter)  # how the fleets were in the end


class Forge:
    """Makes payloads for a topic: some by changing one that a process of the fleet has sent, some from nothing."""

    def __init__(self, rng: np.random.Generator, now_ns: Callable[[], int]) -> None:
        self._rng, self._now_ns = rng, now_ns
        self.sent: dict[str, bytes] = {}  # newest true payload of each key

    def payload(self, topic: Topic, full: str) -> bytes:
        if topic.layout is None:
            return bytes(self._pick(_WORDS))
        sent = self.sent.get(full, b"")
        _, types = topic.layout.describe()
        head = np.dtype([(name, kind) for name, kind in types["fields"]])
        whole = len(sent) >= head.itemsize
        heads = np.frombuffer(sent[: head.itemsize], head).copy() if whole else np.zeros(1, head)
        rest = sent[head.itemsize :] if whole else b""
        if not whole or self._rng.random() < 0.3:
            self._spoil(heads, 1.0)
        else:
            self._spoil(heads, self._rng.choice((0.0, 0.1, 0.3)))
        heads["version"] = VERSION
        if isinstance(topic.layout, Layout) and topic.layout.blob:
            blob = rest if self._rng.random() < 0.5 else self._rng.bytes(int(self._rng.integers(200)))
            return heads.tobytes() + blob
        if isinstance(topic.layout, Layout):
            return heads.tobytes()
        item = np.dtype([(name, kind) for name, kind in types["items"]])
        count = int.from_bytes(sent[head.itemsize - 2 : head.itemsize], "little") if whole else 4
        if self._rng.random() < 0.1:
            most = min(65535, (topic.largest - head.itemsize) // item.itemsize)
            count = int(self._pick((0, 1, max(count - 1, 0), count + 1, most)))
        items = np.zeros(count, item)
        old = np.frombuffer(rest[: len(rest) // item.itemsize * item.itemsize][: count * item.itemsize], item)
        items[: len(old)] = old
        self._spoil(items, self._pick((0.0, 0.05, 0.3, 1.0)))
        heads["count"] = count
        numbers = b""
        if "rest" in types:
            first = int.from_bytes(sent[head.itemsize - 2 : head.itemsize], "little") * item.itemsize if whole else 0
            old_numbers = np.frombuffer(rest[first:], "<f8").copy() if whole else np.zeros(3)
            for k in np.flatnonzero(self._rng.random(len(old_numbers)) < 0.2):
                old_numbers[k] = self._pick(_FLOATS)
            numbers = old_numbers.tobytes()[: 8 * int(self._rng.integers(2, 1 + len(old_numbers) + 2))]
            if self._rng.random() < 0.8:
                numbers = old_numbers.tobytes()
        return heads.tobytes() + items.tobytes() + numbers

    def _spoil(self, rows: Any, share: float) -> None:
        for row in range(min(len(rows), 16)):
            for name in rows.dtype.names:
                if self._rng.random() < share:
                    rows[name][row] = self._value(rows.dtype[name])

    def _value(self, kind: np.dtype[Any]) -> Any:
        if kind.kind == "f":
            return self._pick(_FLOATS) if self._rng.random() < 0.7 else self._rng.normal(0, 2)
        ends = np.iinfo(kind)
        low, high, now_ns = int(ends.min), int(ends.max), self._now_ns()
        choices = [
            0, 1, 2, int(self._rng.integers(0, 128)), low, low + 1, high, high - 1, high // 2, now_ns,
            now_ns + 3600 * S, now_ns - S, int(self._rng.integers(low, high, endpoint=True, dtype=kind.type)),
        ]  # fmt: skip
        return min(max(self._pick(choices), low), high)

    def _pick(self, values: Any) -> Any:
        return values[int(self._rng.integers(len(values)))]


class Attack:
    """A fleet that is attacked on some topics, with everybody who listens to it."""

    def __init__(
        self, config: Config, figures: Figures, rng: np.random.Generator, topics: Sequence[Topic], folder: Path,
        *, whole: bool,
    ) -> None:  # fmt: skip
        self.config, self.figures = config, figures
        self.lockstep = Lockstep(config)
        bus, clock = self.lockstep.bus, self.lockstep.clock
        self._forge = Forge(rng, clock.now_ns)
        self._forging = False
        bus.tap(self._keep)
        self._keys = [target for target in targets(config) if target[0] in topics]
        self._publish = {full: bus.publisher(topic, name) for topic, name, full in self._keys if topic not in QUERIES}
        self._start()
        self._listeners = listeners(self.lockstep, config, folder, whole=whole)

    def _keep(self, message: tuple[str, bytes]) -> None:
        if not self._forging:
            self._forge.sent[message[0]] = message[1]

    def run(self, rounds: int) -> None:
        """Attack the fleet, which drives, and start it again."""
        for _ in range(rounds):
            for topic, name, full in self._keys:
                payload = self._forge.payload(topic, full)
                if len(payload) > topic.largest:
                    continue  # the bus itself drops it
                self._forging = True
                if topic in QUERIES:
                    self.lockstep.bus.ask(topic, name, payload)
                else:
                    self._publish[full](payload)
                self._forging = False
                self.figures.messages[topic.key] += 1
            self._listen()
        self._stop()
        for listener in self._listeners:
            listener.close()
        self._recover()

    def _listen(self) -> None:
        self.lockstep.advance(_PERIOD_S)
        self.figures.phases.add(self.lockstep.status.phase.name)
        for listener in self._listeners:
            listener.step(self.lockstep.clock.now_ns())

    def _start(self) -> None:
        """Let the fleet start, as an operator does."""
        for word in (b"reset", b"start"):
            self.lockstep.request(word)
            self.lockstep.advance(0.3)
        self.lockstep.advance(60.0, lambda: self.lockstep.status.phase in (Phase.RUNNING, Phase.FAULT))
        self.figures.starts += self.lockstep.status.phase is Phase.RUNNING

    def _stop(self) -> None:
        """Begin an operator's emergency stop."""
        stop = EmergencyStop(self.lockstep.bus, self.config.units, self.lockstep.clock.now_ns())
        for _ in range(20):
            self.lockstep.advance(_PERIOD_S)
            stop.step(self.lockstep.clock.now_ns())

    def _true_recorder(self) -> None:
        """Say what a recorder says all the time: lockstep has none that could contradict the attack."""
        self.lockstep.bus.publisher(RECORDER)(RECORDER_STATUS.encode(RecorderStatus(1, 1, 1, 0, 0)))

    def _recover(self) -> None:
        """Leave the fleet alone, start it, and note how it is: it runs, or it says why not."""
        self._true_recorder()
        self.lockstep.advance(5.0)
        self._start()
        status = self.lockstep.status
        running = status.phase is Phase.RUNNING
        self.figures.endings["it runs" if running else status.describe(self.config.ids).rpartition(": ")[2]] += 1
        self.lockstep.close()


def targets(config: Config) -> Iterator[tuple[Topic, str, str]]:
    """Yield all keys of a fleet: topic, name, key."""
    names = {"unit": [*config.units], "poses": [*config.camera_names], "group": [g.title for g in config.groups]}
    names |= {"sim": names["unit"], "request": ["supervisor", *config.trackers]}
    for topic in TOPICS:
        for name in names.get(topic.key.partition("/")[0], []) if "{}" in topic.key else [""]:
            yield topic, name, key(config.arena.name, topic, name)


def attack(config: Config, messages: int, seed: int, *, whole: bool = True) -> Figures:
    """Attack one fleet after the other, until each topic had so many messages; every second one on few topics only.

    ``whole``: with the listeners that take long, of some of the fleets.
    """
    figures, rng = Figures(), np.random.default_rng(seed)
    topics = [*dict.fromkeys(topic for topic, *_ in targets(config))]
    while few := [topic for topic in topics if figures.messages[topic.key] < messages]:
        few = few[:_FEW] if figures.fleets % 2 else topics
        with tempfile.TemporaryDirectory() as folder:
            seldom = whole and figures.fleets % _SELDOM == 0
            Attack(config, figures, rng, few, Path(folder), whole=seldom).run(min(messages, _ROUNDS))
        figures.fleets += 1
        rng.shuffle(topics)
    return figures


def main() -> None:
    parser = program(__doc__, messages=10000, seed=1)
    parser.add_argument("--config", type=Path)
    arguments = parser.parse_args()
    for file in [arguments.config] if arguments.config else [CONFIGS / f"{name}.yaml" for name in SHIPPED]:
        figures = attack(load_config(file, [TRUTH]), arguments.messages, arguments.seed)
        total, fleets = figures.messages.total(), figures.fleets
        print(f"{file.stem}: {total} messages on {len(figures.messages)} topics, {fleets} fleets")
        print(f"    starts {figures.starts}; phases {', '.join(sorted(figures.phases))}; afterwards:")
        for ending, times in figures.endings.most_common():
            print(f"    {times:6d} {ending}")


if __name__ == "__main__":
    main()
