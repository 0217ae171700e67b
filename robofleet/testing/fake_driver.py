"""A driver without a robot, which records what it was told."""

from typing import ClassVar

from robofleet.vehicles.interface import STOP, DriverContext, DriverError, DriverReading, WheelSpeeds


class FakeDriver:
    """A driver that records each command, and fails where a test says so. It has no ``truth``, as a real robot.

    Name it in a configuration: ``driver: "robofleet.testing:FakeDriver"``. Call ``reset`` before and after each test.

    Attributes:
        instances: The newest driver of each robot, by the robot's id.
        absent: Robots whose driver cannot be made.
        unwritable: Robots whose driver raises an OSError in ``write``.
        unreadable: Robots whose driver raises an OSError in ``read``.
        writes: Every command: the instant [ns], and the wheels [rad/s].
        faults: Bits that each reading reports, as ``RobotFault``.
        angles: Angles of the left and of the right wheel that each reading reports [rad].
        closed: How often ``close`` was called.
    """

    instances: ClassVar[dict[str, "FakeDriver"]] = {}
    absent: ClassVar[set[str]] = set()
    unwritable: ClassVar[set[str]] = set()
    unreadable: ClassVar[set[str]] = set()
    writes: list[tuple[int, WheelSpeeds]]
    faults: int
    angles: tuple[float, float]
    closed: int

    def __init__(self, context: DriverContext) -> None:
        """Make the driver.

        Args:
            context: What a driver is made from.

        Raises:
            DriverError: Where the robot is ``absent``.
        """
        if context.robot in self.absent:
            raise DriverError(f"{context.robot} is not there")
        self.instances[context.robot] = self
        self._robot, self._now_ns = context.robot, context.now_ns
        self.writes, self.faults, self.angles, self.closed = [], 0, (0.0, 0.0), 0

    @classmethod
    def reset(cls) -> None:
        """Forget all drivers and all failures."""
        for names in (cls.instances, cls.absent, cls.unwritable, cls.unreadable):
            names.clear()

    @property
    def target(self) -> WheelSpeeds:
        """The newest command [rad/s]."""
        return self.writes[-1][1] if self.writes else STOP

    def write(self, wheels: WheelSpeeds) -> None:
        """Record a command.

        Args:
            wheels: Speeds of the wheels [rad/s].

        Raises:
            OSError: Where the robot is ``unwritable``.
        """
        if self._robot in self.unwritable:
            raise OSError(f"{self._robot} is unplugged")
        self.writes.append((self._now_ns(), wheels))

    def read(self) -> DriverReading:
        """Read wheels that turn as commanded.

        Returns:
            The reading, with ``angles`` and ``faults`` as the test has set them.

        Raises:
            OSError: Where the robot is ``unreadable``.
        """
        if self._robot in self.unreadable:
            raise OSError(f"{self._robot} does not answer")
        return DriverReading(*self.angles, *self.target, float("nan"), self.faults)

    def close(self) -> None:
        """Count it."""
        self.closed += 1
