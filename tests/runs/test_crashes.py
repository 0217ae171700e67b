"""A process that a library ends by a signal: the signal is named, and the line of Python that was at work."""

import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from robofleet.doctor.elsewhere import NoAnswerError, run_apart
from robofleet.runs.children import Child, Children, RunError

SWIRL = Path(__file__).parents[2] / "configs" / "swirl.yaml"
CRASHES = """\
import os
from robofleet.drivers.simulated import SimulatedRobot

class Robot(SimulatedRobot):
    def __init__(self, *_):
        os.kill(os.getpid(), 11)
"""


@pytest.mark.slow
def test_a_driver_that_crashes_the_check_is_named_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "crash_lab.py").write_text(CRASHES)
    crashing = SWIRL.read_text().replace("mylab:Swirl", "script").replace("    settings: {radius_m: 0.5}\n", "")
    crashing = crashing.replace("vehicle: gternal", 'vehicle: gternal, driver: "crash_lab:Robot"')
    (tmp_path / "lab.yaml").write_text(crashing)
    command = [sys.executable, "-m", "robofleet", "check", str(tmp_path / "lab.yaml"), "--set", "tracker.source=truth"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 2, done.stderr
    assert done.stderr.endswith("robots.0.driver: the process that opened it was killed by SIGSEGV: mend its driver\n")
    assert "Segmentation fault" in done.stderr
    assert f'"{tmp_path}/crash_lab.py", line 6 in __init__' in done.stderr


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (signal.SIGSEGV, "was killed by SIGSEGV: see {log}"),
        (signal.SIGKILL, "was killed by SIGKILL"),
        (signal.SIGRTMIN + 1, "was killed by signal 35"),
    ],
)
def test_a_child_that_dies_by_a_signal_is_named(number: int, words: str, tmp_path: Path) -> None:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        process = subprocess.Popen([sys.executable, "-c", f"import os; os.kill(os.getpid(), {int(number)})"])
        process.wait()
        child = Child("driver", (), process, ours, tmp_path / "driver.log")
        with pytest.raises(RunError) as raised:
            Children(tmp_path, tmp_path / "config.yaml", [child]).check()
    assert str(raised.value) == f"the driver {words.format(log=child.log)}"


def test_a_library_that_the_doctor_asks_and_that_crashes_is_named() -> None:
    with pytest.raises(NoAnswerError, match=r"^it was killed by SIGSEGV$"):
        run_apart("import os; os.kill(os.getpid(), 11)")
