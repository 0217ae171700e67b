"""Errors of tags that were placed, and whether their covariances are true."""

import json
import math
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from robofleet.core.arrays import Array
from tests.tracking.peers import PeerTag
from tests.tracking.raycast import Print, along

WRONG = 0.005  # an error from which on a tag is not placed, but elsewhere [m]


class Score:
    """What one candidate says of many images."""

    def __init__(self) -> None:
        self.errors: list[tuple[float, float, float]] = []  # x, y [m; world], psi [rad]
        self.covariances: list[tuple[float, ...]] = []
        self.tags = self.wrong = 0

    def add(self, prints: Sequence[Print], sightings: Sequence[PeerTag]) -> None:
        """Compare one image's sightings with the truth, each at its own instant."""
        by_tag = {tag.tag: tag for tag in prints}
        self.tags += len(by_tag)
        for seen in sightings:
            tag = by_tag.pop(seen.tag, None)  # a second one of the same finds none
            x, y, psi = along(tag.pose, tag.twist, seen.after_ns * 1e-9) if tag else (math.inf,) * 3
            if math.hypot(seen.x - x, seen.y - y) < WRONG:
                self.errors.append((float(seen.x - x), float(seen.y - y), math.remainder(seen.psi - psi, math.tau)))
                self.covariances.append(seen.covariance)
            else:
                self.wrong += 1

    def row(self) -> dict[str, float]:
        """Return position's and heading's rms, largest and mean errors, and shares."""
        if not self.errors:
            return {"measured": 0.0, "wrong": self.wrong}
        x, y, heading = np.array(self.errors).T * [[1e3], [1e3], [math.degrees(1.0)]]
        position = np.hypot(x, y)
        return {
            "rms_mm": rms(position), "max_mm": float(position.max()),
            "rms_deg": rms(heading), "max_deg": float(np.abs(heading).max()),
            "mean_mm": math.hypot(x.mean(), y.mean()),
            "measured": len(self.errors) / self.tags, "wrong": self.wrong,
        }  # fmt: skip


def print_tables(
    tables: Iterable[tuple[str, dict[str, dict[str, float]]]], widths: Mapping[str, int], first: int, *, as_json: bool
) -> None:
    """Print each scene's rows as soon as they are there, or all of them as one JSON object.

    ``widths``: of the columns, by the keys of the rows; ``first``: of the column of names.
    """
    found = {}
    for title, rows in tables:
        found[title] = rows
        if not as_json:
            print(f"{title:<{first}}" + "".join(f"{column:>{width}}" for column, width in widths.items()))
            for name, row in rows.items():
                cells = (f"{row[c]:>{w}.4g}" if c in row else f"{'-':>{w}}" for c, w in widths.items())
                print(f"  {name:<{first - 2}}" + "".join(cells), flush=True)
            print()
    if as_json:
        print(json.dumps(found))


def rms(values: Array) -> float:
    return math.sqrt((values**2).mean())


def squared(error: Array, covariance: Array) -> tuple[Array, Array]:
    """Return squared errors (N,) of position and of heading by their covariances: 2 and 1 on average if these are true.

    error (N, 3): x, y [m], psi [rad]. covariance (N, 6): each a ``Covariance``.
    """
    x, y, psi = error.T
    xx, xy, yy = covariance[:, :3].T
    return (yy * x * x - 2.0 * xy * x * y + xx * y * y) / (xx * yy - xy * xy), psi**2 / covariance[:, 5]
