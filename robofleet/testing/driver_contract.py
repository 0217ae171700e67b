"""The contract of drivers: a class of checks, to be subclassed with the driver under test.

Driver and twin stand in one thread, on a simulated clock, and talk over a real pseudo-terminal. The truth comes from
the twin's body, never from the driver.
"""

from robofleet.testing.driver_cost import Cost
from robofleet.testing.driver_lines import BadLines
from robofleet.testing.driver_motion import Motion
from robofleet.testing.driver_port import Port


class DriverContract(Motion, BadLines, Port, Cost):
    """Checks for every driver: motion, bad lines, the port, and cost.

    Subclass it in a file of tests::

        class TestMyRobot(DriverContract):
            subject = DriverSubject("my_robot:MyRobot", twin="my_firmware:MyFirmware", vehicle="mine.yaml")

    A driver that waits for its robot while it is made uses ``SerialPort.wait`` or ``select.select``: then the twin's
    time passes. The contract does not check what stops a robot whose driver's process hangs or dies. Checks of hours
    are marked ``slow`` and ``long``.

    Attributes:
        subject: The driver under test.
    """
