"""What viewers draw of a run: the channels and messages that a recording has beside the bus's own.

The recording writes them, and viewers that look at a run while it is on get the same ones: both are made here.
"""

from collections.abc import Sequence

from robofleet.behaviours import described
from robofleet.config.tree import Config
from robofleet.recording.scenes.robot_ticks import BATCH, RobotTicks
from robofleet.recording.scenes.scene import Scene

DrawnMessages = Sequence[tuple[str, int, bytes]]  # topic, log time [ns], message


class Drawn:
    """Makes viewers' messages of the bus's messages, which it is given in order."""

    def __init__(
        self, config: Config, groups: tuple[described.Group, ...], *, epoch_ns: int = 0, batch: int = BATCH
    ) -> None:
        """``epoch_ns``: added to the caller's clock, it gives dates; ``batch``: ticks of a robot in one message."""
        self._epoch_ns = epoch_ns
        self._scene = Scene(config, groups, epoch_ns=epoch_ns)
        self._ticks = RobotTicks(config, groups, batch)
        self.channels = *self._scene.channels, *self._ticks.channels

    def update(self, full: str, payload: bytes, at_ns: int) -> DrawnMessages:
        log_ns = at_ns + self._epoch_ns
        shown = self._scene.update(full, payload, at_ns)
        ticks = self._ticks.update(full, payload, log_ns)
        return [*((topic, log_ns, drawn) for topic, drawn in shown), *ticks] if shown else ticks

    def rest(self) -> DrawnMessages:
        return self._ticks.rest()
