"""A browser that shows one page full-screen on this computer."""

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

from robofleet.projection.display import DisplayError

_CHROMIUMS = "chromium", "chromium-browser", "google-chrome", "google-chrome-stable"
_SCREENS = "DISPLAY", "WAYLAND_DISPLAY"
_END_WITHIN_S = 5.0


@contextmanager
def kiosk(address: str, size: tuple[int, int]) -> Iterator[None]:
    """Show a page on a screen of some width and height [px]; DisplayError without a Chromium or a screen."""
    chromium = next(filter(None, map(shutil.which, _CHROMIUMS)), None)
    if chromium is None:
        raise DisplayError(f"--kiosk: there is no Chromium here: open {address} in a browser, full-screen")
    if not any(os.environ.get(name) for name in _SCREENS):
        raise DisplayError(f"--kiosk: there is no screen here (set DISPLAY): open {address} in a browser, full-screen")
    options = ["--kiosk", "--no-first-run", "--force-device-scale-factor=1"]
    # Without a desktop nobody makes a window as large as the screen, and Chromium makes one that is a pixel smaller.
    options += ["--window-position=0,0", f"--window-size={size[0] + 1},{size[1] + 1}"]
    if os.geteuid() == 0:
        options.append("--no-sandbox")  # root's Chromium starts without it only; the one page that it opens is ours
    quiet = subprocess.DEVNULL
    with tempfile.TemporaryDirectory(prefix="robofleet-kiosk-", ignore_cleanup_errors=True) as profile:
        process = subprocess.Popen(
            [chromium, *options, f"--user-data-dir={profile}", address], stdin=quiet, stdout=quiet, stderr=quiet
        )
        try:
            yield
        finally:
            process.terminate()
            try:
                process.wait(_END_WITHIN_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
