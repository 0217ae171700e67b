"""What a server of viewers is, and what it shows."""

from pathlib import Path
from typing import NamedTuple, Protocol

from robofleet.config.tree import Config
from robofleet.gateways.asking import Asking
from robofleet.gateways.place import ArenaAccess


class Server(Protocol):
    """Shows messages of channels to viewers. None of them is waited for.

    ``address`` tells a user how to open it.
    """

    address: str

    def tell(self, topic: str, log_ns: int, message: bytes) -> None:
        """Take a message of a channel; ``log_ns``: a date."""

    def step(self, log_ns: int) -> None:
        """Show what was told, and again what was told seldom to who comes late; ``log_ns``: the date now."""

    def close(self) -> None:
        """Close every viewer's connection."""


class Run(NamedTuple):
    """The run that a server shows."""

    config: Config
    access: ArenaAccess
    folder: Path  # for what a viewer needs
    ask: Asking
