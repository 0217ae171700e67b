"""Where viewers find a run: HOST:PORT, and what an address beyond this computer needs."""

import os
import re
import socket
from pathlib import Path
from typing import NamedTuple, Self

from robofleet.core.patterns import CONFIGURATIONS
from robofleet.core.refusal import LAB_MODULES, RefusedError, need_extra
from robofleet.operator.page.certificate import page_keys
from robofleet.operator.page.page_address import LOOPBACK, is_local, listening

FOXGLOVE, RERUN = "foxglove", "rerun"  # the viewers, which their commands and options are called after
DEFAULTS = {
    FOXGLOVE: f"{LOOPBACK}:8765",  # the port that its viewers propose
    RERUN: f"{LOOPBACK}:9877",  # its viewer has 9876 itself
}
PATTERN = re.compile(r"(?P<host>\[[0-9A-Fa-f:.%\w]+\]|[^\s:/\[\]]+):(?P<port>\d{1,5})")
_MOST = 65535
_FAMILIES = socket.AF_INET, socket.AF_INET6


def option(viewer: str) -> str:
    return f"--{viewer}"


def need(viewer: str) -> None:
    need_extra(viewer, viewer)  # its module, and the extra that brings it, have its name
    need_extra("lab", *LAB_MODULES)


def completed(arguments: list[str]) -> list[str]:
    """Return a command line with the value of each option that stands without one."""
    defaults = {option(viewer): at for viewer, at in DEFAULTS.items()}
    given: list[str] = []
    for word, following in zip(arguments, [*arguments, ""][1:], strict=True):
        given.append(word)
        if word in defaults and (
            not following or following.startswith("-") or Path(following).suffix in CONFIGURATIONS
        ):
            given.append(defaults[word])
    return given


class Address(NamedTuple):
    """Where a server listens."""

    host: str
    port: int

    @classmethod
    def read(cls, viewer: str, text: str, named: str) -> Self:
        """Return what HOST:PORT says, as an option names it; RefusedError where it is none."""
        found = PATTERN.fullmatch(text)
        if found is None or int(found["port"]) > _MOST:
            raise RefusedError(f"{named} {text}: this is no HOST:PORT: write one like {DEFAULTS[viewer]}")
        at = cls(found["host"].strip("[]"), int(found["port"]))
        if viewer == RERUN and at.secured:
            raise RefusedError(
                f"{named} {text}: rerun's server has no encryption, so it serves this computer alone: name "
                f"{LOOPBACK}:PORT, and look from another computer by ssh -N -L PORT:{LOOPBACK}:PORT"
            )
        return at

    def check(self, arena: str, named: str) -> None:
        """Refuse an address that is not this machine's, or in use, or that has no certificate."""
        page_keys(arena, self.host, named)
        listening(self.host, 0, named).close()
        try:
            self._listening().close()
        except OSError as error:
            why = os.strerror(error.errno or 0)
            raise RefusedError(f"{named} {self}: {why}: name a port that is free, or 0 for any") from error

    def settled(self) -> Self:
        """Return it with a port that is free now, where any is good; OSError where its own is in use."""
        with self._listening() as listening_:
            return self._replace(port=listening_.getsockname()[1])

    def _listening(self) -> socket.socket:
        return socket.create_server((self.host, self.port), family=_FAMILIES[":" in self.host])

    @property
    def secured(self) -> bool:
        """Whether others reach it: then it is served by TLS, as the operator's page is."""
        return not is_local(self.host)

    def url(self, port: int) -> str:
        """Return what a viewer opens; ``port``: the one that was found free."""
        return f"{'wss' if self.secured else 'ws'}://{self._replace(port=port)}"

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"
