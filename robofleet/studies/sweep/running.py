"""Plays the runs of a sweep that are not finished yet, wherever the engine has room for them."""

from collections.abc import Callable
from contextlib import closing

from robofleet.nodes.controller import compile_kernels
from robofleet.studies.engine import Engine
from robofleet.studies.sweep.journal import Journal
from robofleet.studies.sweep.load import Study
from robofleet.studies.sweep.table import Ran
from robofleet.studies.sweep.unit import Job, play

Watch = Callable[[Ran], None]  # called after every run


def run(study: Study, engine: Engine, journal: Journal, watch: Watch) -> list[Ran]:
    """Play them, keep each in the journal, and return all runs by their numbers."""
    left = [run for run in study.runs if run.number not in journal.played]
    failures: dict[int, str] = {}
    if left:
        compile_kernels(left[0].config)  # once, on disk, before every worker wants the same
    jobs = [Job(study.config.stem, run.config) for run in left]
    with closing(engine.each(play, jobs)) as results:
        for index, played, failure in results:
            plan = left[index]
            if played is None:
                failures[plan.number] = failure
            else:
                journal.add(plan.number, played)
            watch(Ran(plan, played, failure))
    return [Ran(plan, journal.played.get(plan.number), failures.get(plan.number, "")) for plan in study.runs]
