"""The processes of a run: started, waited for, watched, and ended, so that nothing is left of them."""

import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from robofleet.core.clock import Clock, S
from robofleet.core.compiling import Progress, decoded
from robofleet.core.errors import RobofleetError

_READY_WITHIN_S = 120.0  # of a busy machine; the operator may end it at any time
_EXIT_WITHIN_S = 1.2
_RECORDED_WITHIN_S = 6.0  # the recorder writes what is left, and its file's index
_POLL_S = 0.05
_LAST_LINES = 5
_EMPTY_HANDED = "recorder", "supervisor", "controller", "tracker"  # before they are ready
_LONGEST_LINE_BYTES = 256  # of a child that is ready
_CRASHES = {signal.SIGSEGV, signal.SIGBUS, signal.SIGFPE, signal.SIGILL, signal.SIGABRT}  # the log says where
_CHILD_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}


def ended_by(code: int) -> str:
    """Return how a process ended that left this exit code: a signal has its name."""
    if code >= 0:
        return f"ended with exit code {code}"
    names = {number.value: number.name for number in signal.Signals}
    return f"was killed by {names.get(-code, f'signal {-code}')}"


class RunError(RobofleetError):
    """Raised where a run ends by a fault. The message is its cause."""


@dataclass
class Child:
    """One process, and this end of its lifeline."""

    name: str
    arguments: tuple[str, ...]
    process: "subprocess.Popen[bytes]"
    lifeline: socket.socket
    log: Path
    ready: bool = False
    progress: Progress | None = None  # of what it compiles before it is ready
    partial_line: str = ""  # the beginning of a line
    killed: bool = False  # by a fault that was asked for

    @property
    def died(self) -> bool:
        return self.process.poll() is not None

    def hear(self, word: bytes) -> None:
        """Take what it said before it is ready, or that it is."""
        *lines, self.partial_line = (self.partial_line + word.decode()).split("\n")
        for line in lines:
            if (progress := decoded(line)) is None:
                self.ready = True
            else:
                self.progress = progress

    def last_lines(self) -> str:
        lines = self.log.read_text(errors="replace").strip().splitlines()[-_LAST_LINES:]
        return "".join(f"\n    {line}" for line in lines)


@dataclass
class Children:
    """The processes of a run, in the order of their start."""

    folder: Path
    config_file: Path
    children: list[Child] = field(default_factory=list)

    def start(self, name: str, *arguments: str) -> Child:
        """Start ``robofleet ARGUMENTS CONFIG`` as a new interpreter."""
        child = self.started(name, arguments)
        self.children.append(child)
        return child

    def started(self, name: str, arguments: tuple[str, ...]) -> Child:
        """Start a process beside the run: the caller ends it, and the run does not wait for it."""
        ours, theirs = socket.socketpair()
        log = self.folder / f"{name}.log"
        with theirs, log.open("ab") as output:
            command = [sys.executable, "-P", "-m", "robofleet", *arguments, str(self.config_file)]
            process = subprocess.Popen(
                [*command, "--lifeline", str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
                env=os.environ | _CHILD_ENVIRONMENT,
            )
        return Child(name, arguments, process, ours, log)

    def signal(self, name: str, number: signal.Signals) -> None:
        self._named(name).process.send_signal(number)

    def kill(self, name: str) -> None:
        """Kill a child: it is not missed."""
        child = self._named(name)
        child.killed = True
        child.process.kill()
        child.process.wait()

    def start_again(self, name: str) -> None:
        child = self._named(name)
        child.lifeline.close()
        self.children[self.children.index(child)] = self.started(name, child.arguments)

    def _named(self, name: str) -> Child:
        return next(child for child in self.children if child.name == name)

    def wait_ready(self, clock: Clock, meanwhile: Callable[[], None]) -> None:
        """Return when every child has said that it is ready; ``meanwhile`` is called again and again, and may raise.

        Whoever tells of its progress is given more time.
        """
        deadline_ns = clock.now_ns() + round(_READY_WITHIN_S * S)
        while waiting := [child for child in self.children if not child.ready]:
            self.check()
            meanwhile()
            if clock.now_ns() > deadline_ns:
                names = ", ".join(child.name for child in waiting)
                raise RunError(f"{names}: not ready after {_READY_WITHIN_S:.0f} s: see {waiting[0].log}")
            readable, _, _ = select.select([child.lifeline for child in waiting], [], [], _POLL_S)
            for child in waiting:
                if child.lifeline in readable and (word := child.lifeline.recv(_LONGEST_LINE_BYTES)):
                    child.hear(word)
                    if child.progress is not None:
                        deadline_ns = clock.now_ns() + round(_READY_WITHIN_S * S)

    def check(self, spare: Collection[str] = ()) -> None:
        """Raise RunError with its name and last lines if a child has died.

        ``spare``: children of which some may die, as long as one lives.
        """
        for child in self.children:
            code = child.process.poll()
            if code is not None and not child.killed:
                if child.name in spare and any(
                    spare_child.name in spare and not spare_child.died for spare_child in self.children
                ):
                    child.killed = True
                    continue
                cause = f"the {child.name} {ended_by(code)}"
                if code < 0:
                    raise RunError(f"{cause}: see {child.log}" if -code in _CRASHES else cause)
                raise RunError(f"{cause}: see {child.log}{child.last_lines()}")

    def reap(self, clock: Clock, *, but: int = 0, last_word: bytes = b"") -> None:
        """End every child but the first ones, each with a last word; kill what does not answer. Idempotent."""
        group = self.children[but:]
        for child in group:
            if not child.ready and child.name.startswith(_EMPTY_HANDED):  # nothing to end well; compilers do not hear
                child.process.kill()
            with suppress(OSError):  # it is gone already
                child.lifeline.sendall(last_word)
            child.lifeline.close()
        began_ns = clock.now_ns()
        for child in group:
            within_s = _RECORDED_WITHIN_S if child.name == "recorder" else _EXIT_WITHIN_S
            try:
                child.process.wait(max(0.0, within_s - (clock.now_ns() - began_ns) / S))
            except subprocess.TimeoutExpired:
                child.process.kill()
                child.process.wait()
        del self.children[but:]
