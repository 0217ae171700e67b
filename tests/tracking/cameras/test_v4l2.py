"""A V4L2 camera. No machine of a test has one: the real class drives what the kernel and OpenCV's capture would be."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, WallClock
from robofleet.testing import CameraContract
from robofleet.tracking.cameras.v4l2 import V4L2Camera, device_identity
from robofleet.tracking.cameras.v4l2_controls import TABLE
from robofleet.tracking.sources import CameraError, Exposure, Frame, ReopenedCamera
from tests.contexts import context
from tests.shipped import PLATOON
from tests.tracking.cameras.kernel_camera import (
    AUTO_EXPOSURE,
    AUTO_WHITE,
    AUTOFOCUS,
    BACKLIGHT,
    BRIGHTNESS,
    C920,
    CHEAP,
    DENOISING,
    DISABLED,
    DYNAMIC_RATE,
    END_OF_FRAME,
    EXPOSURE,
    FOCUS,
    GAIN,
    INDUSTRIAL,
    PERIOD_MS,
    POWER_LINE,
    READ_ONLY,
    SHARPNESS,
    START_OF_EXPOSURE,
    TEMPERATURE,
    ZOOM,
    Capture,
    KernelCamera,
    Knob,
    LiveCapture,
    clocks,
    instead,
    without,
)

EXPOSURE_S, READOUT_S = 0.006, 0.009
NONE = "/dev/video-of-a-test"
MEASURED = "camera.model.camera=somebody's"


def config(*overrides: str) -> Config:
    return load_config(
        PLATOON,
        [
            "camera.source=v4l2", "camera.trigger=free", f"camera.v4l2.device={NONE}",
            f"camera.exposure_s={EXPOSURE_S}", f"camera.readout_s={READOUT_S}", *overrides,
        ],
    )  # fmt: skip


Opened = Callable[..., V4L2Camera]


@pytest.fixture
def opened(tmp_path: Path) -> Opened:
    """Return how a camera is opened: its capture, overrides, and uvcvideo's parameters."""
    (tmp_path / "video0").touch()

    def open_it(capture: Capture, *overrides: str, **parameters: str) -> V4L2Camera:
        for name, value in parameters.items():
            (tmp_path / name).write_text(f"{value}\n")
        made_from = context(config(f"camera.v4l2.device={tmp_path / 'video0'}", *overrides), WallClock())
        return V4L2Camera(made_from, capture, capture.kernel, tmp_path)

    return open_it


def scene() -> NDArray[np.uint8]:
    return np.tile(np.arange(0, 160, dtype=np.uint8), (120, 1))


class TestContract(CameraContract):
    shape = (120, 160)

    @pytest.fixture
    def camera(self, opened: Opened) -> V4L2Camera:
        capture = Capture()
        _, stamp_ms = clocks()
        capture.images = [(scene() + k, stamp_ms - 100.0 + 20.0 * k) for k in range(4)]
        return opened(capture, "camera.v4l2.format=GREY")


def read(capture: Capture, camera: V4L2Camera, data: NDArray[Any], age_ms: float = 20.0) -> tuple[Frame, int]:
    """Return an image whose buffer was stamped so long ago, and when that was on this host's clock."""
    now_ns, stamp_ms = clocks()
    capture.images.append((data, stamp_ms - age_ms))
    return camera.read(), now_ns - round(age_ms * MS)


