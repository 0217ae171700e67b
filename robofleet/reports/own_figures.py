"""What a group's part of ``summary.json`` holds, whatever its behaviour is: numbers by their names and units."""

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from robofleet.behaviours.interface import scale

_UNITS = {  # by the ends of names, the longest first
    "_rad_s": "rad/s", "_mm_s": "mm/s", "_m_s": "m/s", "_deg": "deg", "_rad": "rad", "_mm": "mm", "_m2": "m2",
    "_ms": "ms", "_us": "us", "_m": "m", "_s": "s",
}  # fmt: skip


class OwnFigure(NamedTuple):
    """A figure of a group."""

    key: str
    label: str  # "control error"
    unit: str
    mean: float | None  # of what counts; None: not measured
    largest: float | None  # magnitude
    each: tuple[float | None, ...]  # of each robot; empty: it is not of robots
    deviation: tuple[float, str] | None = None  # the largest one from what was asked, and its unit
    target: float | None = None  # what it should be

    @property
    def title(self) -> str:
        """Its label and unit in words, and what it should be."""
        target = "" if self.target is None else f" (of {self.target:g})"
        return ", ".join(filter(None, (self.label, self.unit))) + target


def own_figures(group: Mapping[str, Any]) -> Iterator[OwnFigure]:
    """Yield what can be shown of a group's part of the summary."""
    robots = len(group["robots"])
    for key, value in group.items():
        if key == "kept":  # by the group's script: plain numbers are shown
            numbers = {name: number for name, number in value.items() if is_number(number)}
            yield from (OwnFigure(name, *words(name), number, None, ()) for name, number in numbers.items())
        if key in ("behaviour", "robots", "asked", "kept"):
            continue
        label, unit = words(key)
        if value is None or is_number(value):
            yield OwnFigure(key, label, unit, value, None, ())
        elif isinstance(value, dict) and isinstance(value.get("mean"), list):
            gaps = [v if is_number(v) else None for v in value["mean"]]
            known = [gap for gap in gaps if gap is not None]
            off = value.get("max_deviation_mm")
            mean = sum(known) / len(known) if known else None
            deviation = (float(off), "mm") if off is not None and is_number(off) else None
            yield OwnFigure(key, label, unit, mean, None, _each(gaps, robots), deviation)
        elif isinstance(value, dict) and is_number(value.get("mean")):
            largest = value.get("max")
            each = value.get("per_robot_mean")
            yield OwnFigure(
                key, label, unit, value["mean"], largest if is_number(largest) else None,
                _each([v if is_number(v) else None for v in each], robots) if isinstance(each, list) else (),
            )  # fmt: skip


def heading(name: str, behaviour: str) -> str:
    """Return a group's name, and its behaviour where that is another word."""
    return name if name == behaviour else f"{name} ({behaviour})"


def words(key: str) -> tuple[str, str]:
    """Return a key's name in words, and its unit: ("control error", "mm")."""
    for ending, unit in _UNITS.items():
        if key.endswith(ending):
            return key.removesuffix(ending).replace("_", " "), unit
    return key.replace("_", " "), ""


def as_asked(group: Mapping[str, Any], figure: OwnFigure) -> OwnFigure:
    """Return a figure in the unit of what it should be, where the behaviour says that."""
    for key, value in group["asked"].items():
        label, unit = words(key)
        if label == figure.label and is_number(value):
            factor = scale(figure.unit, unit)
            mean, largest, *each = (v if v is None else v * factor for v in (figure.mean, figure.largest, *figure.each))
            return figure._replace(unit=unit, mean=mean, largest=largest, each=tuple(each), target=value)
    return figure


def _each(values: list[float | None], robots: int) -> tuple[float | None, ...]:
    """Return the values of robots; one fewer is of pairs: the first robot has none before it."""
    if len(values) == robots:
        return tuple(values)
    return (None, *values) if len(values) == robots - 1 else ()


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
