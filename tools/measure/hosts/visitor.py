"""A browser on another host that has the operator's page open: it counts what it is told.

python -m tools.measure.hosts.visitor ADDRESS AUTHORITY.pem
"""

import json
import ssl
import sys
from contextlib import suppress
from urllib.parse import urlsplit

import httpx
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Origin

from robofleet.core.clock import S, WallClock


def visit(address: str, authority: str, seconds: str) -> dict[str, int]:
    """Open a page by its one-time address, and stay for a while."""
    clock = WallClock()
    end_ns = clock.now_ns() + round(float(seconds) * S)
    trusted, parts = ssl.create_default_context(cafile=authority), urlsplit(address)
    with httpx.Client(verify=trusted, base_url=f"https://{parts.netloc}", follow_redirects=True) as client:
        client.get(f"{parts.path}?{parts.query}").raise_for_status()
        cookies = "; ".join(f"{name}={value}" for name, value in client.cookies.items())
    counts = {"messages": 0, "bytes": 0}
    origin, live = Origin(f"https://{parts.netloc}"), f"wss://{parts.netloc}/live"
    with (
        connect(live, ssl=trusted, origin=origin, additional_headers={"Cookie": cookies}) as page,
        suppress(ConnectionClosed),
    ):
        while clock.now_ns() < end_ns:
            message = page.recv(timeout=5)
            counts["messages"] += 1
            counts["bytes"] += len(message)
    return counts


if __name__ == "__main__":
    print(json.dumps(visit(*sys.argv[1:])))