def test_everything_is_asked_of_the_device(opened: Opened) -> None:
    capture = Capture()
    opened(capture, "camera.v4l2.gain=17")
    wanted = {
        cv2.CAP_PROP_FOURCC: cv2.VideoWriter.fourcc(*"MJPG"),
        cv2.CAP_PROP_FRAME_WIDTH: 1280,
        cv2.CAP_PROP_FRAME_HEIGHT: 720,
        cv2.CAP_PROP_FPS: 30,
        cv2.CAP_PROP_CONVERT_RGB: 0,
        cv2.CAP_PROP_BUFFERSIZE: 3,
    }
    assert {key: capture.has[key] for key in wanted} == wanted
    order = capture.order.index
    assert order(cv2.CAP_PROP_FOURCC) < order(cv2.CAP_PROP_FRAME_HEIGHT), "sizes depend on the format"
    assert order(cv2.CAP_PROP_BUFFERSIZE) == 0, "it asks for the rest anew"
    assert capture.kernel.has == {
        BRIGHTNESS: 128, AUTO_WHITE: 0, GAIN: 17, POWER_LINE: 0, TEMPERATURE: 4000, SHARPNESS: 0, BACKLIGHT: 0,
        AUTO_EXPOSURE: 1, EXPOSURE: 60, DYNAMIC_RATE: 0, FOCUS: 0, AUTOFOCUS: 0, ZOOM: 100,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("keeps", "says"),
    [
        ({"FOURCC": cv2.VideoWriter.fourcc(*"YUYV")}, "camera.v4l2.format MJPG (it has YUYV)"),
        ({"FRAME_WIDTH": 1264}, "camera.width 1280 (it has 1264)"),
        ({"FRAME_WIDTH": 640}, "camera.width 1280 (it has 640)"),
        ({"FRAME_HEIGHT": 480}, "camera.height 720 (it has 480)"),
        ({"FPS": 15}, "camera.rate_hz 30 (it has 15)"),
        ({"CONVERT_RGB": 1}, "raw images"),
    ],
)
def test_a_format_that_a_device_does_not_take_over_is_named(opened: Opened, keeps: dict[str, float], says: str) -> None:
    capture = Capture(**keeps)
    with pytest.raises(CameraError, match="--list-formats-ext") as error:
        opened(capture)
    assert says in str(error.value)
    assert str(error.value).count("(it has") == 1
    assert "leaves a control as it is" not in str(error.value)
    assert capture.released == 1


def lying(number: int, value: int) -> tuple[Knob, ...]:
    """Return the controls of a camera that takes everything and has another value afterwards."""
    knob = next(knob for knob in C920 if knob.id == number)
    return instead(C920, replace(knob, lies=value))


@pytest.mark.parametrize(
    ("knobs", "says"),
    [
        (lying(AUTO_EXPOSURE, 3), "auto_exposure 1 (it has 3): exposure times must be known"),
        (lying(EXPOSURE, 157), "camera.exposure_s 0.006 (it has 0.0157)"),
        (without(C920, EXPOSURE), "camera.exposure_s 0.006 (it has none)"),
        (without(C920, GAIN), "camera.v4l2.gain 0 (it has none)"),
        (INDUSTRIAL, "camera.v4l2.gain 0 (it has 16)"),
        (lying(SHARPNESS, 3), "sharpness 0 (it has 3): it draws a bright and a dark line along each edge"),
        (lying(DYNAMIC_RATE, 1), "exposure_dynamic_framerate 0 (it has 1): it lowers the rate in the dark"),
        (
            instead(C920, Knob(AUTOFOCUS, "Focus, Automatic Continuous", 0, 1, 1, flags=READ_ONLY)),
            "focus_automatic_continuous 0 (it has 1): a lens that moves ends the calibration: take a camera whose "
            "focus is fixed or can be set",
        ),
    ],
)
def test_a_control_that_a_device_does_not_take_over_is_named(
    opened: Opened, knobs: tuple[Knob, ...], says: str
) -> None:
    capture = Capture(KernelCamera(knobs))
    with pytest.raises(CameraError, match=r"`camera\.v4l2\.controls: {NAME: null}` leaves a control as it is") as error:
        opened(capture)
    assert says in str(error.value)
    assert str(error.value).count("(it has") == 1
    assert capture.released == 1


