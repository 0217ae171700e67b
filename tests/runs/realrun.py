"""``robofleet run`` as an operator starts it: real processes, files for what it says, and a terminal if asked for."""

import fcntl
import json
import os
import pty
import signal
import subprocess
import sys
import termios
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import yaml
from click.testing import Result

from robofleet.core.clock import MS, S, WallClock
from tests.command import robofleet
from tests.shipped import PLATOON

GONE_WITHIN_S = 5.0  # a second, and what a busy machine takes
_STARTED_WITHIN_S = 150  # on a busy machine that has to compile every kernel first
_ENDED_WITHIN_S = 120  # the same; how long a stop takes is measured, not waited for
CLOCK = WallClock()


def of_robots(*ids: str) -> tuple[str, ...]:
    """Return the options of a run of the platoon's first robots only, without pixels: it starts sooner."""
    robots = yaml.safe_load(PLATOON.read_text())["robots"][: len(ids)]
    assert [robot["id"] for robot in robots] == list(ids)
    fewer = f"robots={json.dumps(robots)}", f"groups.0.robots={json.dumps(ids)}"
    return "--set", "tracker.source=truth", "--set", fewer[0], "--set", fewer[1]


ALONE = of_robots("r1")


def wait(condition: Callable[[], Any], within_s: float) -> bool:
    """Return as soon as the condition holds, or False after a while. Who looks leaves the machine to the others."""
    began_ns = CLOCK.now_ns()
    deadline_ns = began_ns + round(within_s * S)
    while not condition():
        now_ns = CLOCK.now_ns()
        if now_ns > deadline_ns:
            return False
        CLOCK.sleep_until(now_ns + max(10 * MS, 3 * (now_ns - began_ns)))
        began_ns = CLOCK.now_ns()
    return True


def own_folders(folder: Path) -> dict[str, str]:
    """Return an environment in which runs leave their files in a folder."""
    # short: a socket's path stands there
    names = {"XDG_RUNTIME_DIR": "rt", "XDG_STATE_HOME": "state", "TMPDIR": "tmp"}
    for name in names.values():
        (folder / name).mkdir(exist_ok=True)
    return os.environ | {variable: str(folder / name) for variable, name in names.items()}


def was_busy(output: str) -> bool:
    """Return whether a run said that its machine is busy: then it is held at times, and goes on by itself."""
    return "this machine is busy" in output


def newest(output: str) -> str:
    """Return the newest line of what a run said that tells where it is: it tells so again and again."""
    lines = (line for line in reversed(output.splitlines()) if line.startswith(("waiting", "armed", "running", "held")))
    return next(lines, "")


def fill(descriptor: int) -> None:
    """Write to a terminal or a pipe until it takes nothing more."""
    os.set_blocking(descriptor, False)
    with suppress(BlockingIOError):
        while True:
            os.write(descriptor, b"nobody reads this\n")
    os.set_blocking(descriptor, True)


def take_terminal() -> None:
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


def take_terminal_for_good() -> None:
    take_terminal()
    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does


