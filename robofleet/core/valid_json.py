"""JSON that every program reads: it has no NaN and no infinity, so a figure that is not finite is null."""

import json
import math
from typing import Any


def dumps(tree: Any, *, indent: int | None = None, compact: bool = False) -> str:
    """Return a tree of dicts, lists and scalars as JSON, with null for each number that is not finite."""
    separators = (",", ":") if compact else None
    try:
        return json.dumps(tree, indent=indent, separators=separators, allow_nan=False)
    except ValueError:  # rare: what is finite is not walked through
        return json.dumps(finite(tree), indent=indent, separators=separators, allow_nan=False)


def finite(tree: Any) -> Any:
    """Return the tree with None for each number that is not finite."""
    if isinstance(tree, float):
        return tree if math.isfinite(tree) else None
    if isinstance(tree, dict):
        return {key: finite(value) for key, value in tree.items()}
    if isinstance(tree, list | tuple):
        return [finite(value) for value in tree]
    return tree