def test_all_that_is_refused_is_said_at_once_and_rounding_is_not_refused(opened: Opened) -> None:
    knobs = instead(instead(lying(EXPOSURE, 61), replace(C920[2], lies=4)), replace(C920[5], lies=9))
    with pytest.raises(CameraError) as error:
        opened(Capture(KernelCamera(knobs), FPS=15, BUFFERSIZE=2))
    assert str(error.value).count("(it has") == 3
    opened(Capture(KernelCamera(lying(EXPOSURE, 61)), FPS=29.97))
    opened(Capture(KernelCamera(without(C920, GAIN))), "camera.v4l2.gain=null")


def test_a_camera_that_does_nothing_by_itself_needs_no_switches(opened: Opened) -> None:
    kernel = KernelCamera(INDUSTRIAL, driver="industrial")
    opened(Capture(kernel), "camera.v4l2.format=GREY", "camera.v4l2.gain=16")
    assert (kernel.has[EXPOSURE], kernel.has[DENOISING]) == (60, 0)


def test_old_kernels_names_and_a_menu_without_off_are_understood(opened: Opened) -> None:
    kernel = KernelCamera(CHEAP)
    opened(Capture(kernel))
    assert {key: kernel.has[key] for key in (AUTOFOCUS, AUTO_EXPOSURE, POWER_LINE, SHARPNESS)} == {
        AUTOFOCUS: 0, AUTO_EXPOSURE: 1, POWER_LINE: 1, SHARPNESS: 1,
    }  # fmt: skip


@pytest.mark.parametrize("insists", [False, True])
def test_autofocus_that_returns_with_the_stream_is_switched_off_again_or_refused(opened: Opened, insists: bool) -> None:
    knobs = instead(C920, Knob(AUTOFOCUS, "Focus, Automatic Continuous", 0, 1, 1, kind=2, streams=1, insists=insists))
    capture = Capture(KernelCamera(knobs))
    camera = opened(capture, "camera.v4l2.format=GREY", "camera.v4l2.focus=35")
    camera.adjust(Exposure(0.01, 3.0))  # that is no habit that came back
    if insists:
        with pytest.raises(CameraError, match=r"focus_automatic_continuous 0 \(it has 1\)") as error:
            read(capture, camera, scene())
        assert str(error.value).count("(it has") == 1
    else:
        read(capture, camera, scene())
        has = capture.kernel.has
        assert (has[AUTOFOCUS], has[FOCUS], has[EXPOSURE], has[GAIN]) == (0, 35, 100, 3)


def test_own_values_replace_the_table(opened: Opened) -> None:
    kernel = KernelCamera()
    own = "{sharpness: 3, brightness: 0, backlight_compensation: null, white_balance_temperature: 2800}"
    kernel.has[BACKLIGHT] = 1
    opened(Capture(kernel), f"camera.v4l2.controls={own}")
    assert (kernel.has[SHARPNESS], kernel.has[BRIGHTNESS]) == (3, 0)
    assert (kernel.has[BACKLIGHT], kernel.has[TEMPERATURE]) == (1, 2800)
    kernel = KernelCamera(CHEAP)  # a name of a newer kernel
    opened(Capture(kernel), "camera.v4l2.controls={focus_automatic_continuous: null}")
    assert kernel.has[AUTOFOCUS] == 1


@pytest.mark.parametrize(
    ("own", "says"),
    [
        ("{sharpnes: 3}", "camera.v4l2.controls: there is no sharpnes: did you mean 'sharpness'?"),
        ("{gain: 3}", "camera.v4l2.controls: write camera.v4l2.gain instead of gain"),
        ("{sharpness: 300}", "camera.v4l2.controls.sharpness 300 (it has 255)"),
    ],
)
def test_own_values_that_cannot_be_are_refused(opened: Opened, own: str, says: str) -> None:
    capture = Capture()
    with pytest.raises(CameraError) as error:
        opened(capture, f"camera.v4l2.controls={own}")
    assert says in str(error.value)
    assert capture.released == 1


