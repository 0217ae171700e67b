"""What a camera of the kernel's says, through the ioctls of linux/videodev2.h, and what a configuration asks of it."""

from contextlib import closing
from pathlib import Path

import pytest

from robofleet.config.load import load_config
from robofleet.doctor import cameras
from robofleet.doctor.cameras import lacking, shown, usb_of
from robofleet.doctor.findings import Mark
from robofleet.doctor.needs import Needs
from robofleet.tracking.cameras.v4l2_device import Device
from tests.tracking.cameras.kernel_camera import CAPTURE, DEVICE_CAPS, METADATA, MODES, KernelCamera

LAB = Path(__file__).parents[2] / "configs" / "lab.yaml"


@pytest.fixture
def device(tmp_path: Path) -> str:
    (tmp_path / "video0").touch()
    return str(tmp_path / "video0")


def test_a_camera_says_its_formats_sizes_and_rates(device: str) -> None:
    with closing(Device(device, KernelCamera())) as camera:
        assert (camera.driver, camera.name, camera.modes()) == ("uvcvideo", "Eye 3", MODES)
    assert shown(MODES) == "MJPG 1280x720 at 60/30 Hz, 640x480 at 30 Hz; YUYV 1280x720 at 10 Hz"


def test_a_second_node_of_a_camera_gives_no_images(device: str) -> None:
    kernel = KernelCamera(caps=CAPTURE | METADATA | DEVICE_CAPS, of_device=METADATA)
    with closing(Device(device, kernel)) as node:
        assert not node.gives_images


def test_what_is_no_camera_is_an_error_that_the_line_tells() -> None:
    with pytest.raises(OSError, match="Inappropriate ioctl"):
        Device("/dev/null")


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
