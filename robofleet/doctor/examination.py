"""Every check, at once, each with a deadline: a device that hangs costs its own line and nothing else."""

import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

from robofleet.core.clock import S, WallClock
from robofleet.doctor import cameras, computer, places, serial_ports, software
from robofleet.doctor.findings import Finding, Mark
from robofleet.doctor.needs import Needs

Check = Callable[[Needs], Iterator[Finding]]

CHECKS: dict[str, Check] = {  # in the order in which they are said
    "Python": software.python,
    "packages": software.packages,
    "kernels": software.kernels,
    "drivers": software.drivers,
    "cores": computer.cores,
    "priorities": computer.priorities,
    "clock": computer.clock,
    "disk": places.disk,
    "state folder": places.state,
    "bus": places.bus,
    "arena": places.arena,
    "serial ports": serial_ports.serial_ports,
    "cameras": cameras.kernel_cameras,
    "Basler cameras": cameras.basler_cameras,
    "browser": computer.browser,
    "network": computer.network,
}
_REPORTED_AFTER_S, _AT_MOST_S = 3.0, 25.0


def examine(needs: Needs, checks: Mapping[str, Check] = CHECKS, at_most_s: float = _AT_MOST_S) -> list[Finding]:
    """Return what all checks find, in their order."""
    hangs = f"this gave no answer within {at_most_s:g} s", "a device hangs: unplug it and plug it in again"
    looks = [Look(partial(check, needs), Finding(name, Mark.WARN, *hangs)) for name, check in checks.items()]
    return finished(looks, at_most_s)


def finished(looks: Sequence["Look"], at_most_s: float) -> list[Finding]:
    """Return what checks found within a time; of one that still goes on what there is so far, and that it hangs."""
    clock = WallClock()
    began_ns = clock.now_ns()
    for within_s in (min(_REPORTED_AFTER_S, at_most_s), at_most_s):
        if within_s > _REPORTED_AFTER_S and (slow := [look.hangs.name for look in looks if look.is_alive()]):
            print(f"waiting for {', '.join(slow)}", file=sys.stderr)
        for look in looks:
            look.join(max(0.0, within_s - (clock.now_ns() - began_ns) / S))
    findings: list[Finding] = []
    for look in looks:
        late = [look.hangs] if look.is_alive() else []  # before what it found is read: it may end meanwhile
        findings += [*look.found, *late]
    return findings


class Look(threading.Thread):
    """One check that is being made, in a thread of its own."""

    def __init__(self, check: Callable[[], Iterator[Finding]], hangs: Finding) -> None:
        """``hangs``: what there is to say of it if it does not end."""
        super().__init__(daemon=True)
        self._check, self.hangs = check, hangs
        self.found: list[Finding] = []
        self.start()

    def run(self) -> None:
        """Keep what is found, up to where the check fails."""
        try:
            self.found.extend(self._check())
        except Exception as error:  # noqa: BLE001 - one thing that cannot be looked at hides no other
            says = f"this could not be looked at: {type(error).__name__}: {error}"
            self.found.append(Finding(self.hangs.name, Mark.WARN, says, "look at it yourself, and report this"))
