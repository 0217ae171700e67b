"""A run in lockstep and what was said in it, as a recorder hears it."""

import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mcap.reader import make_reader
from mcap.summary import Summary

from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.recording.log import RunLog
from robofleet.recording.run import Recording
from robofleet.runs.lockstep import Lockstep
from tests.shipped import PLATOON

Messages = list[tuple[str, bytes, int]]  # key, payload, instant [ns]


def config(*overrides: str) -> Config:
    return load_config(
        PLATOON, ["tracker.source=truth", "run.duration_s=2", "drivers.robots_per_process=1", *overrides]
    )


def said_in(run_config: Config) -> Messages:
    messages: Messages = []
    run = Lockstep(run_config)
    run.bus.tap(lambda message: messages.append((*message, run.clock.now_ns())))
    run.run()
    return messages


def in_order(recording: Recording) -> list[tuple[str, bytes]]:
    """Return the messages as they came, all keys together."""
    placed = [(index, full, data) for full in recording.messages for index, data in recording.placed(full)]
    return [(full, data) for _, full, data in sorted(placed)]


def index(file: Path) -> tuple[Summary, dict[str, int]]:
    """Return the index of a file, and how many messages it counts of each topic."""
    with file.open("rb") as stream:
        summary = make_reader(stream, validate_crcs=True).get_summary()
    assert summary is not None and summary.statistics is not None
    counts = summary.statistics.channel_message_counts
    return summary, {channel.topic: counts.get(number, 0) for number, channel in summary.channels.items()}


@contextmanager
def room_for(bytes_of_a_file: int) -> Iterator[None]:
    """Let no file become longer: the kernel then writes a part of what is asked for, and refuses the rest.

    Python would keep the byte code of a module that is imported meanwhile in part, for whoever imports it later.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    kept, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    resource.setrlimit(resource.RLIMIT_FSIZE, (bytes_of_a_file, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        sys.dont_write_bytecode = kept


def write(log: RunLog, messages: Messages) -> None:
    for full, payload, at_ns in messages:
        log.add(full, payload, at_ns)
        log.flush(at_ns)
