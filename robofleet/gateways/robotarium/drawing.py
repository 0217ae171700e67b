"""The figure on which scripts draw: the arena and a disc with a heading for each robot, by matplotlib."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robofleet.core.clock import MS, stopwatch_ns

Array = NDArray[np.float64]

_PICTURE_PERIOD_NS = 50 * MS  # in a window
_INCHES_PER_M = 2.5


class Drawing:
    """A figure with the arena; its robots are drawn where somebody can see them."""

    def __init__(self, poses: Array, bounds: tuple[float, float, float, float], diameter: float, show: bool) -> None:
        """Open it.

        Args:
            poses: x, y [m], psi [rad] of the robots (3, N).
            bounds: of the arena: least and largest x, least and largest y [m].
            diameter: of a robot [m].
            show: in a window, if there is a display.
        """
        import matplotlib.pyplot as plt  # noqa: PLC0415 - an extra, and slow to load
        from matplotlib.backends.registry import BackendFilter, backend_registry  # noqa: PLC0415
        from matplotlib.patches import Circle, Rectangle  # noqa: PLC0415

        x1, x2, y1, y2 = bounds
        margin = diameter / 2
        size = (x2 - x1 + 2 * margin) * _INCHES_PER_M, (y2 - y1 + 2 * margin) * _INCHES_PER_M
        self.figure, self.axes = plt.subplots(figsize=size)
        self.figure.subplots_adjust(0.01, 0.01, 0.99, 0.99)
        self.axes.set_axis_off()
        self.axes.set_aspect("equal")
        self.axes.set_xlim(x1 - margin, x2 + margin)
        self.axes.set_ylim(y1 - margin, y2 + margin)
        self.axes.add_patch(Rectangle((x1, y1), x2 - x1, y2 - y1, fill=False, linewidth=2))
        self.robots = [
            Circle((x, y), diameter / 2, facecolor="#FFD700", edgecolor="k", zorder=2) for x, y, _ in poses.T
        ]
        self._noses = [self.axes.plot([], [], color="k", linewidth=2, zorder=2)[0] for _ in self.robots]
        for robot in self.robots:
            self.axes.add_patch(robot)
        self._radius = diameter / 2
        hidden: list[str] = backend_registry.list_builtin(BackendFilter.NON_INTERACTIVE)  # type: ignore[no-untyped-call]
        self._window = show and plt.get_backend().lower() not in {name.lower() for name in hidden}
        self._drawn_ns = 0
        self.place(poses)
        if self._window:
            plt.ion()
            plt.show()

    def walls(self, walls: Array) -> None:
        """Draw obstacles (M, 2, 2): both ends of each [m]."""
        for wall in walls:
            self.axes.plot(wall[:, 0], wall[:, 1], color="0.5", linewidth=4)

    def colour(self, robot: int, rgb: Any) -> None:
        self.robots[robot].set_facecolor(rgb)

    def place(self, poses: Array) -> None:
        ahead = self._radius * np.vstack([np.cos(poses[2]), np.sin(poses[2])])
        tips = poses[:2] + ahead
        for row, (robot, nose) in enumerate(zip(self.robots, self._noses, strict=True)):
            robot.center = poses[0, row], poses[1, row]
            nose.set_data([poses[0, row], tips[0, row]], [poses[1, row], tips[1, row]])

    def update(self, poses: Array) -> None:
        """Show where the robots are, as often as an eye can follow."""
        if not self._window or stopwatch_ns() - self._drawn_ns < _PICTURE_PERIOD_NS:
            return
        self.place(poses)
        self.figure.canvas.draw_idle()
        self.figure.canvas.flush_events()
        self._drawn_ns = stopwatch_ns()

    def save(self, file: Any, poses: Array) -> None:
        """Keep the last picture."""
        self.place(poses)
        self.figure.savefig(file, dpi=100)
