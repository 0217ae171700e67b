"""The newest status of every driver: its heartbeat."""

from collections.abc import Sequence

from robofleet.clock import MS
from robofleet.comms.bus import Bus, Inbox
from robofleet.comms.keys import STATUS
from robofleet.comms.messages import ROBOT_STATUS, RobotStatus

HURRY_NS = 5 * MS


class Statuses:
    """The newest status of every robot; what was overtaken on its way is passed over."""

    def __init__(self, bus: Bus, robots: Sequence[str]) -> None:
        self._inboxes = [Inbox(bus.newest(STATUS, robot), ROBOT_STATUS) for robot in robots]
        self.newest: list[RobotStatus | None] = [None] * len(robots)

    def take(self) -> list[tuple[int, RobotStatus]]:
        """Take what came; returns the robots of which there is a newer status, and it."""
        newer = []
        for row, inbox in enumerate(self._inboxes):
            status, known = inbox.take(), self.newest[row]
            if status is None or (known and known.boot_id == status.boot_id and status.nonce <= known.nonce):
                continue
            self.newest[row] = status
            newer.append((row, status))
        return newer

    def hurried(self) -> list[int]:
        """Return whose link is bad: what is said to these is said every HURRY_NS."""
        return [row for row, status in enumerate(self.newest) if status is not None and status.hurry]
