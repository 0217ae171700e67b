"""Every check, at once, each with a deadline: a device that hangs costs its own line and nothing else."""

import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence

from robofleet.core.clock import Clock, S, WallClock
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
    clock = WallClock()
    looks = [_Look(name, check, needs) for name, check in checks.items()]
    _finish(looks, min(_REPORTED_AFTER_S, at_most_s), clock)
    if slow := [look.title for look in looks if look.is_alive()]:
        print(f"waiting for {', '.join(slow)}", file=sys.stderr)
    _finish(looks, at_most_s - _REPORTED_AFTER_S, clock)
    return [finding for look in looks for finding in look.found(at_most_s)]


def _finish(looks: Sequence["_Look"], within_s: float, clock: Clock) -> None:
    deadline_ns = clock.now_ns() + round(within_s * S)
    for look in looks:
        look.join(max(0.0, (deadline_ns - clock.now_ns()) / S))


class _Look(threading.Thread):
    """One check that is being made."""

    def __init__(self, name: str, check: Check, needs: Needs) -> None:
        super().__init__(daemon=True)
        self.title, self._check, self._needs = name, check, needs
        self._found: list[Finding] = []
        self.start()

    def run(self) -> None:
        """Keep what is found, up to where the check fails."""
        try:
            self._found.extend(self._check(self._needs))
        except Exception as error:  # noqa: BLE001 - one thing that cannot be looked at hides no other
            says = f"this could not be looked at: {type(error).__name__}: {error}"
            self._found.append(Finding(self.title, Mark.WARN, says, "look at it yourself, and report this"))

    def found(self, at_most_s: float) -> list[Finding]:
        """Return the findings; where it still goes on, what there is so far, and that it hangs."""
        if not self.is_alive():
            return self._found
        says = f"this gave no answer within {at_most_s:g} s"
        return [*self._found, Finding(self.title, Mark.WARN, says, "a device hangs: unplug it and plug it in again")]
