"""Array types, for annotations."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Complex = NDArray[np.complex128]
Flags = NDArray[np.bool_]
Image = NDArray[np.uint8]  # grey levels (H, W)
Indices = NDArray[np.int64]
Instants = NDArray[np.int64]  # [ns]
