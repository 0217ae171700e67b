"""Who may open a device, and what gives this user the right."""

import grp
import os
import pwd
from pathlib import Path


def user_name() -> str:
    try:
        return pwd.getpwuid(os.geteuid()).pw_name
    except KeyError:
        return str(os.geteuid())


def cure(device: Path) -> str:
    """Return how this user comes to be allowed to open a device."""
    user = user_name()
    try:
        group = grp.getgrgid(device.stat().st_gid)
    except (KeyError, OSError):
        return f"let an administrator give {user} the right to open {device}"
    if user in group.gr_mem:
        return f"log out and in again: {user} is in the group {group.gr_name}, but this session does not know it yet"
    return f"`sudo usermod --append --groups {group.gr_name} {user}`, then log in again"
