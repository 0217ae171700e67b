"""A Basler camera, on the emulation that pylon brings."""

import importlib.util
import itertools
import math
import sys
import threading
from collections import deque
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import TICK
from robofleet.bus.messages import TICK_RECORD, TickRecord
from robofleet.bus.ticks import TickFollower
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, WallClock
from robofleet.testing import CameraContract
from robofleet.tracking.cameras.basler import BaslerCamera, DeviceClock, SoftwareTrigger
from robofleet.tracking.sources import CameraError, Exposure
from tests.contexts import context
from tests.shipped import PLATOON

TICK_NS = 33 * MS
EMULATED = "0815-0000"


def config(*overrides: str) -> Config:
    small = [f"camera.{part}{key}={n}" for key, n in (("width", 320), ("height", 240)) for part in ("", "model.")]
    return load_config(PLATOON, ["camera.source=basler", *small, *overrides])


class Lab:
    """Where cameras are opened and closed again, and where ticks can be told."""

    def __init__(self) -> None:
        self.clock = WallClock()
        self.bus = MemoryBus("platoon", self.clock, 0)
        self.ticks = TickFollower(self.bus, TICK_NS, lambda _: None)
        self.cameras: list[BaslerCamera] = []
        self._say = self.bus.publisher(TICK)

    def open(self, *overrides: str) -> BaslerCamera:
        self.cameras.append(BaslerCamera(context(config(*overrides), self.clock, bus=self.bus, ticks=self.ticks)))
        return self.cameras[-1]

    def tick(self, number: int) -> None:
        self._say(TICK_RECORD.encode(TickRecord(1, 1, number, -1, self.clock.now_ns(), *[0] * 11, (), ())))
        self.ticks.update()


@pytest.fixture
def lab(monkeypatch: pytest.MonkeyPatch) -> Iterator[Lab]:
    monkeypatch.setenv("PYLON_CAMEMU", "1")
    lab = Lab()
    yield lab
    for camera in lab.cameras:
        camera.close()


class TestContract(CameraContract):
    shape = (240, 320)

    @pytest.fixture
    def camera(self, lab: Lab) -> BaslerCamera:
        return lab.open("camera.trigger=free", "camera.rate_hz=50")


def test_images_come_at_their_rate_each_its_own(lab: Lab) -> None:
    camera = lab.open("camera.trigger=free", "camera.rate_hz=50")
    frames, since_ns = [], []
    for _ in range(10):
        frames.append(camera.read())
        since_ns.append(lab.clock.now_ns() - frames[-1].exposure_ns)
    assert all((before.image != other.image).any() for before, other in itertools.pairwise(frames))
    assert all(frame.image.flags.writeable for frame in frames), "kernels are compiled for such"
    # A busy machine delays whole stretches of images: ten in a row have to come at the camera's rate.
    newest_ns = deque((frame.exposure_ns for frame in frames), maxlen=10)
    for _ in range(1000):
        if at_rate := abs(np.median(np.diff(newest_ns)) - 20 * MS) < 3 * MS:
            break
        newest_ns.append(camera.read().exposure_ns)
    assert at_rate
    # Without stamps of its own: as long before its arrival as exposure and readout take.
    assert min(since_ns) == pytest.approx((0.004 / 2 + 0.004) * S, abs=5 * MS)  # a busy machine delays some


def test_the_image_that_comes_next_is_the_newest(lab: Lab) -> None:
    camera = lab.open("camera.trigger=free", "camera.rate_hz=100")
    first = camera.read().image
    lab.clock.sleep_until(lab.clock.now_ns() + 200 * MS)
    grown = int(camera.read().image[0, 0]) - int(first[0, 0])  # the emulation's pattern moves by one an image
    assert grown % 256 > 5


@pytest.mark.parametrize(
    ("override", "says"), [("camera.basler.gain=500", "camera.basler.gain"), ("camera.rate_hz=10000", "camera.rate_hz")]
)
def test_a_setting_that_is_not_taken_over_is_named_and_the_camera_let_go_of(lab: Lab, override: str, says: str) -> None:
    with pytest.raises(CameraError, match=says):
        lab.open("camera.trigger=free", override)
    if says == "camera.rate_hz":
        lab.open("camera.trigger=free").read()


def test_a_size_that_the_sensor_does_not_have(lab: Lab) -> None:
    with pytest.raises(CameraError, match=r"camera\.width: 16384"):
        lab.open("camera.trigger=free", "camera.width=16384", "camera.model.width=16384")


def test_the_camera_that_is_meant_is_opened(lab: Lab) -> None:
    with pytest.raises(CameraError, match=f"there is no such camera .*{EMULATED}"):
        lab.open(f"camera.basler.serial='{EMULATED}1'")
    assert lab.open("camera.trigger=free", f"camera.basler.serial='{EMULATED}'").identity == f"Emulation {EMULATED}"


