"""The engine that ``--on`` names: this machine, or Ray, started for this command or an existing cluster."""

import logging
import os
import secrets
import socket
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, chdir, contextmanager
from typing import Any, TypeVar

from robofleet.core.refusal import RefusedError, need_extra
from robofleet.studies.engine import WORKER_DIED, Engine, Finished, Local, Results, attempt

LOCAL, RAY = "local", "ray"
_CONNECT_S = 5.0  # until the address answers
_RETRIES = 1  # of a unit whose worker died
_TOKEN = "it may ask for a token: set RAY_AUTH_MODE=token, and RAY_AUTH_TOKEN to the cluster's, in both places"
_ALL_INTERFACES = "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"  # "0": Ray listens on loopback alone, as it does on a Mac
_TASKS_A_CPU = 2  # under way, of the cluster

Item = TypeVar("Item")
Result = TypeVar("Result")


class Cluster:
    """Tasks of Ray Core."""

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs

    def each(self, work: Callable[[Item], Result], items: Sequence[Item]) -> Results[Result]:
        import ray  # noqa: PLC0415 - an extra

        task: Any = ray.remote(num_cpus=1, max_retries=_RETRIES)(attempt)
        kept = ray.put(work)
        left = iter(enumerate(items))
        under_way: dict[Any, int] = {}
        try:
            while True:
                while len(under_way) < _TASKS_A_CPU * self.jobs and (unit := next(left, None)) is not None:
                    under_way[task.remote(kept, unit[1])] = unit[0]
                if not under_way:
                    return
                done, _ = ray.wait(list(under_way))
                for reference in done:
                    index = under_way.pop(reference)
                    try:
                        yield Finished(index, *ray.get(reference))
                    except ray.exceptions.RayError as lost:
                        yield Finished(index, None, _why(lost))
        finally:
            for reference in under_way:
                ray.cancel(reference, force=True)


@contextmanager
def cluster(address: str, jobs: int | None) -> Iterator[Cluster]:
    """Connect to the cluster at ``HOST:PORT``; to a new one on this machine where that is empty."""
    need_extra("ray", "ray")
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a laboratory's runs are nobody else's business
    if address:
        _reach(address)
        started = _started(f"ray://{address}", _TOKEN, address=f"ray://{address}")
    else:
        started = _own(jobs or len(os.sched_getaffinity(0)))
    with started as ray:
        cores = round(ray.cluster_resources().get("CPU", 1))
        yield Cluster(min(jobs or cores, cores))


@contextmanager
def _own(cores: int) -> Iterator[Any]:
    """Start Ray on this machine for this command alone. Whoever reaches Ray has it run any program as this user.

    So it listens on loopback, asks other users of this machine for a token, and keeps its sockets in a private folder.
    """
    os.environ[_ALL_INTERFACES] = "0"
    os.environ["RAY_AUTH_MODE"] = "token"
    os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))
    options: dict[str, Any] = {"address": "local", "num_cpus": cores, "include_dashboard": False}
    with tempfile.TemporaryDirectory(prefix="rf-ray-", ignore_cleanup_errors=True) as folder, ExitStack() as held:
        with chdir(folder):  # Ray lets its workers import modules of the folder in which it starts
            ray = held.enter_context(_started("ray", "try --on local", **options, _temp_dir=folder))
        yield ray


@contextmanager
def _started(where: str, mend: str, **options: Any) -> Iterator[Any]:
    """Yield Ray, initialised; RefusedError in one line where it does not start."""
    import ray  # noqa: PLC0415 - an extra

    try:
        ray.init(**options, log_to_driver=False, logging_level=logging.ERROR)
    except Exception as error:
        ray.shutdown()
        raise RefusedError(f"--on: {where} cannot be used: {' '.join(str(error).split())}: {mend}") from error
    try:
        yield ray
    finally:
        ray.shutdown()


def _reach(address: str) -> None:
    """Refuse at once what Ray would try for minutes."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or int(port) > 65535:
        raise RefusedError(f"--on: ray://{address} is no address: write ray://HOST:PORT, as ray://10.0.0.5:10001")
    try:
        socket.create_connection((host.strip("[]"), int(port)), _CONNECT_S).close()
    except OSError as error:
        why = error.strerror or str(error)
        start = f"`ray start --head --ray-client-server-port={port}` starts one there"
        raise RefusedError(f"--on: ray://{address} cannot be reached: {why}: {start}") from error


def _why(lost: Exception) -> str:
    """Return in one line why Ray has no result of a task."""
    name = type(lost).__name__
    known = ("WorkerCrashedError", "OutOfMemoryError", "NodeDiedError", "LocalRayletDiedError")
    return WORKER_DIED if name in known else f"Ray: {name}: {' '.join(str(lost).split())}"


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
