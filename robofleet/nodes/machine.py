"""How busy this computer is, as Linux measures it."""

import os
from collections.abc import Sequence
from pathlib import Path

from robofleet.core.clock import S
from robofleet.safety import busy
from robofleet.safety.busy import CONTROLLER, DRIVERS, TRACKER
from robofleet.safety.view import Machine, Turns

_KERNEL_TICK_NS = 10_000_000  # of the kernel's own accounts: 100 a second on every architecture that Python runs on
_LARGEST_READ_BYTES = 4096
_LONGEST_COMMAND_BYTES = 1 << 16  # a driver's names all its robots
_SEARCH_PERIOD_NS = S  # for processes that are not known: one that was started again, or runs elsewhere
_STEAL_COLUMN = 8  # of the first line of /proc/stat: time that another virtual machine had


class MachineProbe:
    """Called with an instant, it returns how busy the computer is; None where its system does not say.

    Contention is what the kernel's pressure stall information counts, and what a hypervisor took. A kernel without
    that is asked how many processes are ready to run now: where they are more than the cores, the time since it was
    asked last counts.
    """

    def __init__(self, robots: Sequence[str] = ()) -> None:
        """``robots``: of whose drivers, and of whose controller and tracker, the turns are counted."""
        self._siblings = Siblings(robots) if robots else None
        self._pressure, self._stat, self._load = (
            _opened(f"/proc/{name}") for name in ("pressure/cpu", "stat", "loadavg")
        )
        self._cores = len(os.sched_getaffinity(0))
        self._looked_ns: int | None = None
        self._crowded_ns = 0

    def __call__(self, now_ns: int) -> Machine | None:
        """Read it anew; three short files, 20 us."""
        load = _read(self._load).split()
        if len(load) < 4:
            return None
        pressure, stolen = _read(self._pressure), _read(self._stat).split()[: _STEAL_COLUMN + 1]
        if pressure.startswith(b"some "):
            contended_ns = 1000 * int(pressure.split(b"\n")[0].rpartition(b"total=")[2])
        else:
            contended_ns = self._crowded(now_ns, int(load[3].split(b"/")[0]))
        if len(stolen) > _STEAL_COLUMN:
            contended_ns += _KERNEL_TICK_NS * int(stolen[_STEAL_COLUMN]) // self._cores
        turns = () if self._siblings is None else self._siblings(now_ns)
        return Machine(contended_ns, float(load[0]), self._cores, turns)

    def _crowded(self, now_ns: int, ready: int) -> int:
        since_ns, self._looked_ns = self._looked_ns, now_ns
        if since_ns is not None and ready > self._cores:
            self._crowded_ns += now_ns - since_ns
        return self._crowded_ns

    def close(self) -> None:
        for file in (self._pressure, self._stat, self._load):
            if file is not None:
                os.close(file)
        if self._siblings is not None:
            self._siblings.close()


class Siblings:
    """Called with an instant, it returns the turns of the processes that this one's parent started, as safety.busy
    numbers them: of each its main thread's, in which it steps.

    None where a process is not there, runs on another computer, or its system does not count.
    """

    def __init__(self, robots: Sequence[str]) -> None:
        self._drivers = {robot: DRIVERS + row for row, robot in enumerate(robots)}
        self._rows = DRIVERS + len(robots)
        self._files: dict[int, tuple[int, list[int]]] = {}  # by process id: its account, and its rows
        self._searched_ns: int | None = None

    def __call__(self, now_ns: int) -> tuple[Turns | None, ...]:
        """Read their accounts, a short file each."""
        found: list[Turns | None] = [None] * self._rows
        for pid, (file, rows) in list(self._files.items()):
            turns = _turns(file)
            if turns is None:
                os.close(self._files.pop(pid)[0])
            for row in rows:
                found[row] = turns
        missing = any(turns is None for turns in found[CONTROLLER:])
        if missing and (self._searched_ns is None or now_ns - self._searched_ns >= _SEARCH_PERIOD_NS):
            self._searched_ns = now_ns
            self._search()
        return tuple(found)

    def _search(self) -> None:
        parent = Path("/proc") / str(os.getppid()) / "task"
        try:
            children = [pid for of_thread in parent.glob("*/children") for pid in of_thread.read_text().split()]
        except OSError:
            return
        for pid in map(int, children):
            rows = [] if pid in self._files else self._rows_of(pid)
            if rows and (file := _opened(f"/proc/{pid}/schedstat")) is not None:
                self._files[pid] = file, rows

    def _rows_of(self, pid: int) -> list[int]:
        """Return which rows a process is; none where it is another one, or one of several trackers."""
        file = _opened(f"/proc/{pid}/cmdline")
        words = _read(file, _LONGEST_COMMAND_BYTES).decode(errors="replace").split("\0")
        if file is not None:
            os.close(file)
        command = words[words.index("node") + 1 :] if "node" in words else []
        if command[:1] == ["driver"] and "--robots" in command[:-1]:
            robots = command[command.index("--robots") + 1].split(",")
            return [self._drivers[robot] for robot in robots if robot in self._drivers]
        if command[:1] == ["tracker"] and "--camera" not in command:
            return [TRACKER]
        return [CONTROLLER] if command[:1] == ["controller"] else []

    def close(self) -> None:
        for file, _ in self._files.values():
            os.close(file)
        self._files.clear()


class Silence:
    """How long a process was not heard, and whether the computer's load explains it."""

    def __init__(self, now_ns: int) -> None:
        self._probe = MachineProbe()
        self._account: int | None = None
        self.heard(now_ns)

    def of(self, pid: int) -> None:
        self._account = _opened(f"/proc/{pid}/schedstat")

    def heard(self, at_ns: int) -> None:
        self._heard_ns, self._machine, self._turns = at_ns, self._probe(at_ns), _turns(self._account)

    def lasts_ns(self, now_ns: int) -> int:
        return now_ns - self._heard_ns

    def load(self, now_ns: int) -> str:
        """Return the load that explains it, in words; empty where it does not: for half of the time cores were free,
        or the process did not even try."""
        machine = self._probe(now_ns)
        if machine is None or self._machine is None:
            return ""
        contended_ns, lasts_ns = machine.contended_ns - self._machine.contended_ns, self.lasts_ns(now_ns)
        explained = 2 * contended_ns >= lasts_ns and busy.tries(self._turns, _turns(self._account), lasts_ns)
        return busy.words((), machine.load, machine.cores, ()) if explained else ""

    def close(self) -> None:
        self._probe.close()
        if self._account is not None:
            os.close(self._account)


def _opened(path: str) -> int | None:
    try:
        return os.open(Path(path), os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return None


def _turns(account: int | None) -> Turns | None:
    """Return what a process's account says; None where it ended, or its system counts nothing."""
    _, *counted = _read(account).split()[:3] or (b"",)
    return Turns(*map(int, counted)) if len(counted) == 2 and counted[1] != b"0" else None


def _read(file: int | None, most: int = _LARGEST_READ_BYTES) -> bytes:
    try:
        return b"" if file is None else os.pread(file, most, 0)
    except OSError:
        return b""
