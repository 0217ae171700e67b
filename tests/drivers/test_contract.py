"""Every driver keeps the contract."""

from robofleet.testing import DriverContract, DriverSubject


class TestSimulated(DriverContract):
    subject = DriverSubject("simulated", twin=None)


class TestGTernal(DriverContract):
    subject = DriverSubject("gternal", twin="gternal", vehicle="gternal", encoders=False)


class TestGTernalWithSensors(DriverContract):
    subject = DriverSubject("gternal", twin="gternal", vehicle="gternal", sensors=True, encoders=False)


class TestArduinoBridge(DriverContract):
    subject = DriverSubject(
        "arduino_bridge", twin="arduino_bridge", vehicle="arduino", settings={"counts_per_turn": 2248}
    )


class TestCreate2(DriverContract):
    subject = DriverSubject("create2", twin="create2", vehicle="create2")
