"""A V4L2 camera. No machine of a test has one: the real class drives what OpenCV's capture would be."""

import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, WallClock, stopwatch_ns
from robofleet.testing import CameraContract
from robofleet.tracking.cameras.v4l2 import EXPOSURE_ABSOLUTE, GAIN, Range, V4L2Camera, control_range, device_identity
from robofleet.tracking.sources import CameraError, Exposure, Frame
from tests.contexts import context
from tests.shipped import PLATOON

EXPOSURE_S, READOUT_S = 0.006, 0.009
DEVICE = "/dev/video-of-a-test"


def clocks() -> tuple[int, float]:
    """Return this host's instant [ns], and what the kernel would stamp a buffer with at it [ms].

    That is CLOCK_MONOTONIC, which on Linux the stopwatch reads.
    """
    readings = []
    for _ in range(5):
        before_ns, now_ns, after_ns = stopwatch_ns(), WallClock().now_ns(), stopwatch_ns()
        readings.append((after_ns - before_ns, now_ns, (before_ns + after_ns) / 2 / MS))
    return min(readings)[1:]


class Capture:
    """OpenCV's V4L2 capture: settings, of which some stay as they are, and buffers with their stamps."""

    def __init__(self, **keeps: float) -> None:
        self.keeps = {getattr(cv2, f"CAP_PROP_{name}"): value for name, value in keeps.items()}
        self.has: dict[int, float] = {cv2.CAP_PROP_FRAME_WIDTH: 640, cv2.CAP_PROP_FRAME_HEIGHT: 480} | self.keeps
        self.order: list[int] = []
        self.width = 640.0
        self.buffers: list[tuple[NDArray[np.uint8], float]] = []
        self.stamp_ms = 0.0
        self.opened = True
        self.released = 0

    def __call__(self, device: str, backend: int) -> "Capture":
        assert (device, backend) == (DEVICE, cv2.CAP_V4L2)
        return self

    def isOpened(self) -> bool:
        return self.opened

    def set(self, key: int, value: float) -> bool:
        self.order.append(key)
        if key == cv2.CAP_PROP_FRAME_WIDTH:  # takes effect with the height
            self.width = value
        elif key == cv2.CAP_PROP_FRAME_HEIGHT:
            self.has |= {cv2.CAP_PROP_FRAME_WIDTH: self.width, key: value}
        else:
            self.has[key] = value
        self.has |= self.keeps
        return key not in self.keeps

    def get(self, key: int) -> float:
        return self.stamp_ms if key == cv2.CAP_PROP_POS_MSEC else self.has.get(key, -1.0)

    def read(self) -> tuple[bool, Any]:
        if not self.buffers:
            return False, None
        data, self.stamp_ms = self.buffers.pop(0)
        return True, data

    def release(self) -> None:
        self.released += 1


MEASURED = "camera.model.camera=somebody's"


def config(*overrides: str) -> Config:
    return load_config(
        PLATOON,
        [
            "camera.source=v4l2", "camera.trigger=free", f"camera.v4l2.device={DEVICE}",
            f"camera.exposure_s={EXPOSURE_S}", f"camera.readout_s={READOUT_S}", *overrides,
        ],
    )  # fmt: skip


RANGES = {EXPOSURE_ABSOLUTE: Range(3, 2047, 1), GAIN: Range(0, 255, 5)}


def camera_of(capture: Capture, *overrides: str, ranges: dict[int, Range] = RANGES) -> V4L2Camera:
    made_from = context(config(*overrides), WallClock())
    return V4L2Camera(made_from, capture, lambda _, control: ranges.get(control))


def scene() -> NDArray[np.uint8]:
    return np.tile(np.arange(0, 160, dtype=np.uint8), (120, 1))


class TestContract(CameraContract):
    shape = (120, 160)

    @pytest.fixture
    def camera(self) -> V4L2Camera:
        capture = Capture()
        _, stamp_ms = clocks()
        capture.buffers = [(scene() + k, stamp_ms - 100.0 + 20.0 * k) for k in range(4)]
        return camera_of(capture, "camera.v4l2.format=GREY")


