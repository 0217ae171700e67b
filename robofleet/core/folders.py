"""Where the settings of a computer are: this system's, and this user's."""

import os
from pathlib import Path

SYSTEM = Path("/etc/robofleet")


def own_settings() -> Path:
    """Return the folder of this user's settings, whether it is there or not."""
    return Path(os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config") / "robofleet"