def test_of_several_cameras_one_has_to_be_named(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYLON_CAMEMU", "2")
    with pytest.raises(CameraError, match=r"say which .*0815-0000.*0815-0001"):
        lab.open()
    assert lab.open("camera.trigger=free", "camera.basler.serial='0815-0001'").identity.endswith("0815-0001")


@pytest.mark.slow_after_first
@pytest.mark.parametrize("exposure_s", [0.004, 0.0002])
def test_a_tick_triggers_one_image_its_lead_before_the_next_tick(lab: Lab, exposure_s: float) -> None:
    lead_s = 0.018
    readout_s = 0.011 - exposure_s  # the emulation gives an image 11 ms after its trigger, whatever its exposure
    camera = lab.open(
        "camera.trigger=tick", f"camera.trigger_lead_s={lead_s}",
        f"camera.exposure_s={exposure_s}", f"camera.readout_s={readout_s:.4f}",
    )  # fmt: skip
    exposures: list[int] = []

    def reader() -> None:
        try:
            while True:
                exposures.append(camera.read().exposure_ns)
        except CameraError:
            pass

    thread = threading.Thread(target=reader)
    thread.start()
    origin_ns = lab.clock.now_ns() + 20 * MS
    tick = 0
    while len(exposures) < 6 and tick < 90:  # a busy machine wakes too late for some triggers: these are left out
        tick += 1
        lab.clock.sleep_until(origin_ns + tick * TICK_NS)
        lab.tick(tick)
    lab.clock.sleep_until(lab.clock.now_ns() + 150 * MS)
    camera.close()
    thread.join(5)
    assert not thread.is_alive(), "a camera that is closed ends its read"
    assert 6 <= len(exposures) <= tick, "one image a tick, and none without"
    off_ns = [abs((at - origin_ns) % TICK_NS - (TICK_NS - lead_s * S)) for at in exposures]
    assert min(off_ns) < 4 * MS


def test_the_trigger_moves_by_half_the_change_of_the_exposure(lab: Lab) -> None:
    trigger = SoftwareTrigger(config("camera.trigger=tick"), lab.ticks, lab.clock)
    trigger.exposure_s = 0.0001

    def lateness_ms(tick: int) -> float:
        lab.tick(tick)
        at_ns = lab.ticks.instant(lab.ticks.newest)
        end_ns = lab.clock.now_ns() + 60 * MS
        triggered = trigger.wait(lambda: lab.clock.now_ns() < end_ns)
        return (lab.clock.now_ns() - at_ns) / MS if triggered else math.inf

    for exposure_s in (0.0001, 0.014, 0.0001):  # a busy machine wakes late: the promptest of some counts
        trigger.exposure_s = exposure_s
        began = lab.ticks.newest
        least_ms = min(lateness_ms(began + 1 + k) for k in range(8))
        assert least_ms >= 15 - 1e3 * exposure_s / 2, "never before its instant"
        assert least_ms < 15 - 1e3 * exposure_s / 2 + 4


@pytest.mark.slow
def test_exposure_and_gain_are_adjusted_between_two_images(lab: Lab) -> None:
    for overrides in (["camera.trigger=free", "camera.rate_hz=50"], ["camera.trigger=tick"]):
        camera = lab.open(*overrides)
        if overrides[0].endswith("tick"):
            trigger = camera._trigger
            trigger.wait = lambda _running: True  # type: ignore[method-assign]
        assert camera.read().exposure == Exposure(0.004, 0.0)
        limits = camera.exposure_limits()
        assert limits.shortest == Exposure(pytest.approx(1e-6), 0.0)
        assert limits.longest.gain == pytest.approx(48.0)
        assert limits.gain_db == 1.0
        camera.adjust(Exposure(0.007, 6.0))
        frames = [camera.read() for _ in range(6)]
        assert frames[-1].exposure == Exposure(pytest.approx(0.007, abs=1e-6), pytest.approx(6.0, abs=0.01))
        if overrides[0].endswith("tick"):
            assert {frame.exposure for frame in frames} == {frames[-1].exposure}, "triggered after the change"
            assert trigger.exposure_s == pytest.approx(0.007, abs=1e-6)
        camera.close()


def test_a_line_that_triggers_keeps_the_exposure() -> None:
    line = ["camera.trigger=tick", "camera.basler.trigger_source=Line1", "camera.model.camera=somebody's"]
    assert not config(*line).camera.adjusts_exposure
    assert config(line[0]).camera.adjusts_exposure
    ((where, why),) = BaslerCamera.refusals(config(*line, "camera.exposure_control=auto"))
    assert where == "camera.exposure_control"
    assert "set it to fixed" in why


def test_a_tick_triggers_once_and_one_that_is_known_too_late_never(lab: Lab) -> None:
    trigger = SoftwareTrigger(config("camera.trigger=tick"), lab.ticks, lab.clock)  # 13 ms after a tick

    def triggers(within_ms: int) -> bool:
        end_ns = lab.clock.now_ns() + within_ms * MS
        return trigger.wait(lambda: lab.clock.now_ns() < end_ns)

    origin_ns = lab.clock.now_ns()

    def tick() -> int:
        """Say the next tick at its instant, and return that."""
        number = (lab.clock.now_ns() - origin_ns) // TICK_NS + 1
        lab.clock.sleep_until(origin_ns + number * TICK_NS)
        lab.tick(number)
        return origin_ns + number * TICK_NS

    def triggered() -> bool:
        """Whether one of some ticks triggers: a busy machine wakes too late for others."""
        for _ in range(30):
            at_ns = tick()
            if triggers(100):
                assert lab.clock.now_ns() - at_ns >= 12 * MS
                return True
        return False

    assert not triggers(5), "there was no tick"
    assert triggered()
    assert not triggers(5)
    tick()
    lab.clock.sleep_until(lab.clock.now_ns() + 40 * MS)
    assert not triggers(5)
    assert triggered()


def test_a_line_triggers_it_too(lab: Lab) -> None:
    camera = lab.open("camera.trigger=tick", "camera.basler.trigger_source=Line1")
    done = threading.Event()

    def reader() -> None:
        with pytest.raises(CameraError, match="gives no images any more"):
            camera.read()
        done.set()

    threading.Thread(target=reader, daemon=True).start()
    assert not done.wait(0.2), "nobody pulls the line"
    camera.close()
    assert done.wait(5)


def test_without_pypylon_it_says_what_to_install(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    assert importlib.util.find_spec("pypylon") is not None
    measured = "camera.model.camera=somebody's"
    assert list(BaslerCamera.refusals(config(measured))) == []
    assert [where for where, _ in BaslerCamera.refusals(config())] == ["camera.source"]
    monkeypatch.setitem(sys.modules, "pypylon", None)
    ((where, why),) = BaslerCamera.refusals(config(measured))
    assert where == "camera.source"
    assert "pip install 'robofleet[basler]'" in why
    with pytest.raises(CameraError, match="pip install"):
        lab.open()


# Its clock


@pytest.mark.slow
@given(
    st.lists(st.floats(0, 20e-3), min_size=80, max_size=200),
    st.integers(-(10**17), 10**17),
    st.sampled_from([1.0, 8.0, 1000 / 36]),
    st.floats(-50e-6, 50e-6),
)
@settings(deadline=None, derandomize=True, max_examples=50)
def test_stamps_tell_arrivals_without_their_jitter(
    jitter_s: list[float], origin_ns: int, tick_ns: float, drift: float
) -> None:
    """Truth: 30 images/s, a clock of any origin that goes up to 50 ppm wrong, and up to 20 ms of jitter."""
    jitter_s = [0.0 if k % 20 == 0 else jitter for k, jitter in enumerate(jitter_s)]  # one is prompt now and then
    clock = DeviceClock(tick_ns)
    for k, jitter in enumerate(jitter_s):
        device_ns = (k + 1) * S // 30
        prompt_ns = origin_ns + round(device_ns * (1 + drift))
        told_ns = clock.arrival(round(device_ns / tick_ns), prompt_ns + round(jitter * S))
        if k >= 64:
            assert abs(told_ns - prompt_ns) < 0.12 * MS  # two seconds of drift


def test_a_clock_that_was_set_back_is_learnt_anew() -> None:
    clock = DeviceClock(1.0)
    for k in range(1, 100):
        clock.arrival(k * 33 * MS, 5 * S + k * 33 * MS)
    assert clock.arrival(1 * MS, 20 * S) == 20 * S


def test_a_stamp_of_the_exposures_beginning_stays_right_while_exposures_grow(lab: Lab) -> None:
    camera = lab.open("camera.trigger=free", "camera.readout_s=0.005")
    origin_ns, errors = lab.clock.now_ns(), []
    for k in range(1, 300):
        exposure = Exposure(0.004 + 3e-5 * k, 0.0)
        camera._exposing.done(exposure, 0)
        jitter_ns = 0 if k % 20 == 0 else k * 7919 % 20 * MS
        began_ns = origin_ns + k * 33 * MS
        result = SimpleNamespace(TimeStamp=k * 33 * MS, Array=np.zeros((2, 2), np.uint8))
        frame = camera._frame(result, began_ns + round((exposure.time_s + 0.005) * S) + jitter_ns)
        if k > 64:
            errors.append(frame.exposure_ns - began_ns - exposure.time_s / 2 * S)
    assert np.abs(errors).max() < 1000, "a microsecond"


def test_without_stamps_the_arrival_is_what_is_known() -> None:
    clock = DeviceClock(1.0)
    arrivals = [S, S + 40 * MS, S + 60 * MS]
    assert [clock.arrival(0, arrival_ns) for arrival_ns in arrivals] == arrivals