class RealRun:
    """A run; with ``terminal`` it has one of its own, whose other end is ``keyboard``.

    What it says goes into two files, or to ``screen``: a descriptor, or "terminal"; "full terminal" takes nothing more.
    """

    def __init__(
        self, folder: Path, *arguments: str, terminal: bool = False, screen: int | str | None = None,
        nohup: bool = False, name: str = "run", config: Path = PLATOON,
    ) -> None:  # fmt: skip
        self.environment = own_folders(folder)
        self._stdout, self._stderr, self.folder = folder / f"{name}.stdout", folder / f"{name}.stderr", folder / name
        self.latches = folder / "state" / "robofleet" / "platoon"
        command = [sys.executable, "-W", "error", "-m", "robofleet", "run", str(config), "--out", str(self.folder)]
        self.keyboard, theirs = pty.openpty() if terminal else (None, subprocess.DEVNULL)
        if screen == "full terminal":
            fill(theirs)
        with self._stdout.open("wb") as out, self._stderr.open("wb") as err:
            output = theirs if isinstance(screen, str) else screen
            self.launcher = subprocess.Popen(
                [*command, *(["--json"] if screen is None else []), *arguments],
                stdin=theirs, stdout=output or out, stderr=output or err, env=self.environment,
                start_new_session=terminal,
                preexec_fn=(take_terminal_for_good if nohup else take_terminal) if terminal else None,  # noqa: PLW1509 - no thread holds a lock here
            )  # fmt: skip
        if terminal:
            os.close(theirs)

    def begin(self, *arguments: str) -> "subprocess.Popen[bytes]":
        """Begin to do something to the run from another terminal."""
        command = [sys.executable, "-W", "error", "-m", "robofleet", *arguments]
        return subprocess.Popen(command, env=self.environment, stdout=subprocess.DEVNULL)

    def asked(self, *arguments: str) -> Result:
        """Do something to the run from another terminal, by a command that runs in this process: it costs less."""
        return robofleet(*arguments, env=self.environment)

    def robofleet(self, *arguments: str) -> "subprocess.CompletedProcess[str]":
        """Do something to the run from another terminal."""
        command = [sys.executable, "-W", "error", "-m", "robofleet", *arguments]
        return subprocess.run(command, env=self.environment, capture_output=True, text=True, timeout=20, check=False)

    def press(self, keys: bytes) -> None:
        """Press keys in the run's terminal."""
        assert self.keyboard is not None
        os.write(self.keyboard, keys)

    def close_terminal(self) -> None:
        """Close the window of the run's terminal."""
        if self.keyboard is not None:
            os.close(self.keyboard)
            self.keyboard = None

    @property
    def said(self) -> str:
        return self._stderr.read_text()

    @property
    def summary(self) -> dict[str, Any]:
        """Return what was printed, which is what was written."""
        printed = json.loads(self._stdout.read_text())
        assert printed == json.loads((self.folder / "summary.json").read_text())
        return dict(printed)

    def latched(self) -> dict[str, int]:
        """Return what every robot's driver keeps of its latch for its next start."""
        return {file.stem: json.loads(file.read_text())["latch"] for file in sorted(self.latches.glob("*.json"))}

    @property
    def newest(self) -> str:
        """Where it is: the newest line that tells that."""
        return newest(self.said)

    def wait_until_running(self) -> None:
        self.wait_for(lambda: self.newest.startswith("running"))

    def wait_for(self, condition: Callable[[], Any]) -> None:
        """Wait for something to happen in a run that has not ended."""
        assert wait(lambda: condition() or self.launcher.poll() is not None, _STARTED_WITHIN_S), self.said
        assert self.launcher.poll() is None, self.said

    def ended(self, within_s: float = _ENDED_WITHIN_S) -> int:
        """Wait for a run's end, and return its exit code."""
        assert wait(lambda: self.launcher.poll() is not None, within_s), self.said
        return int(self.launcher.returncode)

    def children(self, *words: str) -> list[psutil.Process]:
        """Return the living processes of this run, found by their config's path; all of them or those with words."""
        found = []
        for process in psutil.process_iter(["cmdline", "status"]):
            line = process.info["cmdline"] or []
            mine = str(self.folder / "config.yaml") in line and process.info["status"] != psutil.STATUS_ZOMBIE
            if mine and all(word in line for word in words):
                found.append(process)
        return found

    def kill(self, *words: str) -> None:
        (process,) = self.children(*words)
        process.kill()

    def nothing_is_left(self) -> bool:
        return wait(lambda: not self.children(), GONE_WITHIN_S)

    def clean_up(self) -> None:
        """End whatever is left."""
        for process in (self.launcher, *self.children()):
            process.send_signal(signal.SIGCONT)
            process.kill()
        self.launcher.wait()
        self.close_terminal()
