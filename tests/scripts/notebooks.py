"""The example notebooks, executed as Jupyter does it.

    python -m tests.scripts.notebooks

executes them and writes their outputs, which readers see on the web: again after a change of what they show.
"""

import base64
import io
import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from PIL import Image

from robofleet.operator.config_commands import write_starting_files
from tests.scripts.examples import EXAMPLES

NOTEBOOKS = sorted(EXAMPLES.glob("*.ipynb"))
_COLOURS = 64


def executed(notebook: Path, folder: Path) -> nbformat.NotebookNode:
    """Execute a notebook in a laboratory's new folder, as ``robofleet init`` writes it."""
    write_starting_files(folder)
    cells = nbformat.read(folder / "examples" / notebook.name, 4)
    NotebookClient(cells, timeout=300, resources={"metadata": {"path": str(folder / "examples")}}).execute()
    return cells


def _shrink(cell: nbformat.NotebookNode) -> None:
    """Leave of a cell what is shown, its plots with few colours."""
    cell.metadata = {}
    for output in cell.get("outputs", []):
        data = output.get("data", {})
        if len(data) > 1:
            data.pop("text/plain", None)
        if "image/png" in data:
            small = io.BytesIO()
            picture = Image.open(io.BytesIO(base64.b64decode(data["image/png"]))).convert("RGB")
            picture.quantize(_COLOURS, dither=Image.Dither.NONE).save(small, "PNG", optimize=True)
            data["image/png"] = base64.b64encode(small.getvalue()).decode()


if __name__ == "__main__":
    for file in NOTEBOOKS:
        with tempfile.TemporaryDirectory() as folder:
            notebook = executed(file, Path(folder))
        for each in notebook.cells:
            _shrink(each)
        nbformat.write(notebook, file)
