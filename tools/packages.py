"""Says in one line what to install, where a tool's packages are not there. It needs none itself."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


@contextmanager
def needing(*extras: str) -> Iterator[None]:
    """Import within this; exit code 2 where a package is missing. ``extras``: those of robofleet that bring them."""
    try:
        yield
    except ModuleNotFoundError as error:
        name = error.name or ""
        if name.startswith("robofleet."):
            raise  # nobody forgot to install that
        print(f"this needs {name.partition('.')[0]}: {_cure(extras)}", file=sys.stderr)
        raise SystemExit(2) from error


def _cure(extras: tuple[str, ...]) -> str:
    own = ROOT / ".venv" / "bin" / "python"
    if own.exists() and Path(sys.prefix) != own.parents[1]:
        return f"run it with {own}, or first: source {own.with_name('activate')}"
    what = f".[{','.join(extras)}]" if extras else "."
    return f"{sys.executable} -m pip install -e '{what}' in {ROOT}"
