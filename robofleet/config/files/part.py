"""A part of the configuration in a file of its own: a camera, a robot."""

from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from robofleet.config.faults import plain_words
from robofleet.config.files.yamlfile import Source, read_yaml
from robofleet.config.load import ConfigError
from robofleet.core.settings import Model

M = TypeVar("M", bound=Model)


def load_part(file: Path, kind: type[M]) -> M:
    """Read a part; ConfigError with every fault of a file that cannot be read or is impossible."""
    try:
        tree, wrong = read_yaml(file, Source(str(file)))
        if wrong or tree is None:
            raise ConfigError(map(str, wrong))
        return kind.model_validate(tree.plain())
    except FileNotFoundError as error:
        raise ConfigError([f"{file}: {error.strerror}"]) from error
    except ValidationError as invalid:
        paths = (".".join(map(str, error["loc"])) for error in invalid.errors())
        words = (plain_words(error, kind) for error in invalid.errors())
        raise ConfigError(
            ": ".join(filter(None, (str(file), *fault))) for fault in zip(paths, words, strict=True)
        ) from invalid
