"""Messages while kernels are compiled: which, the progress, and the time left."""

import gc
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

from robofleet.core.clock import S, WallClock, stopwatch_ns
from robofleet.core.kernels import reached

_MARK = "compiling"
_LINE_EVERY_NS = 5 * S  # where it is not drawn
_COLLECTED_EVERY = 100_000  # objects; compiling makes many, hardly any of them garbage: a tenth of its time was lost


class Progress(NamedTuple):
    """How far the kernels of one process are."""

    name: str  # "control" or "camera"
    done: int
    total: int
    left_s: float  # about; negative: not known yet
    share: float  # of the work, from 0 to 1

    def encode(self) -> str:
        return f"{_MARK} {self.name} {self.done} {self.total} {self.left_s:.1f} {self.share:.3f}"

    def words(self) -> str:
        left = f", about {self.left_s:.0f} s left" if self.left_s >= 0 else ""
        return f"compiling the {self.name} kernels, once for this installation: {self.done} of {self.total}{left}"


Say = Callable[[Progress], None]


def decoded(line: str) -> Progress | None:
    """Return what a child said; None where it is something else."""
    words = line.split()
    if len(words) != 1 + len(Progress._fields) or words[0] != _MARK:
        return None
    return Progress(words[1], int(words[2]), int(words[3]), float(words[4]), float(words[5]))


@contextmanager
def told(name: str, kernels: tuple[Any, ...], say: Say) -> Iterator[None]:
    """Say how far it is whenever one of ``kernels``, or one that they call, was compiled; nothing where all are loaded.

    The work of a kernel is taken as the length of its code. A process that compiles keeps its turn until all is done.
    """
    from numba.core import event  # noqa: PLC0415 - it takes a second to load

    from robofleet.core.kernels import store  # noqa: PLC0415 - so does this

    work = {code: len(code.co_code) for code in (kernel.py_func.__code__ for kernel in reached(*kernels))}
    done: set[Any] = set()
    began_ns = 0

    def spread() -> None:
        elapsed_s, share = ((stopwatch_ns() - began_ns) / S, sum(work[code] for code in done) / sum(work.values()))
        say(Progress(name, len(done), len(work), elapsed_s * (1 - share) / share if done else -1.0, share))

    class Listener(event.Listener):
        def on_start(self, _event: Any) -> None:
            nonlocal began_ns
            if not began_ns:
                spread()
                turn.enter_context(store.turn(WallClock()))
                began_ns = stopwatch_ns()

        def on_end(self, compiled: Any) -> None:
            if (code := compiled.data["dispatcher"].py_func.__code__) in work and code not in done:
                done.add(code)
                spread()

    thresholds = gc.get_threshold()
    gc.set_threshold(_COLLECTED_EVERY)
    try:
        with ExitStack() as turn, event.install_listener("numba:compile", Listener()):
            yield
    finally:
        gc.set_threshold(*thresholds)


def on_stderr() -> Say:
    """Return what writes a line to stderr at the beginning, and one every few seconds."""
    next_ns = 0

    def say(progress: Progress) -> None:
        nonlocal next_ns
        if stopwatch_ns() >= next_ns:
            next_ns = stopwatch_ns() + _LINE_EVERY_NS
            print(progress.words(), file=sys.stderr, flush=True)

    return say