@pytest.mark.parametrize("focus", [35, None])
def test_a_camera_that_is_plugged_in_again_has_the_values_that_it_was_calibrated_with(
    opened: Opened, focus: int | None
) -> None:
    kernel = KernelCamera()
    capture = LiveCapture(kernel)
    overrides = "camera.v4l2.format=GREY", *([f"camera.v4l2.focus={focus}"] if focus else [])
    kernel.has[FOCUS] = 120  # autofocus left it there
    camera = opened(capture, *overrides)
    before, calibrated = dict(kernel.has), camera.identity
    assert before[FOCUS] == (focus or 0)
    assert calibrated.endswith(f" focus {focus or 0}")
    device = ReopenedCamera(camera, lambda: opened(capture, *overrides), calibrated)
    assert isinstance(device.read(), Frame)
    device.close()
    kernel.plug(C920)  # with its own values
    assert kernel.has != before
    assert device.read() is None
    assert isinstance(device.read(), Frame)
    assert kernel.has == before


def test_another_focus_is_another_lens(opened: Opened) -> None:
    assert opened(Capture(), "camera.v4l2.focus=35").identity != opened(Capture()).identity
    assert " focus " not in opened(Capture(KernelCamera(CHEAP))).identity
    with pytest.raises(CameraError, match=r"camera\.v4l2\.focus 33 \(it has 35\)"):
        opened(Capture(), "camera.v4l2.focus=33")
    with pytest.raises(CameraError, match=r"camera\.v4l2\.focus 33 \(it has none\)"):
        opened(Capture(KernelCamera(CHEAP)), "camera.v4l2.focus=33")


def test_the_guide_has_each_control_of_the_table_and_no_other() -> None:
    guide = (PLATOON.parent / "cameras" / "V4L2.md").read_text()
    rows = [line for line in guide.partition("## Formats")[0].splitlines() if line.startswith("| `")]
    names = [name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])]
    assert sorted(names) == sorted(row.name for row in TABLE)


@pytest.mark.parametrize(("buffers", "step"), [(3, 1), (1, 2)])
def test_three_buffers_lose_no_image_and_one_loses_every_second(opened: Opened, buffers: int, step: int) -> None:
    capture = LiveCapture(**({"BUFFERSIZE": buffers} if buffers == 1 else {}))
    camera = opened(capture, "camera.v4l2.format=GREY")
    seen = [int(camera.read().image[0, 0]) for _ in range(20)]
    assert set(np.diff(seen)) == {step}


def test_a_reader_that_was_late_gets_old_images_with_their_own_stamps_and_soon_new_ones(opened: Opened) -> None:
    capture = LiveCapture()
    camera = opened(capture, "camera.v4l2.format=GREY", hwtimestamps="1")
    first = camera.read()
    capture.now_ms += 10 * PERIOD_MS
    for _ in range(8):
        frame = camera.read()
        later = int(frame.image[0, 0]) - int(first.image[0, 0])
        assert frame.exposure_ns - first.exposure_ns == pytest.approx(later * PERIOD_MS * MS, abs=2 * MS)
    assert later > 10
    newest_ms = capture.zero_ms + capture.begun_ms[int(frame.image[0, 0])] + PERIOD_MS  # when it was whole
    assert capture.zero_ms + capture.now_ms - newest_ms <= capture.busy_ms + 1e-6


