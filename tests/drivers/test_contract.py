"""Every driver keeps the contract."""

from tests.drivers.contract import Contract, Subject


class TestSimulated(Contract):
    subject = Subject("simulated", twin=None)


class TestGTernal(Contract):
    subject = Subject("gternal", twin="gternal", vehicle="gternal", encoders=False)


class TestGTernalWithSensors(Contract):
    subject = Subject("gternal", twin="gternal", vehicle="gternal", sensors=True, encoders=False)


class TestArduinoBridge(Contract):
    subject = Subject("arduino_bridge", twin="arduino_bridge", vehicle="arduino", settings={"counts_per_turn": 2248})


class TestCreate2(Contract):
    subject = Subject("create2", twin="create2", vehicle="create2")
