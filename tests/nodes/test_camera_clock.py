"""A camera whose clock jumps in the middle of a run: pixels, tracker, filter and robots in one loop, and the truth."""

from collections.abc import Callable
from typing import Any

import pytest

from robofleet.core.clock import S
from robofleet.simulation.sources import SimulatedCamera
from robofleet.tracking.sources import Frame

JUMPS_S = 0.4  # after the start of the run


class Jumping(SimulatedCamera):
    """A simulated camera whose stamps jump."""

    AHEAD_NS = 0

    def read(self) -> Frame:
        frame = super().read()
        jumped = self._since_start(frame.exposure_ns) > JUMPS_S
        return frame._replace(exposure_ns=frame.exposure_ns + self.AHEAD_NS * jumped)


class Back(Jumping):
    """Its clock goes back by half a second."""

    AHEAD_NS = -S // 2


class Ahead(Jumping):
    """Its clock jumps five seconds ahead."""

    AHEAD_NS = 5 * S


@pytest.mark.slow
@pytest.mark.parametrize("camera", [Back, Ahead])
def test_robots_drive_on_when_the_cameras_clock_jumps(
    lockstep: Callable[..., dict[str, Any]], camera: type[Jumping]
) -> None:
    s = lockstep("run.duration_s=1.2", f"camera.source='{__name__}:{camera.__name__}'")
    jumps = [event for event in s["tracker"]["events"] if event["event"] == "clock_jumped"]
    assert len(jumps) == 1
    assert (s["outcome"], s["stops"]) == ("completed", [])
    assert s["pose_error"]["max_mm"] < 2.0
    assert s["tracker"]["measured_fraction"] > 0.9
