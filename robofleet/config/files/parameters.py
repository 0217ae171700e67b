"""Files of parameters beside the configuration: a YAML file read into a frozen tree; says what is wrong where."""

from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from robofleet.config.faults import Complaint, plain_words
from robofleet.config.files.names import missing
from robofleet.config.files.yamlfile import Mistake, Node, Position, Source, keys_of, read_yaml
from robofleet.config.load import ConfigError
from robofleet.core.settings import Model

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


def load_placed(kind: type[M], file: Path, absent: str = "") -> tuple[M, Node]:
    """Read and validate as ``load_parameters``; returns also where everything stands in the file.

    ``absent``: what is said where there is no such file.
    """
    try:
        root, faults = read_yaml(file, Source(str(file)))
    except FileNotFoundError:
        root, faults = None, [Mistake(Position(Source(str(file)), 1, 1, ""), absent or missing(file))]
    if root is None:
        raise ConfigError(str(fault) for fault in faults)
    try:
        parameters = kind.model_validate(root.plain())
    except ValidationError as invalid:
        found = [
            root.mistake(error["loc"], plain_words(error, kind), at_key=error["type"] == "extra_forbidden")
            for error in invalid.errors(include_url=False)
        ]
    else:
        found = [root.mistake(keys_of(path), message) for path, message in parameters.complaints()]
        if not faults and not found:
            return parameters, root
    faults = sorted([*faults, *filter(None, found)], key=lambda fault: (fault.position.line, fault.position.column))
    raise ConfigError(dict.fromkeys(map(str, faults)))
