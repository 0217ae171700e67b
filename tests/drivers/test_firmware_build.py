"""``make`` in drivers/firmware says in one line why it does not build or flash."""

import shutil
import subprocess
from pathlib import Path

import pytest

from robofleet.simulation.firmware_library import SOURCES


def refusal(target: str, folder: Path, *arguments: str, path: str | None = None) -> str:
    """Return the line that says why ``make`` refuses; ``path`` is where it looks for programs."""
    command = [shutil.which("make") or pytest.skip("NO MAKE: install Debian's make"), "-sC", str(SOURCES), target]
    command += [f"BUILD={folder}", *arguments]
    environment = None if path is None else {"PATH": path}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 2
    return next(line for line in done.stderr.splitlines() if "error" in line or "***" in line)


@pytest.mark.parametrize(
    ("board", "value", "why"),
    [
        ("uno", "WHEEL_RADUIS_M=0.03", "RFP: -DRFP_WHEEL_RADUIS_M=0.03: config.h has no such value"),
        ("uno", "COUNTS_PER_TURN=0", "RFP_COUNTS_PER_TURN: 20 to 200000"),
        ("pico", "WHEEL_RADIUS_M=32.5", "RFP_WHEEL_RADIUS_M: 0.001 to 1, in metres"),
        ("pico", "WHEEL_RADIUS_M=-0.03", "RFP_WHEEL_RADIUS_M: 0.001 to 1, in metres"),
        ("pico", "BAUD=9600", "RFP_BAUD: at least 57600"),
        ("uno", "BAUD=460800", "RFP_BAUD: this board cannot make it within 2.5 %"),
        ("uno", "BAUD=4000000", "RFP_BAUD: this board cannot make it within 2.5 %"),
        ("teensy", "BAUD=1000000", "RFP_BAUD: this board cannot make it within 2.5 %"),
    ],
)
def test_a_value_that_no_robot_has_is_refused(board: str, value: str, why: str, tmp_path: Path) -> None:
    compiler = "avr-gcc" if board == "uno" else "arm-none-eabi-gcc"
    if shutil.which(compiler) is None:
        pytest.skip(f"NO {compiler}: install Debian's gcc-{compiler.removesuffix('-gcc')}")
    assert why in refusal(board, tmp_path, f"RFP=-DRFP_{value}")


@pytest.mark.parametrize(
    ("target", "why"),
    [
        ("uno", "avr-gcc is missing: sudo apt install gcc-avr avr-libc"),
        ("pico", "arm-none-eabi-gcc is missing: sudo apt install gcc-arm-none-eabi"),
        ("flash-mega", "avrdude is missing: sudo apt install avrdude"),
        ("flash-pico", "to the drive RPI-RP2 instead"),
        ("flash-teensy", "teensy_loader_cli is missing: sudo apt install teensy-loader-cli"),
    ],
)
def test_a_program_that_is_missing_is_named_with_what_brings_it(target: str, why: str, tmp_path: Path) -> None:
    assert why in refusal(target, tmp_path, path=str(tmp_path))


def test_what_was_not_built_is_not_flashed_nor_to_what_is_no_port(tmp_path: Path) -> None:
    if shutil.which("avrdude") is None:
        pytest.skip("NO AVRDUDE: install Debian's avrdude")
    assert "uno.hex is missing: make uno first" in refusal("flash-uno", tmp_path)
    (tmp_path / "uno.hex").touch()
    assert "PORT=/dev/none: no port" in refusal("flash-uno", tmp_path, "PORT=/dev/none")
