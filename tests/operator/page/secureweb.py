"""The operator's page beyond this computer: its keys, and who comes to it from elsewhere."""

import ssl
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx

from robofleet.bus.permissions import PAGE
from robofleet.hosts.authority import Authority
from robofleet.operator.page.certificate import PageKeys, opened
from tests.operator.page.webstand import OpenPage, WebStand

HOST = "127.0.0.2"  # of this computer, but not the one that needs no keys
ARENA = "hall"


def keys_in(folder: Path, addresses: Sequence[str] = (HOST,), arena: str = ARENA) -> PageKeys:
    """Make an authority in a folder, and a page's keys; return those."""
    own = Authority.create(arena, folder).issue(PAGE, PAGE, addresses=addresses)
    return opened(own, addresses[0])


def trusting(folder: Path) -> ssl.SSLContext:
    """Return what a browser has that knows the authority in a folder."""
    return ssl.create_default_context(cafile=folder / "authority.pem")


class Visitor:
    """A browser of somebody: it keeps its cookies, and opens pages."""

    def __init__(self, stand: WebStand, trusts: ssl.SSLContext) -> None:
        self._stand, self._trusts = stand, trusts
        self.client = httpx.Client(verify=trusts, base_url=f"https://{stand.authority}")

    def enter(self, address: str) -> httpx.Response:
        """Open an address."""
        parts = urlsplit(address)
        return self.client.get(f"{parts.path}?{parts.query}")

    def post(self, path: str, **changes: str) -> httpx.Response:
        """Ask for something as the page does, with what a test changes."""
        return self.client.post(path, headers={"origin": f"https://{self._stand.authority}"} | changes)

    def page(self, **changes: Any) -> OpenPage:
        """Open the page's WebSocket."""
        cookies = "; ".join(f"{name}={value}" for name, value in self.client.cookies.items())
        how = {"ssl": self._trusts, "additional_headers": {"Cookie": cookies}} | changes
        return self._stand.page(scheme="https", **how)