def as_sent(name: str, image: NDArray[np.uint8]) -> NDArray[Any]:
    """Return an image of a grey scene before colours as OpenCV hands it out without conversion."""
    colour = np.full_like(image, 90)
    if name == "MJPG":
        quality = [cv2.IMWRITE_JPEG_QUALITY, 95]
        return np.asarray(cv2.imencode(".jpg", cv2.merge([image] * 3), quality)[1]).reshape(1, -1)
    sent: dict[str, NDArray[Any]] = {
        "GREY": image,
        "YUYV": np.dstack([image, colour]),
        "UYVY": np.dstack([colour, image]),
        "NV12": np.concatenate([image, colour[: len(image) // 2]]),
        "Y10": image.astype(np.uint16) << 2,
        "Y16": image.astype(np.uint16) << 8,
    }
    return sent[name]


@pytest.mark.parametrize("name", ["MJPG", "GREY", "YUYV", "UYVY", "NV12", "Y10", "Y16"])
def test_images_come_gray_and_whole(opened: Opened, name: str) -> None:
    capture = Capture()
    camera = opened(capture, f"camera.v4l2.format={name}")
    assert int(capture.has[cv2.CAP_PROP_FOURCC]).to_bytes(4, "little") == name.ljust(4).encode()
    data, broken = as_sent(name, scene()), []
    if name == "MJPG":
        broken = [data[:, : data.size // 3], np.zeros((1, 50), np.uint8), np.zeros((1, 0), np.uint8)]
    capture.images = [(entry, clocks()[1] - 100) for entry in broken]
    frame, stamped_ns = read(capture, camera, data)
    assert (frame.image.shape, frame.image.dtype) == (scene().shape, np.uint8)
    assert frame.image.flags.c_contiguous
    assert np.abs(frame.image.astype(int) - scene()).max() <= (3 if name == "MJPG" else 0)
    assert abs(frame.exposure_ns - stamped_ns) < 15 * MS, "its own stamp, not that of a broken one"


TO_STAMP_S = {"start": 0.0, "transfer": EXPOSURE_S, "end": EXPOSURE_S + READOUT_S}  # from the start of the exposure


@pytest.mark.parametrize("stamp", TO_STAMP_S)
@pytest.mark.parametrize("line_time_s", [0.0, 2e-5])
def test_mid_exposure_is_told_from_the_kernels_stamp(
    monkeypatch: pytest.MonkeyPatch, opened: Opened, stamp: str, line_time_s: float
) -> None:
    monkeypatch.setattr(
        "robofleet.core.clock._CLOCK", 0
    )  # CLOCK_REALTIME: far from the kernel's, as after a long sleep
    capture = Capture()
    overrides = [f"camera.v4l2.stamp={stamp}", f"camera.model.line_time_s={line_time_s:.6f}", "camera.v4l2.format=GREY"]
    frame, stamped_ns = read(capture, opened(capture, *overrides), scene())
    after_s = EXPOSURE_S / 2 + 719 * line_time_s / 2 - TO_STAMP_S[stamp]
    assert frame.exposure_ns - stamped_ns == pytest.approx(after_s * S, abs=1 * MS)


@pytest.mark.parametrize(
    ("driver", "flags", "parameters", "stamp"),
    [
        ("uvcvideo", START_OF_EXPOSURE, {"hwtimestamps": "0"}, "transfer"),
        ("uvcvideo", START_OF_EXPOSURE, {}, "transfer"),
        ("uvcvideo", START_OF_EXPOSURE, {"hwtimestamps": "1"}, "start"),
        ("other", START_OF_EXPOSURE, {}, "start"),
        ("other", END_OF_FRAME, {"hwtimestamps": "1"}, "end"),
    ],
)
def test_the_driver_tells_which_instant_it_stamps(
    opened: Opened, driver: str, flags: int, parameters: dict[str, str], stamp: str
) -> None:
    kernel = KernelCamera(driver=driver, stamps=flags)
    assert opened(Capture(kernel), **parameters).stamp == stamp
    assert opened(Capture(kernel), "camera.v4l2.stamp=end", **parameters).stamp == "end"


def test_an_image_has_the_old_exposure_if_it_began_before_the_change(
    monkeypatch: pytest.MonkeyPatch, opened: Opened
) -> None:
    monkeypatch.setattr("robofleet.core.clock._CLOCK", 0)
    for stamp in ("start", "end"):
        capture = Capture()
        camera, has = opened(capture, f"camera.v4l2.stamp={stamp}", "camera.v4l2.format=GREY"), capture.kernel.has
        assert read(capture, camera, scene())[0].exposure == Exposure(EXPOSURE_S, 0.0)
        camera.adjust(Exposure(0.0101, 40.0))
        assert (has[EXPOSURE], has[GAIN]) == (60, 0), "not in another thread"
        for age_ms, exposure_s in ((20.0, EXPOSURE_S), (-5.0, 0.0101 if stamp == "start" else EXPOSURE_S)):
            frame, stamped_ns = read(capture, camera, scene(), age_ms)
            assert (has[EXPOSURE], has[GAIN]) == (101, 40)
            assert frame.exposure is not None
            assert frame.exposure.time_s == pytest.approx(exposure_s)
            after_s = exposure_s / 2 if stamp == "start" else -READOUT_S - exposure_s / 2
            assert frame.exposure_ns - stamped_ns == pytest.approx(after_s * S, abs=1 * MS)


def test_what_the_device_made_of_a_change_is_told(opened: Opened) -> None:
    capture = Capture(KernelCamera(instead(C920, Knob(GAIN, "Gain", 0, 255, 0, step=50))))
    camera = opened(capture, "camera.v4l2.format=GREY", "camera.v4l2.stamp=start")
    camera.adjust(Exposure(0.3, 40.0))
    read(capture, camera, scene())
    assert read(capture, camera, scene(), -5.0)[0].exposure == Exposure(pytest.approx(0.2047), 50.0)


def test_limits_are_the_devices(opened: Opened) -> None:
    knobs = instead(C920, Knob(GAIN, "Gain", 0, 255, 0, step=5))
    limits = opened(Capture(KernelCamera(knobs))).exposure_limits()
    assert limits.shortest == Exposure(pytest.approx(0.0003), 0)
    assert limits.longest == Exposure(pytest.approx(0.2047), 255)
    assert limits.step == Exposure(pytest.approx(0.0001), 5)
    assert 255 * limits.gain_db == pytest.approx(24.0)
    limits = opened(Capture(KernelCamera(without(C920, GAIN))), "camera.v4l2.gain=null").exposure_limits()
    assert (limits.shortest.gain, limits.longest.gain) == (0, 0)


def test_a_control_that_is_disabled_is_none(opened: Opened) -> None:
    knobs = instead(C920, Knob(FOCUS, "Focus, Absolute", 0, 250, 0, flags=DISABLED))
    assert " focus " not in opened(Capture(KernelCamera(knobs))).identity


@pytest.mark.parametrize("age_s", [-1.0, 60.0, 1.7e9, -1.7e9])
@pytest.mark.parametrize("clock", ["CLOCK_MONOTONIC", "CLOCK_REALTIME"])
def test_stamps_of_another_clock_are_refused(opened: Opened, age_s: float, clock: str) -> None:
    capture = Capture()
    camera = opened(capture, "camera.v4l2.format=GREY", clock=clock)
    with pytest.raises(CameraError, match="stamps its images by another clock") as error:
        read(capture, camera, scene(), age_s * 1e3)
    assert ("echo CLOCK_MONOTONIC | sudo tee" in str(error.value)) == (clock == "CLOCK_REALTIME")


def test_a_stamp_that_jumps_later_is_left_to_the_watch(opened: Opened) -> None:
    capture = Capture()
    camera = opened(capture, "camera.v4l2.format=GREY")
    for age_s in (0.02, -5.0, 20.0, 0.02):
        frame, stamped_ns = read(capture, camera, scene(), age_s * 1e3)
        assert abs(frame.exposure_ns - stamped_ns) < 15 * MS


def test_a_device_that_gives_nothing_is_unplugged(opened: Opened) -> None:
    with pytest.raises(CameraError, match="video0 gives no image"):
        opened(Capture()).read()


def test_closing_lets_go_of_the_device(opened: Opened) -> None:
    capture = Capture()
    camera = opened(capture)
    camera.close()
    assert capture.released == 1


def test_a_device_that_is_not_there_is_refused_before_anything_starts_and_when_it_is_opened() -> None:
    complaints = dict(V4L2Camera.refusals(config("camera.trigger=tick", MEASURED)))
    assert set(complaints) == {"camera.v4l2.device", "camera.trigger"}
    assert NONE in complaints["camera.v4l2.device"]
    with pytest.raises(CameraError, match=f"{NONE} cannot be opened"):
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
