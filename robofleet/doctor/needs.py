"""What this machine is to run: a configuration, the drivers of some of its robots, or a simulated run."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

from robofleet.config.camera import CameraSettings
from robofleet.config.robots import Robot
from robofleet.config.tree import Config
from robofleet.core.plugins import PluginError
from robofleet.drivers.udp_port import SCHEME
from robofleet.nodes.unit import driver_settings

_NO_CONFIG_S = 88.0  # of the first run that the README shows


class Port(NamedTuple):
    """A serial port that the configuration names for a robot."""

    robot: str
    path: str


@dataclass(frozen=True)
class Needs:
    """``drivers_of``: this machine runs the drivers of these robots and nothing else; None: the whole run."""

    config: Config | None = None
    drivers_of: tuple[str, ...] | None = None

    @property
    def whole_run(self) -> bool:
        """Whether controller, tracker and recorder run here, too."""
        return self.drivers_of is None

    @property
    def robots(self) -> tuple[Robot, ...]:
        if self.config is None:
            return ()
        return tuple(robot for robot in self.config.robots if self.drivers_of is None or robot.id in self.drivers_of)

    @property
    def cameras(self) -> tuple[CameraSettings, ...]:
        if self.config is None or not self.whole_run or self.config.tracker.source != "camera":
            return ()
        return tuple(view.camera for view in self.config.views)

    @property
    def duration_s(self) -> float:
        return _NO_CONFIG_S if self.config is None else self.config.run.duration_s

    def ports(self) -> Iterator[Port]:
        """Yield the real serial ports that are named; a twin brings its own, and a driver that is missing has none."""
        for robot in self.robots:
            if robot.twin is not None or self.config is None:
                continue
            try:
                path = driver_settings.port(self.config, robot)
            except PluginError:
                continue
            if path is not None and not path.startswith(SCHEME):
                yield Port(robot.id, path)
