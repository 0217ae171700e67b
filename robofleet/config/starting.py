"""What ``robofleet init`` writes: a laboratory's first files, copied from those that come with the package."""

import json
import shutil
from pathlib import Path

from robofleet.config.names import SHIPPED
from robofleet.config.schema import schema

_GUIDES = (
    "*.md",
    "keys",
    "paper",
    "__pycache__",
)  # they explain the shipped folder; the paper's parameters are no laboratory's
_SCHEMA = "schema.json"


def write_starting_files(folder: Path) -> list[Path]:
    """Copy the starting files into an empty folder, each configuration with its schema for editors.

    Returns the configurations. Raises OSError where they cannot be written; the folder is empty then.
    """
    try:
        shutil.copytree(SHIPPED, folder, ignore=shutil.ignore_patterns(*_GUIDES), dirs_exist_ok=True)
        (folder / _SCHEMA).write_text(json.dumps(schema(), indent=1) + "\n")
        configurations = sorted(folder.glob("*.yaml"))
        for file in configurations:
            file.write_text(f"# yaml-language-server: $schema={_SCHEMA}\n{file.read_text()}")
    except OSError:
        for entry in folder.iterdir():
            shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
        raise
    return configurations
