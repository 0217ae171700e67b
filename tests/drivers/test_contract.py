"""Every driver keeps the contract."""

from tests.drivers.contract_bench import Subject
from tests.drivers.contract_motion import Motion


class TestSimulated(Motion):
    subject = Subject("simulated", twin=None)


class TestLineRobot(Motion):
    subject = Subject("tests.drivers.line_robot:LineRobot", twin="tests.drivers.line_robot:LineFirmware")


class TestGTernal(Motion):
    subject = Subject("gternal", twin="gternal", vehicle="gternal", encoders=False)


class TestArduinoBridge(Motion):
    subject = Subject(
        "arduino_bridge", twin="arduino_bridge", vehicle="arduino", settings={"counts_per_turn": 2248}
    )


class TestCreate2(Motion):
    subject = Subject("create2", twin="create2", vehicle="create2")
