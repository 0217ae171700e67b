"""What a camera of the kernel's says, through the ioctls of linux/videodev2.h, and what a configuration asks of it."""

import errno
import struct
from pathlib import Path

import pytest

from robofleet.config.load import load_config
from robofleet.doctor import cameras, v4l2_device
from robofleet.doctor.cameras import lacking, shown, usb_of
from robofleet.doctor.findings import Mark
from robofleet.doctor.needs import Needs
from robofleet.doctor.v4l2_device import DeviceReport, Mode

LAB = Path(__file__).parents[2] / "configs" / "lab.yaml"
MODES = (Mode("MJPG", 1280, 720, (60.0, 30.0)), Mode("MJPG", 640, 480, (30.0,)), Mode("YUYV", 1280, 720, (10.0,)))
CAPTURE, METADATA, DEVICE_CAPS = 0x1, 0x00800000, 0x80000000


class Webcam:
    """A driver in the kernel: fills the structs as their header lays them out."""

    def __init__(self, caps: int = CAPTURE, of_device: int = CAPTURE) -> None:
        self.caps, self.of_device = caps, of_device

    def __call__(self, _descriptor: int, request: int, buffer: bytearray) -> int:
        number, size = request & 0xFF, request >> 16 & 0x3FFF
        assert (request >> 8 & 0xFF, len(buffer)) == (ord("V"), size)
        index = struct.unpack_from("=I", buffer)[0]
        letters = list(dict.fromkeys(mode.format for mode in MODES))
        try:
            if number == 0:  # v4l2_capability
                struct.pack_into(
                    "=16s32s32sIII", buffer, 0, b"uvcvideo", b"Eye 3", b"usb-1", 0, self.caps, self.of_device
                )
            elif number == 2:  # v4l2_fmtdesc
                assert struct.unpack_from("=I", buffer, 4)[0] == 1
                struct.pack_into("=I32s4s", buffer, 8, 0, b"a format", letters[index].encode())
            elif number == 74:  # v4l2_frmsizeenum
                mode = [mode_row for mode_row in MODES if mode_row.format.encode() == buffer[4:8]][index]
                struct.pack_into("=III", buffer, 8, 1, mode.width, mode.height)
            elif number == 75:  # v4l2_frmivalenum
                _, letter, width, height = struct.unpack_from("=I4sII", buffer)
                mode = next(mode_row for mode_row in MODES if mode_row[:3] == (letter.decode(), width, height))
                struct.pack_into("=III", buffer, 16, 1, 1000, round(1000 * mode.rates_hz[index]))
        except IndexError:
            raise OSError(errno.EINVAL, "the list has ended") from None
        return 0


@pytest.fixture
def device(tmp_path: Path) -> str:
    (tmp_path / "video0").touch()
    return str(tmp_path / "video0")


def test_a_camera_says_its_formats_sizes_and_rates(device: str) -> None:
    assert v4l2_device.ask(device, Webcam()) == DeviceReport("Eye 3", MODES)
    assert shown(MODES) == "MJPG 1280x720 at 60/30 Hz, 640x480 at 30 Hz; YUYV 1280x720 at 10 Hz"


def test_a_second_node_of_a_camera_gives_no_images(device: str) -> None:
    assert v4l2_device.ask(device, Webcam(CAPTURE | METADATA | DEVICE_CAPS, METADATA)) is None


def test_what_is_no_camera_is_an_error_that_the_line_tells() -> None:
    with pytest.raises(OSError, match="Inappropriate ioctl"):
        v4l2_device.ask("/dev/null")


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        (["camera.v4l2.format=MJPG"], ""),
        (["camera.v4l2.format=GREY"], "it has no GREY"),
        (["camera.v4l2.format=MJPG", "camera.rate_hz=50"], "its MJPG has 1280x720 not at 50 Hz"),
    ],
)
def test_a_camera_is_held_to_what_the_configuration_asks(changes: list[str], says: str) -> None:
    camera = load_config(LAB, changes).camera
    assert lacking(camera, MODES) == says
    words = "it has no GREY" if "GREY" in changes[0] else "its MJPG has no 1280x720"
    assert lacking(camera, MODES[1:]).startswith(words)


def test_the_configurations_camera_must_be_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cameras, "_DEVICES", tmp_path)
    needs = Needs(load_config(LAB))
    (found,) = cameras.kernel_cameras(needs)
    assert (found.mark, found.says) == (Mark.MISSING, "/dev/video0 is not there, or is not a camera (there are: none)")
    assert list(cameras.kernel_cameras(Needs())) == []
    assert list(cameras.kernel_cameras(Needs(needs.config, ("r1",)))) == []  # a robot's computer tracks nothing


def test_a_rule_names_a_camera_by_its_number_else_by_its_socket(tmp_path: Path) -> None:
    plug = tmp_path / "devices" / "1-4"
    (plug / "1-4:1.0").mkdir(parents=True)
    (tmp_path / "video0").mkdir()
    (tmp_path / "video0" / "device").symlink_to(plug / "1-4:1.0")
    assert usb_of(Path("/dev/video0"), tmp_path) is None
    (plug / "idVendor").write_text("046d\n")
    (plug / "idProduct").write_text("082d\n")
    usb = usb_of(Path("/dev/video0"), tmp_path)
    assert usb is not None
    assert 'KERNELS=="1-4"' in cameras.udev.camera_rule(usb, "camera")
    (plug / "serial").write_text("9F2C\n")
    usb = usb_of(Path("/dev/video0"), tmp_path)
    assert usb is not None
    rule = cameras.udev.camera_rule(usb, "camera")
    assert 'ENV{ID_SERIAL_SHORT}=="9F2C"' in rule
    assert rule.endswith('SYMLINK+="robofleet/camera"')
