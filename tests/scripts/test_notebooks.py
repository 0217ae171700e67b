"""The example notebooks work in a laboratory's new folder, and show what readers see on the web."""

import json
import re
from pathlib import Path

import nbformat
import pytest

from tests.scripts.examples import EXAMPLES
from tests.scripts.notebooks import NOTEBOOKS, executed

LARGEST_BYTES = 150_000


def kinds(notebook: nbformat.NotebookNode) -> list[list[str]]:
    """Return of each cell what it shows."""
    return [
        [kind for output in cell.get("outputs", []) for kind in output.get("data", {}) if kind != "text/plain"]
        for cell in notebook.cells
    ]


@pytest.mark.slow
@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_a_notebook_runs_from_top_to_bottom_and_shows_what_it_showed(file: Path, tmp_path: Path) -> None:
    assert kinds(executed(file, tmp_path)) == kinds(nbformat.read(file, 4))


def test_notebooks_are_small_and_their_outputs_are_of_no_machine() -> None:
    table = (EXAMPLES / "README.md").read_text()
    assert len(NOTEBOOKS) == 3
    for file in NOTEBOOKS:
        text = file.read_text()
        assert f"[{file.name}]({file.name})" in table
        assert len(text) < LARGEST_BYTES
        assert any(map(len, kinds(nbformat.reads(text, 4)))), "it has outputs"
        plain = json.dumps([cell.get("outputs", []) for cell in json.loads(text)["cells"] if "outputs" in cell])
        assert not re.search(r"/(home|root|tmp|work|Users)/|Traceback", re.sub(r'"image/png": "[^"]*"', "", plain))
