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

        how: Literal["raises", "raises_when_told", "not_finite", "shape", "array", "sleeps", "never"]

    t = 0.0  # of its newest decision [s]

    def decide(self, now: Situation) -> Decision:
        """Fail in the settings' way."""
        velocities, how = np.tile([0.0, 0.3], (len(now.poses), 1)), self.settings.how
        self.t = now.t
        if how == "sleeps" and now.t >= AT_S:  # again and again, as a law that is too slow
            threading.Event().wait(0.05)
        if AT_S <= now.t < AT_S + 0.04:
            if how == "raises":
                raise RuntimeError("the law has no solution")
            if how == "array":
                return velocities  # type: ignore[return-value]
            if how == "shape":
                return Decision(velocities[:, :1], of="body")
            if how == "not_finite":
                velocities[-1] = np.nan
        return Decision(velocities, of="body")

    def changed(self, velocities: np.ndarray) -> None:
        """Fail where nothing is asked of it."""
        if self.settings.how == "raises_when_told" and self.t >= AT_S:
            raise RuntimeError("the law has no solution")