def read(capture: Capture, camera: V4L2Camera, data: NDArray[np.uint8], age_ms: float = 20.0) -> tuple[Frame, int]:
    """Return an image whose buffer was stamped so long ago, and when that was on this host's clock."""
    now_ns, stamp_ms = clocks()
    capture.buffers.append((data, stamp_ms - age_ms))
    return camera.read(), now_ns - round(age_ms * MS)


def test_everything_is_asked_of_the_device() -> None:
    capture = Capture()
    camera_of(capture, "camera.v4l2.gain=17")
    wanted = {
        cv2.CAP_PROP_FOURCC: cv2.VideoWriter.fourcc(*"MJPG"),
        cv2.CAP_PROP_FRAME_WIDTH: 1280,
        cv2.CAP_PROP_FRAME_HEIGHT: 720,
        cv2.CAP_PROP_FPS: 30,
        cv2.CAP_PROP_CONVERT_RGB: 0,
        cv2.CAP_PROP_BUFFERSIZE: 1,
        cv2.CAP_PROP_AUTO_EXPOSURE: 1,
        cv2.CAP_PROP_EXPOSURE: 60,  # in 100 us
        cv2.CAP_PROP_GAIN: 17,
        cv2.CAP_PROP_AUTOFOCUS: 0,
    }
    assert {key: capture.has[key] for key in wanted} == wanted
    order = capture.order.index
    assert order(cv2.CAP_PROP_FOURCC) < order(cv2.CAP_PROP_FRAME_HEIGHT), "sizes depend on the format"
    assert order(cv2.CAP_PROP_AUTO_EXPOSURE) < order(cv2.CAP_PROP_EXPOSURE), "else it is refused"


@pytest.mark.parametrize(
    ("keeps", "says"),
    [
        ({"FOURCC": cv2.VideoWriter.fourcc(*"YUYV")}, "camera.v4l2.format MJPG (it has YUYV)"),
        ({"FRAME_WIDTH": 1264}, "camera.width 1280 (it has 1264)"),
        ({"FRAME_WIDTH": 640}, "camera.width 1280 (it has 640)"),
        ({"FRAME_HEIGHT": 480}, "camera.height 720 (it has 480)"),
        ({"FPS": 15}, "camera.rate_hz 30 (it has 15)"),
        ({"AUTO_EXPOSURE": 3}, "manual exposure 1 (it has 3)"),
        ({"EXPOSURE": 157}, "camera.exposure_s 0.006 (it has 0.0157)"),
        ({"GAIN": -1}, "camera.v4l2.gain 0 (it has -1)"),
        ({"CONVERT_RGB": 1}, "raw images"),
    ],
)
def test_what_a_device_does_not_take_over_is_named(keeps: dict[str, float], says: str) -> None:
    capture = Capture(**keeps)
    with pytest.raises(CameraError) as error:
        camera_of(capture)
    assert says in str(error.value)
    assert DEVICE in str(error.value)
    assert str(error.value).count("(it has") == 1
    assert capture.released == 1


def test_all_that_is_refused_is_said_at_once_and_rounding_is_not_refused() -> None:
    with pytest.raises(CameraError) as error:
        camera_of(Capture(FPS=29.97, EXPOSURE=61, AUTO_EXPOSURE=3, GAIN=4, AUTOFOCUS=1, BUFFERSIZE=2))
    assert str(error.value).count("(it has") == 2
    camera_of(Capture(FPS=29.97, EXPOSURE=61, GAIN=-1), "camera.v4l2.gain=null")


