"""Two lengths or two counts in one word, ``3.5x2.3``: how every tool of a laboratory takes them."""

import re

from robofleet.calibration.store import CalibrationError

_NUMBER = r"\d{1,6}(?:\.\d{1,6})?"
_LARGEST = 1000.0


def size(text: str, option: str) -> tuple[float, float]:
    """Return the two sides of ``3.5x2.3``; CalibrationError, which names the option, for anything else."""
    found = re.fullmatch(rf"\s*({_NUMBER})\s*[xX]\s*({_NUMBER})\s*", text)
    if found is None:
        raise CalibrationError(
            f"{option}: {text!r} is not a size: write two numbers with an x between them, as 3.5x2.3"
        )
    sides = float(found[1]), float(found[2])
    if not all(0.0 < side <= _LARGEST for side in sides):
        raise CalibrationError(f"{option}: {text!r}: each side must be more than 0 and at most {_LARGEST:g}")
    return sides


def count(text: str, option: str) -> tuple[int, int]:
    """Return columns and rows of ``11x8``; CalibrationError, which names the option, for anything else."""
    found = re.fullmatch(r"\s*(\d{1,3})\s*[xX]\s*(\d{1,3})\s*", text)
    if found is None:
        raise CalibrationError(f"{option}: {text!r} is not COLUMNSxROWS: write two whole numbers, as 11x8")
    return int(found[1]), int(found[2])
