"""Where many units of work run: in processes of this machine, or as tasks of Ray (``cluster.py``).

An engine maps a pure function over picklable items and yields each result as it is finished, in whichever order. It
schedules nothing itself, and keeps few units under way, so that whoever ends it early loses only those. A unit that
raises, or whose worker dies, is named and ends nothing else.
"""

import faulthandler
import gc
import os
import signal
import sys
import threading
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, connection, get_context, parent_process
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

WORKER_DIED = "its worker process died (out of memory, or killed)"

_AHEAD = 2  # units under way for each worker: one that works, one that waits
_ENVIRONMENT = {  # of a worker: there is one for each core, and modules of the current folder are no worker's
    "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONSAFEPATH": "1",
}  # fmt: skip

Item = TypeVar("Item")
Result = TypeVar("Result")
Unit = tuple[int, Any]  # its place among the items, and the item


class Finished(NamedTuple, Generic[Result]):
    """What became of a unit: its result, or why there is none."""

    item: int  # its index
    result: Result | None
    failure: str = ""  # one line; empty: there is a result


Results = Generator[Finished[Result], None, None]


class Engine(Protocol):
    """Somewhere to run."""

    jobs: int  # workers

    def each(self, work: Callable[[Item], Result], items: Sequence[Item]) -> Results[Result]:
        """Yield what becomes of every item as it is finished; close the iterator to end what is under way."""


def attempt(work: Callable[[Item], Result], item: Item) -> tuple[Result | None, str]:
    """Return a result, or in one line why there is none: no exception has to travel."""
    try:
        return work(item), ""
    except Exception as error:  # noqa: BLE001 - one unit's failure is not the others'
        frame = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{os.path.basename(frame.filename)}:{frame.lineno}"  # noqa: PTH119 - of a name
        return None, " ".join(f"{type(error).__name__}: {error} ({where})".split())


class Local:
    """Processes of this machine."""

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs

    def each(self, work: Callable[[Item], Result], items: Sequence[Item]) -> Results[Result]:
        """See ``Engine``. Where a worker died, what was under way is tried again one by one: that names the culprit."""
        left: deque[Unit] = deque(enumerate(items))
        while left:
            suspects = yield from _through(work, left, min(self.jobs, len(left)), _AHEAD)
            while suspects:
                for index, _ in (yield from _through(work, suspects, 1, 1)):
                    yield Finished(index, None, WORKER_DIED)


def _through(
    work: Callable[[Any], Any], units: deque[Unit], jobs: int, ahead: int
) -> Generator[Finished[Any], None, deque[Unit]]:
    """Take units through a pool until there are none; returns those that were under way when it broke."""
    under_way: dict[Future[Any], Unit] = {}
    lost: deque[Unit] = deque()
    with _pool(work, jobs) as pool:
        while (units or under_way) and not lost:
            while units and len(under_way) < ahead * jobs:
                under_way[pool.submit(_one, units[0][1])] = units[0]
                units.popleft()
            done, _ = wait(under_way, return_when=FIRST_COMPLETED)
            if any(isinstance(future.exception(), BrokenProcessPool) for future in done):
                done, _ = wait(under_way)
            for future in done:
                unit = under_way.pop(future)
                if future.exception() is not None:
                    lost.append(unit)
                else:
                    yield Finished(unit[0], *future.result())
    return deque(sorted(lost, key=lambda unit: unit[0]))


@contextmanager
def _pool(work: Callable[[Any], Any], jobs: int) -> Iterator[ProcessPoolExecutor]:
    """Open a pool whose workers end with us: whatever is under way when this is left is not waited for."""
    others = set(active_children())
    before = {name: os.environ.get(name) for name in _ENVIRONMENT}
    os.environ.update(_ENVIRONMENT)
    pool = ProcessPoolExecutor(jobs, get_context("spawn"), _begin, (work, list(sys.path)))
    finished = False
    try:
        yield pool
        finished = True
    finally:
        if not finished:
            for worker in set(active_children()) - others:
                worker.terminate()
        pool.shutdown(cancel_futures=True)
        for name, value in before.items():
            os.environ.pop(name) if value is None else os.environ.update({name: value})


_work: Callable[[Any], Any]  # of this worker


def _begin(work: Callable[[Any], Any], path: list[str]) -> None:
    """Be a worker: Ctrl-C is for the one who started it, and without that one it ends."""
    global _work  # noqa: PLW0603 - a worker is its work
    _work = work
    faulthandler.enable()  # one that crashes says where
    gc.freeze()  # what was loaded for it stays: no collector need look there
    sys.path[:] = path
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def _one(item: Any) -> tuple[Any, str]:
    return attempt(_work, item)
