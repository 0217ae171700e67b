"""Every source of poses that is shipped keeps one contract, and so does one of a user's own."""

import json
import socket
import sys
from collections.abc import Iterator
from importlib.metadata import entry_points

import pytest

from robofleet.config.files.names import SHIPPED
from robofleet.simulation.capture import SimulatedCapture
from robofleet.testing import PoseBench, PoseContract
from robofleet.tracking.capture import CaptureFrame

MOCAP = SHIPPED / "mocap.yaml"
TAGS = tuple(f"robots.{row}.tag={row + 1}" for row in range(4))


class TestTruth(PoseContract):
    source = "truth"
    keys = ("tracker.truth={position_noise_m: 0.0003, heading_noise_rad: 0.004, delay_s: 0.01}",)


class TestCamera(PoseContract):
    source = "camera"
    keys = TAGS


class TestMocap(PoseContract):
    source = "mocap"


class TestMocapThatLiesTurned(PoseContract):
    source = "mocap"
    keys = (
        "tracker.mocap.up=y",
        "tracker.mocap.unit_m=0.001",
        "tracker.mocap.origin={x_m: 0.5, y_m: -0.3, heading_deg: 100}",
        "camera.simulated.tag_offsets=[{robot: r2, forward_m: 0.02, left_m: -0.01, heading_deg: 30}]",
        "robots.1.calibration={robot: r2, tag_offset: {forward_m: 0.02, left_m: -0.01, heading_deg: 30}}",
    )


class TestUdp(PoseContract):
    """The shipped example of a source of one's own."""

    source = "myposes:UdpPoses"
    threaded = True

    @pytest.fixture(autouse=True)
    def found(self, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
        monkeypatch.setattr(sys, "path", [*sys.path, str(MOCAP.parent)])
        monkeypatch.delenv("ROBOFLEET_MODULES", raising=False)
        yield
        sys.modules.pop("myposes", None)

    def measure(self, bench: PoseBench) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(json.dumps(bench.poses()).encode(), ("127.0.0.1", sys.modules["myposes"].PORT))


def test_every_source_that_is_shipped_has_its_contract() -> None:
    tried = {kind.source for kind in PoseContract.__subclasses__()}
    assert {point.name for point in entry_points(group="robofleet.poses")} <= tried


def test_a_motion_capture_that_fails_is_opened_again_and_reported_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    read, failures = SimulatedCapture.read, iter([ConnectionError("it has gone")] * 3)

    def fail_at_first(capture: SimulatedCapture) -> CaptureFrame:
        for failure in failures:
            raise failure
        return read(capture)

    monkeypatch.setattr(SimulatedCapture, "read", fail_at_first)
    bench = PoseBench("mocap", ())
    source, observed = bench.open(), 0
    for _ in range(200):
        bench.step()
        observed += source.observe(bench.clock.now_ns()) is not None
    assert observed > 5
    assert capsys.readouterr().err == "motion capture: it has gone\n"
