"""A body without motors: a cart, or anything else that carries a tag and that a person moves.

Nothing that is written to it moves anything. It tells of no encoder and of no battery; where it is only its tag tells.
"""

import math

from robofleet.vehicles.interface import DriverContext, DriverReading, WheelSpeeds

_STANDS = DriverReading(0.0, 0.0, 0.0, 0.0, math.nan, 0)


class Cart:
    """A driver of nothing."""

    def __init__(self, context: DriverContext) -> None:
        """Have nothing to open."""

    def write(self, wheels: WheelSpeeds) -> None:
        """Move nothing."""

    def read(self) -> DriverReading:
        """Return that nothing turns."""
        return _STANDS

    def close(self) -> None:
        """Have nothing to switch off."""
