"""Where viewers find a run: HOST:PORT, and the certificate that an address beyond this computer needs."""

import os
import re
import socket
from pathlib import Path
from typing import NamedTuple, Self

from robofleet.patterns import CONFIGURATIONS
from robofleet.processes.page_address import LOOPBACK, is_local, listening
from robofleet.processes.refusal import RefusedError
from robofleet.processes.web.certificate import page_keys

OPTION = "--foxglove"
DEFAULT = f"{LOOPBACK}:8765"  # the port that viewers propose
PATTERN = re.compile(r"(?P<host>\[[0-9A-Fa-f:.%\w]+\]|[^\s:/\[\]]+):(?P<port>\d{1,5})")
_MOST = 65535
_FAMILIES = socket.AF_INET, socket.AF_INET6


def completed(arguments: list[str]) -> list[str]:
    """Return a command line with the value of an option that stands without one."""
    given: list[str] = []
    for word, following in zip(arguments, [*arguments, ""][1:], strict=True):
        given.append(word)
        if word == OPTION and (not following or following.startswith("-") or Path(following).suffix in CONFIGURATIONS):
            given.append(DEFAULT)
    return given


class Address(NamedTuple):
    """Where a server listens."""

    host: str
    port: int

    @classmethod
    def read(cls, text: str, option: str = OPTION) -> Self:
        """Return what HOST:PORT says; RefusedError where it is none."""
        found = PATTERN.fullmatch(text)
        if found is None or int(found["port"]) > _MOST:
            raise RefusedError(f"{option} {text}: this is no HOST:PORT: write one like {DEFAULT}")
        return cls(found["host"].strip("[]"), int(found["port"]))

    def check(self, arena: str, option: str = OPTION) -> None:
        """Refuse an address that is not this machine's, or in use, or that has no certificate."""
        page_keys(arena, self.host, option)
        listening(self.host, 0, option).close()
        try:
            socket.create_server((self.host, self.port), family=_FAMILIES[":" in self.host]).close()
        except OSError as error:
            why = os.strerror(error.errno or 0)
            raise RefusedError(f"{option} {self}: {why}: name a port that is free, or 0 for any") from error

    @property
    def secured(self) -> bool:
        """Whether others reach it: then it is served by TLS, as the operator's page is."""
        return not is_local(self.host)

    def url(self, port: int) -> str:
        """Return what a viewer opens; ``port``: the one that was found free."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'wss' if self.secured else 'ws'}://{host}:{port}"

    def __str__(self) -> str:
        """Return HOST:PORT."""
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"
