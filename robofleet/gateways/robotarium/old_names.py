"""Names that scripts of version 1 use and that numpy and matplotlib have had until 2024: they get them again."""

from typing import Any

import numpy as np

_NUMPY = {
    "mat": np.asmatrix, "float": float, "int": int, "bool": bool, "object": object, "complex": complex,
    "float_": np.float64, "Inf": np.inf, "infty": np.inf, "NaN": np.nan, "product": np.prod, "cumproduct": np.cumprod,
    "row_stack": np.vstack, "alltrue": np.all, "sometrue": np.any,
}  # fmt: skip


def restore() -> None:
    """Add the names that are missing."""
    for name, value in _NUMPY.items():
        if name not in vars(np):
            setattr(np, name, value)
    import matplotlib as mpl  # noqa: PLC0415 - slow to load
    from matplotlib import cm  # noqa: PLC0415

    def get_cmap(name: str | None = None, lut: int | None = None) -> Any:
        found = mpl.colormaps[name or mpl.rcParams["image.cmap"]]
        return found if lut is None else found.resampled(lut)

    if not hasattr(cm, "get_cmap"):
        cm.get_cmap = get_cmap  # type: ignore[attr-defined]
