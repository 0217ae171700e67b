"""The commands that write what configurations begin with, ``init`` and ``schema``: they need the base install alone."""

import json
import shlex
import shutil
from pathlib import Path
from typing import Annotated

import typer

from robofleet.config import schema as schemas
from robofleet.config.files.names import SHIPPED
from robofleet.core.refusal import RefusedError, new_folder

# Guides explain the shipped folder; the paper's parameters are no laboratory's.
_GUIDES = "*.md", "keys", "paper", "runs", "__pycache__", ".ipynb_checkpoints"
_SCHEMA = "schema.json"


def write_starting_files(folder: Path) -> list[Path]:
    """Copy the starting files into an empty folder, each configuration with its schema for editors.

    Returns the configurations. Raises OSError where they cannot be written; the folder is empty then.
    """
    try:
        shutil.copytree(SHIPPED, folder, ignore=shutil.ignore_patterns(*_GUIDES), dirs_exist_ok=True)
        (folder / _SCHEMA).write_text(json.dumps(schemas.schema(), indent=1) + "\n")
        configurations = sorted(folder.glob("*.yaml"))
        for file in configurations:
            file.write_text(f"# yaml-language-server: $schema={_SCHEMA}\n{file.read_text()}")
    except OSError:
        for entry in folder.iterdir():
            shutil.rmtree(entry) if entry.is_dir() else entry.unlink()
        raise
    return configurations


ConfigFile = Annotated[
    Path, typer.Argument(metavar="CONFIG", help="The configuration (YAML); configs/keys lists its keys.")
]
Overrides = Annotated[
    list[str],
    typer.Option("--set", metavar="KEY=VALUE", help="Change a key, for example controller.alpha=30. Repeatable."),
]


def init(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A new folder, or an empty one.")],
) -> None:
    """Write a folder with configurations to start from.

    It also holds robots, paths, cameras, examples of scripts, and the schema that an editor reads.

    $ robofleet init lab
    """
    new_folder(folder, "DIR")
    try:
        files = write_starting_files(folder)
    except OSError as error:
        raise RefusedError(f"DIR: {folder} cannot be written: {error.strerror}: name another folder") from error
    for file in files:
        print(f"{file}: {_first_comment(file)}")
    hello = shlex.quote(str(folder / "examples" / "hello.py"))
    print(
        f"{folder / 'examples'}: Scripts and notebooks that drive the robots of script.yaml. Start with: python {hello}"
    )
    print("Next:", shlex.join(["robofleet", "run", str(folder / "platoon.yaml"), "--web"]))


def schema(
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write it into this file; without it, to standard output.")
    ] = None,
) -> None:
    """Print the schema of configurations, for an editor.

    With it an editor completes keys and marks mistakes (JSON schema).

    $ robofleet schema --out schema.json

    Write this as the first line of a configuration in the same folder:

    # yaml-language-server: $schema=schema.json
    """
    text = json.dumps(schemas.schema(), indent=1)
    if out is None:
        print(text)
        return
    try:
        out.write_text(text + "\n")
    except OSError as error:
        raise RefusedError(f"--out: {out} cannot be written: {error.strerror}: name another file") from error
    print(out)


def _first_comment(file: Path) -> str:
    """Return the first sentence of a configuration about itself; the line before it is the editors'."""
    words = " ".join(line.removeprefix("#").strip() for line in file.read_text().splitlines()[1:4])
    return words.partition(". ")[0].rstrip(".") + "."
