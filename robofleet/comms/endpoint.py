"""The endpoint where the router listens."""

import socket


def bind_endpoint(endpoint: str) -> str:
    """Return the endpoint with its port settled: 0 becomes a free one. OSError if the port is in use."""
    host, _, port = endpoint.removeprefix("tcp/").rpartition(":")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((host.strip("[]"), int(port)))
        return f"tcp/{host}:{probe.getsockname()[1]}"
