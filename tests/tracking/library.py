"""What the AprilTag library, as pyapriltags brings it, draws of its tags: it knows nothing of ours."""

import ctypes
import functools
from pathlib import Path

import numpy as np
import pyapriltags
from numpy.typing import NDArray


class _Image(ctypes.Structure):
    _fields_ = (
        ("width", ctypes.c_int32), ("height", ctypes.c_int32), ("stride", ctypes.c_int32),
        ("greys", ctypes.POINTER(ctypes.c_uint8)),
    )  # fmt: skip


def drawn(tag: int, family: str) -> NDArray[np.bool_]:
    """Return a tag's cells as the library draws them, true where white; of some families with a white one around."""
    library, known = _family(family)
    image = library.apriltag_to_image(known, tag).contents
    greys = np.ctypeslib.as_array(image.greys, (image.height, image.stride))
    return np.asarray(greys[:, : image.width] > 0)


@functools.cache
def _family(name: str) -> tuple[ctypes.CDLL, int]:
    library = ctypes.CDLL(str(Path(str(pyapriltags.__file__)).with_name("libapriltag.so")))
    library.apriltag_to_image.restype = ctypes.POINTER(_Image)
    library.apriltag_to_image.argtypes = [ctypes.c_void_p, ctypes.c_uint32]
    create = library[f"tag{name}_create"]
    create.restype = ctypes.c_void_p
    return library, create()
