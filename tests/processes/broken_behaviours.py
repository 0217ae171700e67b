"""Behaviours that fail after a while: each in its own way."""

import threading
from typing import Literal

import numpy as np

from robofleet.behaviours import Behaviour, Decision, Situation

AT_S = 1.0


class Broken(Behaviour):
    """Its robots turn on the spot until it fails."""

    class Settings(Behaviour.Settings):
        """How it fails."""

        how: Literal["raises", "not_finite", "shape", "sleeps", "never"]

    def decide(self, now: Situation) -> Decision:
        """Fail in the settings' way."""
        velocities, how = np.tile([0.0, 0.3], (len(now.poses), 1)), self.settings.how
        if how != "never" and AT_S <= now.t < AT_S + 0.04:
            if how == "raises":
                raise RuntimeError("the law has no solution")
            if how == "shape":
                return Decision(velocities[:, :1], of="body")
            if how == "sleeps":
                threading.Event().wait(0.05)
            else:
                velocities[-1] = np.nan
        return Decision(velocities, of="body")
