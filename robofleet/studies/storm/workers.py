"""Many seeds at once, a process a core."""

import gc
import os
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stderr
from io import StringIO
from multiprocessing import get_context

from robofleet.config.tree import Config
from robofleet.processes.controller import compile_kernels
from robofleet.studies.storm.episode import Episode, play
from robofleet.studies.storm.tally import Tally
from robofleet.studies.storm.verdict import Violation

_TWICE = 25  # one seed in so many is played twice

Watch = Callable[[Tally, Episode], None]  # called after every seed

_config: Config  # of this worker


def storm(config: Config, seeds: Iterable[int], watch: Watch) -> Tally:
    """Play all the seeds; ``watch`` sees the tally grow."""
    compile_kernels(config)  # once, on disk, before every worker wants the same
    tally, cores = Tally(), len(os.sched_getaffinity(0))
    with ProcessPoolExecutor(cores, get_context("spawn"), _ready, (config,)) as pool:
        for episode in pool.map(examine, seeds, chunksize=4):
            tally.add(episode)
            watch(tally, episode)
    return tally


def _ready(config: Config) -> None:
    global _config  # noqa: PLW0603 - a worker is its configuration
    _config = config
    gc.freeze()


def examine(seed: int) -> Episode:
    """Play a seed, and one in some twice: the same seed must leave the same messages."""
    with redirect_stderr(StringIO()):  # processes complain as they should: thousands of lines
        episode = play(_config, seed)
        again = play(_config, seed).trace_hash if seed % _TWICE == 0 else episode.trace_hash
    if again != episode.trace_hash:
        different = Violation("the same seed left other messages", 0.0, "", f"{episode.trace_hash} and {again}")
        return episode._replace(violations=(*episode.violations, different))
    return episode
