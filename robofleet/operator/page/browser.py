"""The user's browser: opened where there is a graphical one and somebody who sits in front of it."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

_TEXT = frozenset({"browsh", "carbonyl", "elinks", "links", "links2", "lynx", "w3m", "www-browser"})
_GRAPHICAL = (
    "xdg-open", "gio", "gvfs-open", "x-www-browser", "firefox", "chromium", "chromium-browser", "google-chrome",
    "google-chrome-stable", "epiphany", "konqueror", "falkon", "opera", "microsoft-edge", "brave-browser",
)  # fmt: skip
_OVER_SSH = "SSH_CONNECTION", "SSH_CLIENT", "SSH_TTY"
_SCREENS = "DISPLAY", "WAYLAND_DISPLAY"

Found = Callable[[str], str | None]


def opener(environment: Mapping[str, str], *, root: bool, windows: bool, found: Found) -> list[str] | None:
    """Return the command that opens an address, which comes last; None where no window would open.

    ``BROWSER`` is the user's word. A browser at the far end of ssh is none, one in a terminal takes it from the live
    view, and one of root's does not start. ``windows``: Linux inside Windows, whose browser is outside.
    """
    by_python = [sys.executable, "-P", "-m", "webbrowser"]
    if named := environment.get("BROWSER", "").split(os.pathsep)[0].split():
        return None if Path(named[0]).name in _TEXT else by_python
    if root or any(environment.get(name) for name in _OVER_SSH):
        return None
    if windows and found("wslview"):
        return ["wslview"]
    if any(environment.get(name) for name in _SCREENS) and any(map(found, _GRAPHICAL)):
        return by_python
    return None


def open_page(address: str) -> bool:
    """Open an address; returns whether a browser was asked to. It has no terminal, and nobody waits for it."""
    command = opener(
        os.environ, root=os.geteuid() == 0, windows="microsoft" in os.uname().release.lower(), found=shutil.which
    )
    if command is None:
        return False
    environment = {name: value for name, value in os.environ.items() if name != "TERM"}  # then no text browser is tried
    try:
        process = subprocess.Popen(
            [*command, address], env=environment, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
    except OSError:
        return False
    _opened_by.append(process)
    return True


_opened_by: list["subprocess.Popen[bytes]"] = []  # they end by themselves
