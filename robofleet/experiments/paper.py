"""The paper's experiments by name; runs them, writes their figures and numbers, prints their tables."""

from importlib import import_module
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console, Group
from rich.table import Table as RichTable
from rich.text import Text

from robofleet.config.faults import did_you_mean
from robofleet.config.files import names
from robofleet.config.files.parameters import load_parameters
from robofleet.control.flow import FlowError
from robofleet.core.errors import RobofleetError
from robofleet.core.valid_json import dumps
from robofleet.experiments.results import Result, Table
from robofleet.experiments.simulate import DivergedError

SHIPPED = names.SHIPPED / "paper"  # the parameters of each experiment

# the module, whose ``run(parameters) -> Result`` does it, and its class of parameters: configs/paper/<name>.yaml
EXPERIMENTS = {
    "memoryless": ("memoryless", "MemorylessParameters"),
    "stability": ("stability", "StabilityParameters"),
    "closed-curve": ("closed_curve", "ClosedCurveParameters"),
    "lane-change": ("lane_change", "LaneChangeParameters"),
    "platoon": ("platoon", "PlatoonParameters"),
    "model-free": ("model_free", "ModelFreeParameters"),
    "comparison": ("comparison", "ComparisonParameters"),
}


class ExperimentError(RobofleetError):
    """Raised where an experiment ends without a result. The message says which, and why."""


def chosen(name: str) -> tuple[str, ...]:
    """Return the experiments that ``name`` (one of them, or all) stands for.

    Raises:
        ValueError: there is no such experiment.
    """
    if name == "all":
        return tuple(EXPERIMENTS)
    if name not in EXPERIMENTS:
        raise ValueError(f"there is no experiment {name!r}: {did_you_mean(name, [*EXPERIMENTS, 'all'])}")
    return (name,)


def parameters_of(name: str) -> Any:
    """Return an experiment's validated parameters; ConfigError with everything that is wrong in its file."""
    return load_parameters(getattr(_module(name), EXPERIMENTS[name][1]), SHIPPED / f"{name}.yaml")


def report(name: str, parameters: Any, folder: Path, *, quiet: bool) -> dict[str, Any]:
    """Run an experiment, write its files, print its tables unless ``quiet``; return what DIR/<name>.json holds.

    Its figures are DIR/<name>-<figure>.png and .svg.

    Raises:
        ExperimentError: with these parameters there is no result.
    """
    from robofleet.experiments.drawing import draw  # noqa: PLC0415

    try:
        result: Result = _module(name).run(parameters)
    except (FlowError, DivergedError) as error:
        raise ExperimentError(f"{name}: {error}") from error
    stems = [f"{name}-{figure.name}" for figure in result.figures]
    for figure, stem in zip(result.figures, stems, strict=True):
        draw(figure, folder / stem)
    content = {
        "version": 1,
        "experiment": name,
        "parameters": parameters.model_dump(mode="json"),
        "tables": [table.as_dict() for table in result.tables],
        "figures": stems,
        **result.data,
    }
    (folder / f"{name}.json").write_text(dumps(content, indent=1) + "\n")
    if not quiet:
        console = Console()
        for table in result.tables:
            console.print(printed(table))
    return content


def _module(name: str) -> Any:
    return import_module(f"robofleet.experiments.{EXPERIMENTS[name][0]}")


def printed(table: Table) -> Group:
    """Return a table as the terminal shows it, its notes below."""
    title = Text(table.title, "bold")  # of its own, because a table's title is folded to the table's width
    rich = RichTable(box=SIMPLE_HEAD, pad_edge=False)
    for i, column in enumerate(table.columns):
        rich.add_column(Text(column), justify="left" if i == 0 else "right", vertical="bottom", overflow="fold")
    for row in table.rows:
        rich.add_row(*table.text(row))
    if not table.notes:
        return Group(title, rich)
    notes = RichTable.grid(padding=(0, 1, 0, 0))
    for note in table.notes:
        notes.add_row("-", Text(note))
    return Group(title, rich, notes, Text(""))
