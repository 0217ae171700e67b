from tests.drivers.contract_motion import *


class TestLine(Motion):
    subject = Subject("tests.drivers.line_robot:LineRobot", "tests.drivers.line_robot:LineFirmware")


class TestSim(Motion):
    subject = Subject("simulated", None)
