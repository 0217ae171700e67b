"""The command line, in this process."""

from typing import Any

from click.testing import Result
from typer.testing import CliRunner

from robofleet.cli import app


def robofleet(*words: object, **how: Any) -> Result:
    """Run a command; ``how``: as ``CliRunner.invoke`` takes it, for example ``env``."""
    return CliRunner().invoke(app, [*map(str, words)], **how)
