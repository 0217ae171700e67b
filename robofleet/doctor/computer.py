"""The computer itself: cores and load, priorities, clock, display and network."""

import fcntl
import os
import socket
import struct
import threading
import webbrowser
from collections.abc import Iterator
from pathlib import Path

from robofleet.core.clock import clock_name, date_is_synchronised
from robofleet.doctor.findings import Finding, Mark, Paste, ok
from robofleet.doctor.needs import Needs
from robofleet.doctor.permission import user_name
from robofleet.nodes.node import HIGHEST_PRIORITY, NICE

_LIMITS = "/etc/security/limits.d/robofleet.conf"
_QUOTA = Path("/sys/fs/cgroup/cpu.max")
_SIOCGIFADDR = 0x8915
_REQUEST_BYTES = 256  # it begins with an interface's name
_DISPLAYS = "DISPLAY", "WAYLAND_DISPLAY"
_ELSEWHERE = (
    "open the page on another computer or a phone: `robofleet web --host ADDRESS`, with an address of `network`"
)


def cores(needs: Needs) -> Iterator[Finding]:
    """How many cores this process may use, and what the machine does already."""
    count, wanted = usable_cores(), max(2, len(needs.cameras))
    one_minute, five_minutes, _ = os.getloadavg()
    says = f"{count:g} cores, load {one_minute:.1f} (over five minutes {five_minutes:.1f})"
    if one_minute >= count:
        yield Finding("cores", Mark.WARN, f"{says}: this machine is busy", "end other programs, or ticks come late")
    elif count < wanted:
        why = "the tracker and the controller work" if wanted == 2 else "the trackers of all cameras work"
        yield Finding("cores", Mark.WARN, says, f"take {wanted} cores or more: {why} at once")
    else:
        yield ok("cores", says)


def usable_cores(quota: Path = _QUOTA) -> float:
    """Return how many cores this process may use: those that it may run on, or a container's share of them."""
    count = float(len(os.sched_getaffinity(0)))
    try:
        share, period = quota.read_text().split()
        return count if share == "max" else min(count, int(share) / int(period))
    except (OSError, ValueError):
        return count


def priorities(_needs: Needs) -> Iterator[Finding]:
    """Whether a process of this user may go before others; a thread of its own tries it, and ends."""
    refused: list[str] = []

    def attempt() -> None:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(HIGHEST_PRIORITY))
        except OSError as error:
            refused.append(f"no real-time priority {HIGHEST_PRIORITY} ({error.strerror})")
        try:
            os.setpriority(os.PRIO_PROCESS, 0, NICE)
        except OSError as error:
            refused.append(f"no nice {NICE} ({error.strerror})")

    thread = threading.Thread(target=attempt)
    thread.start()
    thread.join()
    if not refused:
        yield ok("priorities", f"real-time priority {HIGHEST_PRIORITY} and nice {NICE} are granted")
        return
    user = user_name()
    cure = "ticks may come late on a busy machine: paste the lines below, and log in again"
    pastes = Paste(_LIMITS, f"{user}  -  rtprio  {HIGHEST_PRIORITY}"), Paste(_LIMITS, f"{user}  -  nice    {NICE}")
    yield Finding("priorities", Mark.WARN, "; ".join(refused), cure, pastes)


def clock(_needs: Needs) -> Iterator[Finding]:
    """The clock of the ticks, and whether dates are right."""
    name, right = clock_name(), date_is_synchronised()
    if name != "CLOCK_BOOTTIME":
        cure = "do not let this machine sleep during a run: its clock then stands still"
        yield Finding("clock", Mark.WARN, f"ticks use {name}: there is no CLOCK_BOOTTIME", cure)
    elif right is False:
        cure = "`timedatectl set-ntp true`: this affects the dates in recordings, not the ticks"
        yield Finding("clock", Mark.WARN, f"ticks use {name}; the date is not synchronised", cure)
    else:
        yield ok("clock", f"ticks use {name}; the date is {'synchronised' if right else 'not checked'}")


def browser(needs: Needs) -> Iterator[Finding]:
    if not needs.whole_run:
        return
    if not any(os.environ.get(display) for display in _DISPLAYS):
        yield Finding("browser", Mark.WARN, f"there is no display ({' and '.join(_DISPLAYS)} are empty)", _ELSEWHERE)
        return
    try:
        found = webbrowser.get()
    except webbrowser.Error:
        yield Finding("browser", Mark.WARN, "no browser is installed", f"install one, or {_ELSEWHERE}")
    else:
        yield ok("browser", getattr(found, "name", type(found).__name__))


def network(_needs: Needs) -> Iterator[Finding]:
    found = [f"{address} ({name})" for name, address in addresses() if not address.startswith("127.")]
    if found:
        yield ok("network", f"{socket.gethostname()}: {', '.join(found)}; robofleet listens on this machine only")
    else:
        cure = "join a network, if a phone is to see the page"
        yield Finding("network", Mark.WARN, "this machine has no address", cure)


def addresses() -> list[tuple[str, str]]:
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        for _, name in socket.if_nameindex():
            request = struct.pack(f"{_REQUEST_BYTES}s", name.encode())
            try:
                answer = fcntl.ioctl(asking.fileno(), _SIOCGIFADDR, request)
            except OSError:
                continue  # it has none
            found.append((name, socket.inet_ntoa(answer[20:24])))
    return found
