"""The settings of a closed path, as a file of ``configs/paths`` has them."""

from typing import Annotated

import numpy as np
from pydantic import Field

from robofleet.control.path import Path
from robofleet.core.settings import MANY, Coordinate, Model, within

Derivative = Annotated[float, within(-1e4, 1e4)]


class Knot(Model):
    """A knot of the path: a position and a derivative. Each side of the path is one unit of the parameter long."""

    at_m: Annotated[tuple[Coordinate, Coordinate], Field(strict=False)]
    """Position of the knot [world frame]."""
    derivative_m: Annotated[tuple[Derivative, Derivative], Field(strict=False)]
    """Derivative of the position with respect to the parameter, which grows by 1 from each knot to the next."""


class PathFile(Model):
    """A closed path of cubic Hermite splines (a file of ``configs/paths``)."""

    knots: Annotated[tuple[Knot, ...], Field(min_length=2, max_length=MANY, strict=False)]
    """Knots in the order of driving. The last side leads back to the first knot."""

    def path(self) -> Path:
        """Return the path."""
        return Path.hermite(
            np.array([knot.at_m for knot in self.knots]), np.array([knot.derivative_m for knot in self.knots])
        )
