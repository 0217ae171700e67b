"""The engine that ``--on`` names."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

from robofleet.core.refusal import RefusedError
from robofleet.studies.cluster import cluster
from robofleet.studies.engine import Engine, Local

LOCAL, RAY = "local", "ray"


@contextmanager
def opened(on: str, jobs: int | None) -> Iterator[Engine]:
    """Open the engine of ``--on``: ``local``, ``ray`` or ``ray://HOST:PORT``; RefusedError where there is none.

    ``jobs``: how many workers; None: as many as there are processors.
    """
    if on == LOCAL:
        yield Local(jobs or len(os.sched_getaffinity(0)))
    elif on == RAY or on.startswith(f"{RAY}://"):
        with cluster(on.removeprefix(RAY).removeprefix("://"), jobs) as engine:
            yield engine
    else:
        raise RefusedError(f"--on: {on!r} is no engine: write local, ray, or ray://HOST:PORT")
