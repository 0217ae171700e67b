"""What groups tell at each tick, and what is drawn for them: data, by which everybody reads a tick's figures.

A recording keeps it beside its messages, so that it is read without the behaviours that made it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from robofleet.behaviours.interface import Behaviour, Dots, Figure, Line, Shape
from robofleet.core.arrays import Array

NAMING = 2  # numbers that name an image: its tracker's epoch, its number


class Group(NamedTuple):
    """A group as others see it."""

    name: str
    behaviour: str  # as the configuration names it
    robots: tuple[str, ...]
    figures: tuple[Figure, ...]
    shapes: tuple[Shape, ...] = ()

    @property
    def width(self) -> int:
        """How many numbers a tick has of each of its robots: the reference's x and y, then the figures."""
        return 2 + len(self.figures)

    def plain(self) -> dict[str, Any]:
        shapes = [plain_shape(shape) for shape in self.shapes]
        figures = [figure._asdict() for figure in self.figures]
        return {**self._asdict(), "robots": list(self.robots), "figures": figures, "shapes": shapes}

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> "Group":
        """Return what ``plain`` returned; KeyError or TypeError where it is something else."""
        shapes = [shape_from_plain(given) for given in plain["shapes"]]
        figures = tuple(Figure(**figure) for figure in plain["figures"])
        return cls(plain["name"], plain["behaviour"], tuple(plain["robots"]), figures, tuple(shapes))


def plain_shape(shape: Shape) -> dict[str, Any]:
    return {"kind": type(shape).__name__, **shape._asdict(), "points": np.round(shape.points, 6).tolist()}


def shape_from_plain(plain: Mapping[str, Any]) -> Shape:
    """Return what ``plain_shape`` returned; KeyError, TypeError or ValueError where it is something else."""
    shape = dict(plain)
    kind: type[Line] | type[Dots] = {"Line": Line, "Dots": Dots}[shape.pop("kind")]
    return kind(**shape | {"points": np.array(shape["points"]).reshape(-1, 2)})


@dataclass(frozen=True, kw_only=True)
class CommonFigure:
    """A figure by which behaviours can be compared: whichever behaviour tells or measures it, a bound may judge it, and
    it stands beside the run's own figures in ``summary.json`` where one group alone has it.

    Attributes:
        name: Of the ``Figure`` or the ``Measure``; it is drawn in mm.
        key: Its name in ``Behaviour.summary``.
        statistics: What the summary has of it, at least.
        bound: The key of ``run.bounds`` that judges it. Empty: none does.
        statistic: Which of the statistics is judged; of a list the first.
        label: The judged figure in words.
        level: The bound in words, where the figure is drawn.
    """

    name: str
    key: str
    statistics: frozenset[str] = frozenset({"mean", "max", "per_robot_mean"})
    bound: str = ""
    statistic: str = "mean"
    label: str = ""
    level: str = "bound of the mean"


COMMON_FIGURES = (
    CommonFigure(
        name="control_error", key="control_error_mm", bound="control_error_mean_mm", label="control error, mean"
    ),
    CommonFigure(
        name="timed_error", key="timed_error_mm", bound="timed_error_mean_mm", statistic="per_robot_mean",
        label="leader's timed error, mean", level="bound of the first robot's mean",
    ),
    CommonFigure(name="path_error", key="path_error_mm", bound="path_error_mean_mm", label="path error, mean"),
    CommonFigure(name="centre_error", key="centre_error_mm"),
    CommonFigure(
        name="spacing", key="spacing_m", statistics=frozenset({"mean", "max_deviation_mm"}),
        bound="spacing_max_deviation_mm", statistic="max_deviation_mm", label="largest spacing error", level="bound",
    ),
)  # fmt: skip
JUDGED_FIGURES = tuple(figure for figure in COMMON_FIGURES if figure.bound)


class GroupFigures(NamedTuple):
    """What a group told over K ticks."""

    references: Array  # (K, n, 2) [m]; NaN: none
    figures: Mapping[str, Array]  # (K, n) by the figures' names; NaN: not told


def size(groups: Sequence[Group], cameras: int = 1) -> int:
    """Return how many numbers a tick has: of all groups, then the names of the images of each camera but the first."""
    return sum(group.width * len(group.robots) for group in groups) + NAMING * (cameras - 1)


def names(groups: Sequence[Group]) -> list[str]:
    """Return what each of a tick's numbers is, in words."""
    own = "reference_x_m", "reference_y_m"
    return [f"{robot}: {name}" for g in groups for robot in g.robots for name in (*own, *(f.key for f in g.figures))]


def told(groups: Sequence[Group], numbers: Array) -> list[GroupFigures]:
    """Return what each group told, from the ticks' numbers (K, size)."""
    return [
        GroupFigures(values[..., :2], {figure.name: values[..., 2 + k] for k, figure in enumerate(group.figures)})
        for group, values in zip(groups, parts(groups, numbers), strict=True)
    ]


def parts(groups: Sequence[Group], numbers: Array) -> Iterator[Array]:
    """Yield each group's part (K, n, width) of the ticks' numbers (K, size): views of them."""
    first = 0
    for group in groups:
        last = first + group.width * len(group.robots)
        yield numbers[:, first:last].reshape(len(numbers), len(group.robots), group.width)
        first = last


def described(behaviour: Behaviour, name: str) -> Group:
    """Return a behaviour's group as others see it; ``name``: the behaviour's, as the configuration has it."""
    figures, shapes = tuple(behaviour.figures), tuple(behaviour.shapes())
    return Group(behaviour.team.name, name, behaviour.team.robots, figures, shapes)
