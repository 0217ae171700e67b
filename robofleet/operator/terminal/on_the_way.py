"""On the way to the start and to the park: where each robot goes, and how far it has to go, for people who look on."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from robofleet.behaviours.interface import Pose
from robofleet.bus.messages import RobotTick, TickRecord
from robofleet.config import groups
from robofleet.config.tree import Config
from robofleet.nodes.fleet import drives
from robofleet.safety.supervisor import Phase

_NEAR_M, _NEAR_RAD = 0.01, math.radians(3.0)  # who is nearer is there: a pose is estimated, and a robot settles


@dataclass(frozen=True, kw_only=True)
class WayWords:
    """The words for a way; the run's phase is called after it."""

    goal: str  # of a robot
    each: str  # where each robot drives
    all: str  # where they drive
    arrived: str  # a robot is
    all_arrived: str
    then: str


WAYS = {
    Phase.POSITIONING: WayWords(
        goal="its start", each="to its start", all="to their start", arrived="at its start",
        all_arrived="at their start", then="the run begins",
    ),
    Phase.PARKING: WayWords(
        goal="the park", each="to where it is parked", all="to where they are parked", arrived="parked",
        all_arrived="parked", then="the run ends",
    ),
}  # fmt: skip


class OnTheWay:
    """The places of a configuration, and the way that its robots are on; rows are members."""

    def __init__(self, config: Config) -> None:
        """Load the behaviours where the configuration lets robots drive to their start."""
        ids = [robot.id for robot in config.members]
        starts = groups.starts_of(config) if config.run.begin == "go_to_start" else {}
        parks = groups.parks_of(config)
        self.places: dict[Phase, list[Pose | None]] = {
            Phase.POSITIONING: [starts.get(robot) for robot in ids],
            Phase.PARKING: [parks.get(robot) for robot in ids],
        }
        self.phase: Phase | None = None  # whose way this is; None: they are on no way
        self._ids, self._speeds = ids, [drive.max_speed for drive in drives(config)]

    def hear(self, phase: int) -> None:
        """Take note of the run's phase. A way that is held goes on later."""
        if phase != Phase.HOLD:
            self.phase = next((way for way in self.places if way == phase), None)

    def to_go_m(self, record: TickRecord | None) -> list[float | None]:
        """Return how far each robot is from its place in a straight line [m]; 0: it is there; None: nobody knows."""
        if self.phase is None or record is None or len(record.robots) != len(self._ids):
            return [None] * len(self._ids)
        return [
            _to_go_m(robot_record, goal)
            for robot_record, goal in zip(record.robots, self.places[self.phase], strict=True)
        ]

    def robot_words(self, to_go_m: float) -> str:
        assert self.phase is not None
        return f"{to_go_m:.2f} m to {WAYS[self.phase].goal}" if to_go_m else WAYS[self.phase].arrived

    def words(self, to_go_m: Sequence[float | None]) -> str:
        """Return how many are there, and who has the longest way; an empty string where they are on no way."""
        if self.phase is None or None in to_go_m:
            return ""
        left = [m or 0.0 for m in to_go_m]
        arrived = left.count(0.0)
        if arrived == len(left):
            return f"every robot is {WAYS[self.phase].arrived}"
        last = max(range(len(left)), key=lambda row: left[row])
        seconds = math.ceil(max(m / speed for m, speed in zip(left, self._speeds, strict=True)))
        farthest = f"{self._ids[last]} has {left[last]:.2f} m to go, at least {seconds} s"
        return f"{WAYS[self.phase].all_arrived}: {arrived} of {len(left)} robots; {farthest}"


def _to_go_m(record: RobotTick, goal: Pose | None) -> float | None:
    if goal is None or record.lost:
        return None
    away = math.hypot(record.x_m - goal[0], record.y_m - goal[1])
    turned = abs(math.remainder(record.psi_rad - goal[2], math.tau))
    return 0.0 if away < _NEAR_M and turned < _NEAR_RAD else max(away, _NEAR_M)
