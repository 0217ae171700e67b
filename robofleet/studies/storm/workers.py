"""Plays many seeds in parallel on an engine."""

from collections.abc import Callable, Sequence
from contextlib import closing, redirect_stderr
from functools import partial
from io import StringIO

from robofleet.config.tree import Config
from robofleet.nodes.controller import compile_kernels
from robofleet.studies.engine import Engine
from robofleet.studies.storm.episode import Episode, play
from robofleet.studies.storm.tally import Tally
from robofleet.studies.storm.verdict import Violation

_REPEAT_EVERY = 25  # seeds: one is played twice

Watch = Callable[[Tally, Episode], None]  # called after every seed


def storm(config: Config, seeds: Sequence[int], engine: Engine, watch: Watch) -> Tally:
    """Play all the seeds; ``watch`` sees the tally grow."""
    compile_kernels(config)  # once, on disk, before every worker wants the same
    tally = Tally()
    with closing(engine.each(partial(examine, config), seeds)) as results:
        for index, episode, failure in results:
            if episode is None:
                tally.unplayed.append(f"seed {seeds[index]} could not be played: {failure}")
            else:
                tally.add(episode)
                watch(tally, episode)
    return tally


def examine(config: Config, seed: int) -> Episode:
    """Play a seed, and one in some twice: the same seed must leave the same messages."""
    with redirect_stderr(StringIO()):  # processes complain as they should: thousands of lines
        episode = play(config, seed)
        again = play(config, seed).trace_hash if seed % _REPEAT_EVERY == 0 else episode.trace_hash
    if again != episode.trace_hash:
        different = Violation("the same seed left other messages", 0.0, "", f"{episode.trace_hash} and {again}")
        return episode._replace(violations=(*episode.violations, different))
    return episode
