"""Where a computer keeps what is not of one run: the settings of its system and of its user, and compiled kernels."""

import os
from pathlib import Path

SYSTEM = Path("/etc/robofleet")


def own_settings() -> Path:
    """Return the folder of this user's settings, whether it is there or not."""
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "robofleet"


def kernels_folder() -> Path:
    """Return the folder of what is compiled for this user, whether it is there or not."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "robofleet" / "kernels"
