"""How busy this computer is, as Linux measures it."""

import os
from pathlib import Path

from robofleet.safety import busy
from robofleet.safety.view import Machine

_TICK_NS = 10_000_000  # of the kernel's own accounts: 100 a second on every architecture that Python runs on
_LARGEST = 4096  # [bytes] of what is read
_STEAL = 8  # column of the first line of /proc/stat: time that another virtual machine had


class MachineProbe:
    """Called with an instant, it returns how busy the computer is; None where its system does not say.

    Contention is what the kernel's pressure stall information counts, and what a hypervisor took. A kernel without
    that is asked how many processes are ready to run now: where they are more than the cores, the time since it was
    asked last counts.
    """

    def __init__(self) -> None:
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
        pressure, stolen = _read(self._pressure), _read(self._stat).split()[: _STEAL + 1]
        if pressure.startswith(b"some "):
            contended_ns = 1000 * int(pressure.split(b"\n")[0].rpartition(b"total=")[2])
        else:
            contended_ns = self._crowded(now_ns, int(load[3].split(b"/")[0]))
        contended_ns += _TICK_NS * int(stolen[_STEAL]) // self._cores if len(stolen) > _STEAL else 0
        return Machine(contended_ns, float(load[0]), self._cores)

    def _crowded(self, now_ns: int, ready: int) -> int:
        since_ns, self._looked_ns = self._looked_ns, now_ns
        if since_ns is not None and ready > self._cores:
            self._crowded_ns += now_ns - since_ns
        return self._crowded_ns

    def close(self) -> None:
        """Leave the files."""
        for file in (self._pressure, self._stat, self._load):
            if file is not None:
                os.close(file)


class Silence:
    """How long a process was not heard, and whether the computer's load explains it."""

    def __init__(self, now_ns: int) -> None:
        self._probe = MachineProbe()
        self.heard(now_ns)

    def heard(self, at_ns: int) -> None:
        """Take note of a word."""
        self._heard_ns, self._machine = at_ns, self._probe(at_ns)

    def lasts_ns(self, now_ns: int) -> int:
        """Return how long it lasts."""
        return now_ns - self._heard_ns

    def load(self, now_ns: int) -> str:
        """Return the load that explains it, in words; empty where it does not: for half of the time cores were free."""
        machine = self._probe(now_ns)
        if machine is None or self._machine is None:
            return ""
        contended_ns = machine.contended_ns - self._machine.contended_ns
        return busy.words((), machine.load, machine.cores, ()) if 2 * contended_ns >= self.lasts_ns(now_ns) else ""

    def close(self) -> None:
        """Leave the probe's files."""
        self._probe.close()


def _opened(path: str) -> int | None:
    try:
        return os.open(Path(path), os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return None


def _read(file: int | None) -> bytes:
    try:
        return b"" if file is None else os.pread(file, _LARGEST, 0)
    except OSError:
        return b""
