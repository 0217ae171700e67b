"""What the operator sees of a sweep: a run that broke at once, and in the end how many did, and the figures."""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from robofleet.config.faults import counted
from robofleet.studies.sweep.factors import measures
from robofleet.studies.sweep.load import Study
from robofleet.studies.sweep.table import Ran

_SHOWN_RUNS = 10  # that are printed as they break


def lines(ran: Ran, before: int) -> Iterator[str]:
    """Yield what there is to say of a run that did not complete; ``before``: how many did not so far."""
    if ran.outcome != "completed" and before == _SHOWN_RUNS:
        yield "more runs break: the page and the table have them all"
    elif ran.outcome != "completed" and before < _SHOWN_RUNS:
        yield f"run {ran.plan.number}: {ran.outcome}: {ran.cause}"
        yield f"  {ran.plan.replay}"


def summarise(study: Study, runs: Sequence[Ran], files: Sequence[Path]) -> None:
    console = Console()
    table = Table(title=Text(_ended(study, runs), "bold"), title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for column in ("figure", "median", "worst", "in run"):
        table.add_column(column, justify="left" if column == "figure" else "right", no_wrap=column != "figure")
    for measure in measures(runs):
        worst = measure.values[measure.worst]
        cells = f"{np.nanmedian(measure.values):.4g}", f"{worst:.4g}", str(runs[measure.worst].plan.number)
        table.add_row(Text(measure.title), *cells)
    if table.row_count:
        console.print(table)
    else:
        print(_ended(study, runs))
    for count, what in (
        (sum(bool(ran.missed) for ran in runs), "did not meet a bound"),
        (sum(bool(ran.not_judged) for ran in runs), "were not checked by a bound: its figure was not measured"),
    ):
        if count:
            print(f"{counted(count, 'run')} {what}", file=sys.stderr)
    for file in files:
        print(file)


def as_json(study: Study, runs: Sequence[Ran], folder: Path) -> dict[str, Any]:
    found = measures(runs)
    return {
        "sweep": study.name,
        "config": str(study.config),
        "folder": str(folder),
        "runs": len(runs),
        "completed": sum(ran.outcome == "completed" for ran in runs),
        "bounds_missed": sum(bool(ran.missed) for ran in runs),
        "bounds_not_judged": sum(bool(ran.not_judged) for ran in runs),
        "figures": {
            measure.title: {
                "median": float(np.nanmedian(measure.values)),
                "worst": float(measure.values[measure.worst]),
                "run": runs[measure.worst].plan.number,
            }
            for measure in found
        },
        "failed": [
            {
                "run": ran.plan.number,
                "settings": ran.plan.values,
                "faults": ran.plan.faults,
                "seed": ran.plan.seed,
                "outcome": ran.outcome,
                "cause": ran.cause,
                "replay": ran.plan.replay,
            }
            for ran in runs
            if ran.outcome != "completed"
        ],
    }


def _ended(study: Study, runs: Sequence[Ran]) -> str:
    done = sum(ran.outcome == "completed" for ran in runs)
    return f"{study.name}: {done:,} of {len(runs):,} runs completed"
