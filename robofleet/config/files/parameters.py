"""Files of parameters beside the configuration: a YAML file read into a frozen tree; says what is wrong where."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from robofleet.config.faults import Complaint, plain_words
from robofleet.config.files.names import missing
from robofleet.config.files.yamlfile import Mistake, Node, Position, Source, read_yaml
from robofleet.config.load import ConfigError
from robofleet.core.settings import Model

Loc = tuple[str | int, ...]
M = TypeVar("M", bound="Parameters")


class Parameters(Model):
    """What such a file holds, one class a kind of file."""

    def complaints(self) -> Iterator[Complaint]:
        """Yield (dotted path, message) for keys that are right by themselves and contradict others."""
        return iter(())


def load_parameters(kind: type[M], file: Path) -> M:
    """Read and validate a file of parameters.

    Raises:
        ConfigError: with everything that is wrong, one line ``file:line:column: path: message`` each.
    """
    return load_placed(kind, file)[0]


def load_placed(kind: type[M], file: Path) -> tuple[M, Node]:
    """Read and validate as ``load_parameters``; returns also where everything stands in the file."""
    try:
        root, faults = read_yaml(file, Source(str(file)))
    except FileNotFoundError:
        root, faults = None, [Mistake(Position(Source(str(file)), 1, 1, ""), missing(file))]
    if root is None:
        raise ConfigError(str(fault) for fault in faults)
    try:
        parameters = kind.model_validate(root.plain())
    except ValidationError as invalid:
        errors = invalid.errors(include_url=False)
        faults += [fault for error in errors if (fault := _fault(root, kind, error)) is not None]
    else:
        faults += [mistake_at(root, _loc(path), message) for path, message in parameters.complaints()]
        if not faults:
            return parameters, root
    faults.sort(key=lambda fault: (fault.place.line, fault.place.column))
    raise ConfigError(dict.fromkeys(str(fault) for fault in faults))


def mistake_at(root: Node, loc: Loc, message: str, *, at_key: bool = False) -> Mistake:
    """Return a fault at the value that ``loc`` leads to, or at the nearest one above it."""
    node, depth = root, 0
    for part in loc:
        if (child := node.child(part)) is None:
            break
        node, depth = child, depth + 1
    position = node.key if at_key else node.place
    return Mistake(replace(position, path=".".join(filter(None, (position.path, *map(str, loc[depth:]))))), message)


def _loc(path: str) -> Loc:
    return tuple(int(part) if part.isdigit() else part for part in path.split("."))


def _fault(root: Node, kind: type[Model], error: ErrorDetails) -> Mistake | None:
    """Return one of pydantic's errors at its place; None where YAML was refused already."""
    loc: Loc = error["loc"]
    node: Node | None = root
    for part in loc:
        node = node.child(part) if node is not None else None
        if node is not None and node.bad:
            return None
    return mistake_at(root, loc, plain_words(error, kind), at_key=error["type"] == "extra_forbidden")
