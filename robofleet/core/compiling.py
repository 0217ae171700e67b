"""Messages while kernels are compiled: how many, and how much of the work is done."""

import gc
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

from robofleet.core.clock import S, WallClock, stopwatch_ns
from robofleet.core.kernels import label, reached

_MARK = "compiling"
_LINE_EVERY_NS = 10 * S  # where it is not drawn
_COLLECTED_EVERY = 100_000  # objects; compiling makes many, hardly any of them garbage: a tenth of its time was lost
# Fitted to all kernels of a platoon under a simulated camera (R2 0.81): what a byte of code takes to be compiled, and
# what it takes again in a kernel that Python calls, of which all kernels that it calls become a part.
_BYTE_S, _BYTE_AGAIN_S = 2.8e-4, 0.5e-4


class Progress(NamedTuple):
    """How far the kernels of a process are that it must compile."""

    done: int
    total: int
    done_s: float  # of the work, in seconds of one core of the machine on which it was measured
    work_s: float

    def encode(self) -> str:
        return f"{_MARK} {self.done} {self.total} {self.done_s:.3f} {self.work_s:.3f}"


Say = Callable[[Progress], None]


class _Work(NamedTuple):
    """A kernel that must be compiled."""

    label: str  # of its file
    seconds: float


def decoded(line: str) -> Progress | None:
    """Return what a child said; None where it is something else."""
    words = line.split()
    if len(words) != 1 + len(Progress._fields) or words[0] != _MARK:
        return None
    return Progress(int(words[1]), int(words[2]), float(words[3]), float(words[4]))


@contextmanager
def told(kernels: tuple[Any, ...], say: Say) -> Iterator[None]:
    """Say how far it is whenever one of ``kernels``, or of those that they call, was compiled; nothing where none is.

    A process that compiles keeps its turn until all is done.
    """
    from numba.core import event  # noqa: PLC0415 - it takes a second to load

    from robofleet.core.kernels import store  # noqa: PLC0415 - so does this

    work: dict[Any, _Work] = {}
    done: set[Any] = set()

    def spread() -> None:
        done_s = sum(work[code].seconds for code in done)
        say(Progress(len(done), len(work), done_s, sum(part.seconds for part in work.values())))

    class Listener(event.Listener):
        begun = False

        def on_start(self, _event: Any) -> None:
            if not self.begun:
                self.begun = True
                work.update(_work(kernels, store.labels()))
                spread()
                turn.enter_context(store.turn(WallClock()))

        def on_end(self, compiled: Any) -> None:
            if (code := compiled.data["dispatcher"].py_func.__code__) in work and code not in done:
                on_disk = store.labels()  # others compile the same ones
                done.update([code], (code for code, part in work.items() if part.label in on_disk))
                spread()

    thresholds = gc.get_threshold()
    gc.set_threshold(_COLLECTED_EVERY)
    try:
        with ExitStack() as turn, event.install_listener("numba:compile", Listener()):
            yield
    finally:
        gc.set_threshold(*thresholds)


def _work(kernels: tuple[Any, ...], on_disk: frozenset[str]) -> dict[Any, _Work]:
    """Return the work of those that must be compiled, by their code."""
    work = {}
    for kernel in reached(*kernels):
        if (name := label(kernel.py_func.__name__, kernel.meaning())) not in on_disk:
            again = sum(map(_bytes, reached(kernel))) if kernel in kernels else 0
            work[_code(kernel)] = _Work(name, _BYTE_S * _bytes(kernel) + _BYTE_AGAIN_S * again)
    return work


def _code(kernel: Any) -> Any:
    return kernel.py_func.__code__


def _bytes(kernel: Any) -> int:
    return len(_code(kernel).co_code)


def on_stderr() -> Say:
    """Return what writes a line to stderr at the beginning, and one every ten seconds."""
    next_ns = 0

    def say(progress: Progress) -> None:
        nonlocal next_ns
        if stopwatch_ns() >= next_ns:
            next_ns = stopwatch_ns() + _LINE_EVERY_NS
            print(f"compiling kernels, {progress.done} of {progress.total}", file=sys.stderr, flush=True)

    return say
