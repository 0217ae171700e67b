"""A body without motors: a cart, or anything else that carries a tag and that a person moves.

Commands move nothing. There is no encoder and no battery: only its tag says where it is.
"""

import math

from robofleet.vehicles.interface import DriverContext, DriverReading, WheelSpeeds

_STANDS = DriverReading(0.0, 0.0, 0.0, 0.0, math.nan, 0)


class Cart:
    """A null driver."""

    def __init__(self, context: DriverContext) -> None:
        """Open nothing."""

    def write(self, wheels: WheelSpeeds) -> None:
        """Move nothing."""

    def read(self) -> DriverReading:
        """Return that nothing turns."""
        return _STANDS

    def close(self) -> None:
        """Close nothing."""
