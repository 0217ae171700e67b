"""Workers that need the same kernel at the same time: one compiles it, the others wait and load it."""

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from robofleet.core.clock import MS, S, WallClock
from robofleet.core.kernels.store import KernelCache

_PATIENCE_NS = 120 * S  # a compilation that failed keeps its lock


@contextmanager
def compiled_once(locks: Path) -> Iterator[None]:
    """Lock each kernel that is not on disk yet, from the look at its file until it is kept."""
    load, save, clock = KernelCache.load_overload, KernelCache.save_overload, WallClock()
    held: dict[str, IO[bytes]] = {}

    def load_overload(kept: KernelCache, sig: Any, target_context: Any) -> Any:
        found = load(kept, sig, target_context)
        if found is not None:
            return found
        name = kept._name_of(sig, target_context.codegen().magic_tuple())
        if name in held:  # it failed before
            return None
        lock = (locks / name).open("wb")
        until_ns = clock.now_ns() + _PATIENCE_NS
        while clock.now_ns() < until_ns:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                clock.sleep_until(clock.now_ns() + 20 * MS)
        found = load(kept, sig, target_context)
        if found is None:
            held[name] = lock
        else:
            lock.close()
        return found

    def save_overload(kept: KernelCache, sig: Any, data: Any) -> None:
        save(kept, sig, data)
        if (lock := held.pop(kept._name_of(sig, data.codegen.magic_tuple()), None)) is not None:
            lock.close()

    KernelCache.load_overload, KernelCache.save_overload = load_overload, save_overload  # type: ignore[method-assign]
    try:
        yield
    finally:
        KernelCache.load_overload, KernelCache.save_overload = load, save  # type: ignore[method-assign]
        for lock in held.values():
            lock.close()
