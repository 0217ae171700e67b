"""What every driver has to keep, whoever wrote it: one class of checks, to be subclassed with what is tried.

    from tests.drivers.contract import Contract, Subject

    class TestMyRobot(Contract):
        subject = Subject("my_robot:MyRobot", twin="my_firmware:MyFirmware", vehicle="mine.yaml")

In a folder of your own: ``PYTHONPATH=.:/path/to/robofleet pytest -m "not slow" test_my_robot.py``.

Driver and twin stand in one thread, on a clock that nobody waits for, and talk over a real pseudo-terminal; the truth
comes from the twin's body, never from the driver. ``test_contract_sabotage.py`` shows that each check notices a driver
that breaks it. A driver that waits for its robot while it is being made does so with ``SerialPort.wait`` or
``select.select``: then the twin's time passes. What stops a robot whose process hangs or dies is not tried here.
"""

from tests.drivers.contract_bench import Subject
from tests.drivers.contract_cost import Cost
from tests.drivers.contract_line import BadLines
from tests.drivers.contract_motion import Motion
from tests.drivers.contract_port import Port

__all__ = ["Contract", "Subject"]


class Contract(Motion, BadLines, Port, Cost):
    """All of it."""
