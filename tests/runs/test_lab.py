"""``configs/lab.yaml``: what a newcomer is told step by step, and that it runs without hardware."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from robofleet.config.load import ConfigError, ConfigFile
from robofleet.runs.check import load_checked
from tests.command import robofleet
from tests.runs.realrun import RealRun

LAB = Path(__file__).parents[2] / "configs" / "lab.yaml"
WITHOUT_HARDWARE = (
    "camera.source=simulated", "robots.0.twin=gternal", "robots.1.twin=arduino_bridge", "robots.2.twin=create2",
    "run.start=auto", "run.attended=false",
)  # fmt: skip


def told(*overrides: str) -> list[str]:
    """Return what ``robofleet check`` says, less the file's name."""
    try:
        load_checked(LAB, overrides)
    except ConfigError as refused:
        return [line.removeprefix(f"{LAB}:") for line in refused.faults]
    return []


def test_where_there_is_nothing_yet_each_line_says_what_to_do_next_in_the_files_order() -> None:
    nowhere = "camera.v4l2.device=/dev/video-none"
    *lines, device = told(nowhere)
    places = [re.match(r"(\d+):\d+: (\S+): ", line) for line in lines]
    assert [match and match[2] for match in places] == [
        "camera.source", *(f"robots.{i}.settings.port" for i in range(3)),
    ]  # fmt: skip
    numbers = [int(match[1]) for match in places if match]
    assert numbers == sorted(numbers)
    assert "robofleet calibrate intrinsics" in lines[0]
    for line, port in zip(lines[1:], ("r1", "r2", "r3"), strict=True):
        assert f"/dev/robofleet/{port}: there is no such port: plug the robot in" in line
    assert "there is no camera /dev/video-none" in device


def test_the_command_exits_with_2() -> None:
    found = robofleet("check", LAB, "--set", "camera.v4l2.device=/dev/video-none")
    assert found.exit_code == 2
    assert len(found.stderr.splitlines()) == 5
    assert not found.stdout


def test_it_can_be_tried_without_hardware() -> None:
    assert told(*WITHOUT_HARDWARE) == []


def test_its_calibrations_are_one_comment_sign_away(tmp_path: Path) -> None:
    """What is commented out is no prose: it is read when the sign is taken away."""
    text = re.sub(
        r"^( *)# (model: ceiling|calibration: r\d|floor_tags:|  - \{tag: 500.*)", r"\1\2", LAB.read_text(), flags=re.M
    )
    text = text.replace("  model: overhead  #", "  #")
    (tmp_path / "lab.yaml").write_text(text)
    with pytest.raises(ConfigError) as refused:
        ConfigFile(tmp_path / "lab.yaml")
    missing = [re.search(r": (\S+): there is no file \S+/(\w+/\w+\.yaml)", line) for line in refused.value.faults]
    assert [found and found.groups() for found in missing] == [
        ("camera.model", "cameras/ceiling.yaml"),
        *((f"robots.{i}.calibration", f"robots/r{i + 1}.yaml") for i in range(3)),
    ]


@pytest.mark.long
def test_it_runs_without_hardware(real_run: Callable[..., RealRun]) -> None:
    changes = [word for change in WITHOUT_HARDWARE for word in ("--set", change)]
    run = real_run(*changes, "--duration", "5", config=LAB)
    assert run.ended() == 0, run.said
    assert run.summary["outcome"] == "completed"
