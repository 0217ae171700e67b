"""Writes the layouts of ``configs/layouts``: those of the platoon's four robots.

python -m tests.recording.make_layouts
"""

from collections.abc import Iterator
from pathlib import Path

from robofleet.config import groups
from robofleet.config.load import load_config
from robofleet.recording.log import FILE
from robofleet.recording.run import Recording
from robofleet.reports.layouts import foxglove
from robofleet.reports.layouts.layouts import layout as plotjuggler_layout

CONFIGS = Path(__file__).parents[2] / "configs"


def layouts() -> Iterator[tuple[Path, bytes]]:
    """Yield each layout's file, and what is to be in it."""
    config = load_config(CONFIGS / "platoon.yaml")
    recording, folder = Recording(config, file_groups=groups.descriptions(config)), CONFIGS / "layouts"
    yield folder / "foxglove.json", foxglove.layout(recording)
    yield folder / "plotjuggler.xml", plotjuggler_layout(recording, Path(FILE))


if __name__ == "__main__":
    for file, text in layouts():
        file.write_bytes(text)
        print(file)
