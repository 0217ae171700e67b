"""What a configuration's camera really does: its rate, what slows it down, its controls and stamps."""

from pathlib import Path
from typing import Any

import pytest

from robofleet.config.load import load_config
from robofleet.doctor import camera_rates
from robofleet.doctor.camera_rates import examined
from robofleet.doctor.findings import Finding, Mark
from robofleet.doctor.needs import Needs
from robofleet.tracking.cameras.v4l2 import V4L2Camera
from tests.tracking.cameras.kernel_camera import AUTOFOCUS, C920, KernelCamera, Knob, LiveCapture, instead

LAB = Path(__file__).parents[2] / "configs" / "lab.yaml"


@pytest.fixture
def plug(tmp_path: Path) -> Path:
    """Return what sysfs says of the camera's plug."""
    folder = tmp_path / "devices" / "1-4"
    (folder / "1-4:1.0").mkdir(parents=True)
    (folder / "power").mkdir()
    (tmp_path / "class" / "video0").mkdir(parents=True)
    (tmp_path / "class" / "video0" / "device").symlink_to(folder / "1-4:1.0")
    (folder / "speed").write_text("480\n")
    (folder / "power" / "control").write_text("on\n")
    (tmp_path / "video0").touch()
    return folder


def found(plug: Path, capture: LiveCapture, *overrides: str) -> dict[str, Finding]:
    """Return what is found of a camera, by the last word of its name."""
    device = plug.parents[1] / "video0"
    config = load_config(LAB, [f"camera.v4l2.device={device}", "camera.v4l2.format=GREY", *overrides])
    findings = examined(
        config, lambda context: V4L2Camera(context, capture, capture.kernel, plug), plug.parents[1] / "class"
    )
    return {finding.name.removeprefix(f"{device} "): finding for finding in findings}


def test_a_camera_that_keeps_its_rate_says_so_with_what_was_set(plug: Path) -> None:
    by_name = found(plug, LiveCapture(dark=True))
    assert [finding.mark for finding in by_name.values()] == [Mark.OK] * 3
    assert by_name["images"].says.startswith("30.0 a second")
    assert "focus_automatic_continuous 0" in by_name["controls"].says
    assert "33 ms if it keeps" in by_name["stamps"].says


@pytest.mark.parametrize(
    ("how", "override", "rate", "why", "cure"),
    [
        ({}, "camera.exposure_s=0.05", "20.0", "it exposes for 50.0 ms", "camera.exposure_s below 0.0333"),
        (
            {"dark": True}, "camera.v4l2.controls={exposure_dynamic_framerate: null}", "15.0",
            "exposure_dynamic_framerate is on", "-c exposure_dynamic_framerate=0",
        ),
        ({"BUFFERSIZE": 1}, "camera.v4l2.format=GREY", "15.0", "GREY of this size and rate is 28 MB/s", "MJPG"),
    ],
)  # fmt: skip
def test_what_slows_a_camera_down_is_named(
    plug: Path, how: dict[str, Any], override: str, rate: str, why: str, cure: str
) -> None:
    images = found(plug, LiveCapture(**how), override)["images"]
    assert images.mark is Mark.WARN
    assert images.says.startswith(f"{rate} a second")
    assert why in images.says
    assert cure in images.cure


@pytest.mark.parametrize(("power", "cure"), [("on", "`dmesg`"), ("auto", "echo on | sudo tee ")])
def test_what_no_control_explains_may_be_the_socket(plug: Path, power: str, cure: str) -> None:
    (plug / "speed").write_text("5000\n")
    (plug / "power" / "control").write_text(f"{power}\n")
    images = found(plug, LiveCapture(BUFFERSIZE=1))["images"]
    assert images.says.startswith("15.0 a second")
    assert "no control explains it" in images.says
    assert cure in images.cure


def test_a_camera_that_is_refused_is_missing_with_the_reason(plug: Path) -> None:
    knobs = instead(C920, Knob(AUTOFOCUS, "Focus, Auto", 0, 1, 1, kind=2, streams=1, insists=True))
    (finding,) = found(plug, LiveCapture(KernelCamera(knobs))).values()
    assert finding.mark is Mark.MISSING
    assert "take a camera whose focus is fixed" in finding.says


@pytest.mark.parametrize(
    ("nodrop", "pixels", "warned"), [("1", "GREY", True), ("0", "GREY", False), ("1", "MJPG", False)]
)
def test_images_that_uvcvideo_patches_are_warned_of(tmp_path: Path, nodrop: str, pixels: str, warned: bool) -> None:
    (tmp_path / "nodrop").write_text(f"{nodrop}\n")
    settings = load_config(LAB, [f"camera.v4l2.format={pixels}"]).camera
    findings = list(camera_rates.stamps(settings, "start", "uvcvideo", tmp_path))
    assert any(finding.pastes for finding in findings) == warned
    assert not any(finding.pastes for finding in camera_rates.stamps(settings, "start", "other", tmp_path))


def test_only_cameras_of_the_kernel_that_are_there_are_measured() -> None:
    assert camera_rates.camera_rates(Needs()) == []
    assert camera_rates.camera_rates(Needs(load_config(LAB))) == []
    (found,) = camera_rates.camera_rates(Needs(load_config(LAB, ["camera.v4l2.device=/dev/null"])))
    assert (found.name, found.mark) == ("/dev/null images", Mark.MISSING)