@pytest.mark.parametrize("name", ["MJPG", "GREY"])
def test_images_come_gray_and_whole(name: str) -> None:
    capture = Capture()
    camera = camera_of(capture, f"camera.v4l2.format={name}")
    broken = []
    data = scene()
    if name == "MJPG":
        jpeg = cv2.imencode(".jpg", cv2.merge([scene()] * 3), [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
        data = jpeg.reshape(1, -1)
        broken = [data[:, : data.size // 3], np.zeros((1, 50), np.uint8), np.zeros((1, 0), np.uint8)]
    capture.buffers = [(entry, clocks()[1] - 100) for entry in broken]
    frame, stamped_ns = read(capture, camera, data)
    assert frame.image.shape == scene().shape
    assert np.abs(frame.image.astype(int) - scene()).max() <= 3
    assert abs(frame.exposure_ns - stamped_ns) < 15 * MS, "its own stamp, not that of a broken one"


@pytest.mark.parametrize(
    ("stamp", "line_time_s", "after_s"),
    [
        ("start", 0.0, EXPOSURE_S / 2),
        ("start", 2e-5, EXPOSURE_S / 2 + 719 * 1e-5),
        ("end", 0.0, -READOUT_S - EXPOSURE_S / 2),
        ("end", 2e-5, -READOUT_S - EXPOSURE_S / 2 + 719 * 1e-5),
    ],
)
def test_mid_exposure_is_told_from_the_kernels_stamp(
    monkeypatch: pytest.MonkeyPatch, stamp: str, line_time_s: float, after_s: float
) -> None:
    monkeypatch.setattr(
        "robofleet.core.clock._CLOCK", 0
    )  # CLOCK_REALTIME: far from the kernel's, as after a long sleep
    capture = Capture()
    overrides = [f"camera.v4l2.stamp={stamp}", f"camera.model.line_time_s={line_time_s:.6f}", "camera.v4l2.format=GREY"]
    frame, stamped_ns = read(capture, camera_of(capture, *overrides), scene())
    assert frame.exposure_ns - stamped_ns == pytest.approx(after_s * S, abs=1 * MS)


def test_an_image_has_the_old_exposure_if_it_began_before_the_change(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robofleet.core.clock._CLOCK", 0)
    for stamp in ("start", "end"):
        capture = Capture()
        camera = camera_of(capture, f"camera.v4l2.stamp={stamp}", "camera.v4l2.format=GREY")
        assert read(capture, camera, scene())[0].exposure == Exposure(EXPOSURE_S, 0.0)
        camera.adjust(Exposure(0.0101, 40.0))
        assert (capture.has[cv2.CAP_PROP_EXPOSURE], capture.has[cv2.CAP_PROP_GAIN]) == (60, 0), "not in another thread"
        for age_ms, exposure_s in ((20.0, EXPOSURE_S), (-5.0, 0.0101 if stamp == "start" else EXPOSURE_S)):
            frame, stamped_ns = read(capture, camera, scene(), age_ms)
            assert (capture.has[cv2.CAP_PROP_EXPOSURE], capture.has[cv2.CAP_PROP_GAIN]) == (101, 40)
            assert frame.exposure.time_s == pytest.approx(exposure_s)
            after_s = exposure_s / 2 if stamp == "start" else -READOUT_S - exposure_s / 2
            assert frame.exposure_ns - stamped_ns == pytest.approx(after_s * S, abs=1 * MS)


def test_what_the_device_made_of_a_change_is_told() -> None:
    capture = Capture()
    camera = camera_of(capture, "camera.v4l2.format=GREY")
    capture.keeps = {cv2.CAP_PROP_EXPOSURE: 80.0, cv2.CAP_PROP_GAIN: 35.0}
    camera.adjust(Exposure(0.0101, 40.0))
    read(capture, camera, scene())
    assert read(capture, camera, scene(), -5.0)[0].exposure == Exposure(pytest.approx(0.008), 35.0)


def test_limits_are_the_devices() -> None:
    limits = camera_of(Capture()).exposure_limits()
    assert limits.shortest == Exposure(pytest.approx(0.0003), 0)
    assert limits.longest == Exposure(pytest.approx(0.2047), 255)
    assert limits.step == Exposure(pytest.approx(0.0001), 5)
    assert 255 * limits.gain_db == pytest.approx(24.0)
    without = camera_of(Capture(GAIN=-1), "camera.v4l2.gain=null").exposure_limits()
    assert (without.shortest.gain, without.longest.gain) == (0, 0)
    with pytest.raises(CameraError, match=r"set camera\.exposure_control to fixed"):
        camera_of(Capture(), ranges={}).exposure_limits()


@pytest.mark.parametrize(("flags", "known"), [(0, True), (0x10, True), (0x1, False), (0x4, False)])
def test_a_controls_range_is_asked_of_the_kernel(tmp_path: Path, flags: int, known: bool) -> None:
    device = tmp_path / "video0"
    device.write_text("")

    def ioctl(_descriptor: int, request: int, buffer: bytearray) -> int:
        assert request == 0xC0445624  # VIDIOC_QUERYCTRL of a struct of 68 bytes
        assert (len(buffer), struct.unpack_from("=I", buffer)) == (68, (GAIN,))
        struct.pack_into("=iiiiI", buffer, 40, 16, 255, 2, 64, flags)
        return 0

    assert control_range(str(device), GAIN, ioctl) == (Range(16, 255, 2) if known else None)
    assert control_range(str(device), GAIN) is None, "a file is no camera"
    assert control_range(str(tmp_path / "none"), GAIN) is None


@pytest.mark.parametrize("age_s", [-1.0, 60.0, 1.7e9, -1.7e9])
def test_stamps_of_another_clock_are_refused(age_s: float) -> None:
    capture = Capture()
    camera = camera_of(capture, "camera.v4l2.format=GREY")
    with pytest.raises(CameraError, match="stamps its images by another clock"):
        read(capture, camera, scene(), age_s * 1e3)


def test_a_stamp_that_jumps_later_is_left_to_the_watch() -> None:
    capture = Capture()
    camera = camera_of(capture, "camera.v4l2.format=GREY")
    for age_s in (0.02, -5.0, 20.0, 0.02):
        frame, stamped_ns = read(capture, camera, scene(), age_s * 1e3)
        assert abs(frame.exposure_ns - stamped_ns) < 15 * MS


def test_a_device_that_gives_nothing_is_unplugged() -> None:
    with pytest.raises(CameraError, match=f"{DEVICE} gives no image"):
        camera_of(Capture()).read()


def test_closing_lets_go_of_the_device() -> None:
    capture = Capture()
    camera = camera_of(capture)
    camera.close()
    assert capture.released == 1


def test_a_device_that_is_not_there_is_refused_before_anything_starts_and_when_it_is_opened() -> None:
    complaints = dict(V4L2Camera.refusals(config("camera.trigger=tick", MEASURED)))
    assert set(complaints) == {"camera.v4l2.device", "camera.trigger"}
    assert DEVICE in complaints["camera.v4l2.device"]
    with pytest.raises(CameraError, match=f"{DEVICE} cannot be opened"):
        V4L2Camera(context(config(), WallClock()))


def test_a_file_is_no_device(tmp_path: Path) -> None:
    (tmp_path / "video0").write_text("")
    ((where, _),) = V4L2Camera.refusals(config(f"camera.v4l2.device={tmp_path / 'video0'}", MEASURED))
    assert where == "camera.v4l2.device"
    assert list(V4L2Camera.refusals(config("camera.v4l2.device=/dev/null", MEASURED))) == []


def test_a_lens_that_nobody_measured_is_refused() -> None:
    ((where, why),) = V4L2Camera.refusals(config("camera.v4l2.device=/dev/null"))
    assert where == "camera.source"
    assert "robofleet calibrate intrinsics" in why


@pytest.mark.parametrize(("serial", "known_by"), [("A1B2\n", "A1B2"), (None, "at 1-2:1.0")])
def test_a_camera_is_known_by_its_name_and_number_else_by_its_socket(
    tmp_path: Path, serial: str | None, known_by: str
) -> None:
    usb, entry, link = tmp_path / "devices" / "usb1" / "1-2", tmp_path / "class" / "video3", tmp_path / "by-id"
    (usb / "1-2:1.0" / "video4linux" / "video3").mkdir(parents=True)
    if serial is not None:
        (usb / "serial").write_text(serial)
    entry.mkdir(parents=True)
    (entry / "name").write_text("HD Webcam: HD Webcam\n")
    (entry / "device").symlink_to(usb / "1-2:1.0")
    link.symlink_to("/dev/video3")
    for device in (link, Path("/dev/video3")):
        assert device_identity(device, tmp_path / "class") == f"HD Webcam: HD Webcam {known_by}"
    assert device_identity(Path("/dev/video7"), tmp_path / "class") == "/dev/video7"
