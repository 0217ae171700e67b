"""Bad input of a command: exit code 2, and one line a fault."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import typer


class RefusedError(Exception):
    """Bad input; one line a fault."""


@contextmanager
def bad_input() -> Iterator[None]:
    """End with exit code 2 and one line a fault."""
    from robofleet.config.load import ConfigError  # noqa: PLC0415

    try:
        yield
    except (ConfigError, RefusedError) as error:
        print(error, file=sys.stderr)
        raise typer.Exit(2) from error
