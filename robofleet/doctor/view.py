"""How findings are shown: a line each, then what can be pasted, then the verdict."""

import sys
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from robofleet.config.files.yamlfile import printable
from robofleet.doctor import udev
from robofleet.doctor.findings import Finding, Mark

_SIGNS = {Mark.OK: "✓", Mark.WARN: "!", Mark.MISSING: "✗"}
_ABOUT = {udev.FILE: f"; give each its own robot's name; then `{udev.RELOAD}`"}
_STYLES = {Mark.OK: "green", Mark.WARN: "yellow", Mark.MISSING: "bold red"}


def show(findings: Sequence[Finding], verdict: str) -> None:
    """Print to a terminal in columns, else a line each."""
    console = Console(highlight=False)
    signs = _can_show(console.encoding)
    rows = [
        (
            f"{_SIGNS[finding.mark]} {finding.mark}" if signs else str(finding.mark),
            printable(finding.name),
            printable(f"{finding.says}: {finding.cure}" if finding.cure else finding.says),
        )
        for finding in findings
    ]
    if console.is_terminal:
        grid = Table.grid(padding=(0, 2))
        grid.add_column(no_wrap=True)
        grid.add_column(no_wrap=True)
        grid.add_column()
        for finding, (mark, name, says) in zip(findings, rows, strict=True):
            grid.add_row(Text(mark, _STYLES[finding.mark]), Text(name), Text(says))
        console.print(grid)
    else:
        wide = [max(map(len, column)) for column in zip(*rows, strict=True)]
        for mark, name, says in rows:
            print(f"{mark:<{wide[0]}}  {name:<{wide[1]}}  {says}")
    for line in pastes(findings):
        print(line)  # unwrapped, to be copied
    print()
    print(verdict)


def pastes(findings: Sequence[Finding]) -> list[str]:
    """Return what is to be pasted into which file, each file after a line that says so."""
    files: dict[str, dict[str, None]] = {}
    for finding in findings:
        for paste in finding.pastes:
            files.setdefault(paste.file, {})[paste.line] = None
    lines = []
    for file, lines_of in files.items():
        lines += ["", f"To paste into {file}, as root{_ABOUT.get(file, '')}:", *lines_of]
    return lines


def _can_show(encoding: str) -> bool:
    try:
        "".join(_SIGNS.values()).encode(encoding or sys.getdefaultencoding())
    except (UnicodeEncodeError, LookupError):
        return False
    return True
