"""What was seen of each tag: how often, how fast, with which gaps and noise."""

import math
from array import array
from collections.abc import Sequence

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from robofleet.bus.messages import TagPose

_FIGURES = "images measured", "share %", "mean speed mm/s", "largest gap s", "noise mm"
_STRIDE_S = 0.2  # between the positions of which a path's length is made: noise would lengthen a finer one
_LEAST = 20  # images in a row that tell the noise
_THIRD_DIFFERENCE = math.sqrt(20.0)  # of white noise, in its standard deviations
_NORMAL = 1.4826  # standard deviation of a normal distribution, in medians of its magnitude


class Summary:
    """Takes poses image by image."""

    def __init__(self, tags: Sequence[int]) -> None:
        self.images, self._last_s = 0, 0.0
        self._rows = {tag: array("d") for tag in tags}  # of each measured pose: image, time [s], x, y [m]

    def add(self, t_s: float, poses: Sequence[TagPose]) -> None:
        for pose in poses:
            if pose.coasted_ns == 0:
                self._rows[pose.tag].extend((self.images, t_s, pose.x_m, pose.y_m))
        self.images += 1
        self._last_s = t_s

    @property
    def unseen(self) -> list[int]:
        """Tags that were never measured."""
        return [tag for tag, rows in self._rows.items() if not rows]

    def table(self, title: str) -> Table:
        table = Table(title=title, title_justify="left", title_style="bold", box=SIMPLE_HEAD, pad_edge=False)
        for heading in ("tag", *_FIGURES):
            table.add_column(heading, justify="right")
        for tag, rows in self._rows.items():
            table.add_row(str(tag), *self._figures(np.array(rows).reshape(-1, 4)))
        return table

    def _figures(self, rows: np.ndarray) -> tuple[str, ...]:
        count = len(rows)
        share = f"{100 * count / max(self.images, 1):.1f}"
        if count < 2:
            return str(count), share, "-", "-", "-"
        number, t, z = rows[:, 0], rows[:, 1], rows[:, 2] + 1j * rows[:, 3]
        steps = [0]
        for k in range(count):
            if t[k] - t[steps[-1]] >= _STRIDE_S:
                steps.append(k)
        duration = t[steps[-1]] - t[0]
        speed = f"{1e3 * np.abs(np.diff(z[steps])).sum() / duration:.1f}" if duration > 0 else "-"
        gaps = np.diff(t)[np.diff(number) > 1]
        rest = np.diff(z, 3)[number[3:] - number[:-3] == 3]
        noise = "-"
        if len(rest) >= _LEAST:
            each = np.median(np.abs(np.concatenate([rest.real, rest.imag])))
            noise = f"{1e3 * _NORMAL * each / _THIRD_DIFFERENCE:.3f}"
        return str(count), share, speed, f"{gaps.max():.2f}" if len(gaps) else "0", noise
