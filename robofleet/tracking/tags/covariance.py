"""How sure a planar pose is: the covariance of x, y [m; world] and psi [rad], as six numbers."""

from typing import cast

import numpy as np
from numpy.typing import NDArray

Covariance = tuple[float, float, float, float, float, float]  # xx, xy, yy [m^2], x psi, y psi [m rad], psi psi [rad^2]
UNKNOWN: Covariance = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def covariance(numbers: NDArray[np.float64]) -> Covariance:
    """Return the six numbers of an array (6,)."""
    return covariances(numbers[np.newaxis])[0]


def covariances(numbers: NDArray[np.float64]) -> list[Covariance]:
    """Return the rows of an array (M, 6)."""
    return cast("list[Covariance]", list(map(tuple, numbers.tolist())))
