"""What a router says in its log of those who link to it from other hosts: who has come, and who was refused."""

import re
from collections.abc import Callable, Mapping
from typing import IO, Any

import zenoh

from robofleet.core.clock import S

_MOST_LINES, _MINUTE_NS = 20, 60 * S
_ANSI = re.compile(r"\x1b\[[0-9;]*m")
_WHERE = re.compile(r"^\S+\s+WARN\s+.*?(?P<room>zenoh\S*): (?P<words>.*?)(?: at /\S+)?$")
_DATAGRAMS = "rel=0"  # the other half of a link by QUIC

Say = Callable[[str], None]


class FewLines:
    """Writes at most a few lines a minute."""

    def __init__(self, say: Say, now_ns: Callable[[], int]) -> None:
        self._say, self._now_ns = say, now_ns
        self._left, self._until_ns, self._more = _MOST_LINES, 0, 0

    def __call__(self, line: str) -> None:
        """Write a line, or count it as left out."""
        self.turn()
        if self._left:
            self._left -= 1
            self._say(line)
        else:
            self._more += 1

    def turn(self) -> None:
        """Begin a new minute when one is over, with what was not said in the one before."""
        if self._now_ns() < self._until_ns:
            return
        if self._more:
            self._say(f"{self._more} more lines about links were left out")
        self._left, self._until_ns, self._more = _MOST_LINES, self._now_ns() + _MINUTE_NS, 0


def say_refused(lines: IO[str], say: FewLines) -> None:
    """Say which links Zenoh refuses, and why, as its own log tells it: without a certificate's name."""
    for line in lines:
        say.turn()
        found = _WHERE.match(_ANSI.sub("", line).strip())
        if found is not None and "zenoh_link" in found["room"]:
            say(f"a link was refused: {found['words'].partition('. Hint:')[0]}")


def say_linked(permitted: Mapping[str, Any], say: Say) -> Callable[[zenoh.LinkEvent], None]:
    """Return what says who has come and gone, by certificate; ``permitted``: see ``permissions.access_control``."""
    names = {
        common_name: (str(subject["id"]), subject.get("zids"))
        for subject in permitted["subjects"]
        for common_name in subject.get("cert_common_names", ())
    }

    def happened(event: zenoh.LinkEvent) -> None:
        link = event.link
        if link.auth_identifier is None or _DATAGRAMS in str(link.src):
            return
        name, sessions = names.get(link.auth_identifier, (None, None))
        if event.kind == zenoh.SampleKind.DELETE:
            say(f"{name or link.auth_identifier} has gone")
        elif name is None:
            say(f"{link.auth_identifier} is revoked, or unknown: from {link.dst}: it may say and hear nothing")
        elif sessions is not None and str(link.zid) not in sessions:
            say(f"a second host with the certificate of {name}, {link.dst}: it may say and hear nothing")
        else:
            say(f"{name} has come, from {link.dst}")

    return happened
