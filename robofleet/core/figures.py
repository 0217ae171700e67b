"""How every plot of the project looks."""

import colorsys
from typing import Any

COLOURS = ("#1b6ca8", "#c8553d", "#3a7d44", "#7d5ba6", "#b8860b")
_MORE = ("#2a9d9d", "#b0477f", "#6b7a2a", "#8c5a3c", "#4b5d8a")
INK, QUIET, FAINT = "#333333", "#8a8a8a", "#e8e8e8"
STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.labelcolor": INK,
    "axes.edgecolor": QUIET,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": FAINT,
    "grid.linewidth": 0.6,
    "xtick.color": QUIET,
    "ytick.color": QUIET,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": False,
    "svg.hashsalt": "robofleet",  # the same figure is the same file
}


def robot_colours(count: int) -> tuple[str, ...]:
    """Return each robot's own colour, leader first; of many robots neighbours look alike, from blue to red."""
    if count <= len(COLOURS + _MORE):
        return (COLOURS + _MORE)[:count]
    hues = (0.6 * (1.0 - k / (count - 1)) for k in range(count))
    shades = ([round(255 * part) for part in colorsys.hls_to_rgb(hue, 0.42, 0.6)] for hue in hues)
    return tuple("#{:02x}{:02x}{:02x}".format(*shade) for shade in shades)
