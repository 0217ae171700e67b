"""Runs scripts in a process of their own: numba and cameras' libraries may hang or crash."""

import json
import subprocess
import sys
from typing import Any

from robofleet.core.errors import RobofleetError
from robofleet.runs.children import ended_by

_AT_MOST_S = 20.0  # a busy machine loads numba in ten


class NoAnswerError(RobofleetError):
    """Raised where the other process gave no answer. The message says why."""


def run_apart(script: str, at_most_s: float = _AT_MOST_S) -> Any:
    """Return the JSON that a Python script prints in its last line; NoAnswerError where it hangs or fails."""
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", script], stdin=subprocess.DEVNULL, capture_output=True, text=True,
            timeout=at_most_s, check=True,
        )  # fmt: skip
        return json.loads(done.stdout.splitlines()[-1])
    except subprocess.TimeoutExpired as error:
        raise NoAnswerError(f"no answer within {at_most_s:g} s") from error
    except subprocess.CalledProcessError as error:
        words = error.stderr.strip().splitlines()
        raise NoAnswerError(words[-1] if words else f"it {ended_by(error.returncode)}") from error
    except (ValueError, IndexError, OSError) as error:
        raise NoAnswerError(str(error)) from error
