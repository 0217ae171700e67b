"""Hints at the unit that was probably meant, where a number is in another unit than its key's."""

import math
import re

_LEAST_SHARE = 0.003  # of what a number may be: what is less in the other unit was not meant so
# by a key's last part: the units that people write instead, each with its size in the key's own
_OTHERS = {"m": {"cm": 0.01, "mm": 0.001}, "s": {"ms": 1e-3, "us": 1e-6}, "rad": {"degrees": math.pi / 180}}
_SIZES = {
    "m": {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
    "rad": {"rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180},
    "deg": {"deg": 1.0, "°": 1.0, "rad": 180 / math.pi},
    "hz": {"hz": 1.0, "khz": 1000.0},
}
_QUANTITY = re.compile(r"([-+]?[0-9]*[.,]?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*([^\W\d]*[/\w²°]*)")


def meant(value: float, limit: float | None, key: str) -> str:
    """Return a question where a number of a key is too large, and in another unit would not be; else nothing."""
    if limit is None or not value > limit > 0:
        return ""
    before, _, unit = key.rpartition("_")
    is_rate = before.rpartition("_")[2] in ("m", "rad", "per")  # of speed_m_s
    sizes = {} if is_rate else _OTHERS.get(unit, {})
    units = [unit for unit, size in sizes.items() if _LEAST_SHARE <= value * size / limit <= 1.0]
    return f" (is {value:g} in {' or '.join(units)}?)" if units else ""


def number_in(text: str, key: str) -> str:
    """Return how a text that holds a number is to be written: in quotes, with a decimal comma, with a unit."""
    try:
        float(text)
    except ValueError:
        pass
    else:
        return ": remove the quotes"
    found = _QUANTITY.fullmatch(text.strip())
    if found is None:
        return ""
    number, unit = float(found[1].replace(",", ".")), found[2].casefold()
    if not unit:
        return f": write {number:g}, with a decimal point"
    own = key.rpartition("_")[2]
    size = _SIZES.get(own, {}).get(unit)
    return f": write the number alone, in {own}" if size is None else f": write {number * size:.6g}, without the unit"
