"""What Ray does, as a program: Ray reads its settings once, when it is imported. Prints JSON."""

import json
import os
from contextlib import closing
from typing import Any

import psutil

from robofleet.studies import cluster
from tests.studies.work import squared


def seen() -> dict[str, Any]:
    """Return the results of eight units, where Ray's processes listen, and how the server answers to which token."""
    with cluster.opened("ray", 2) as opened, closing(opened.each(squared, range(8))) as results:
        finished = sorted(results)
        listening = [ip for process in psutil.Process().children(recursive=True) for ip in _listening(process)]
        tokens = {"its own": os.environ.get("RAY_AUTH_TOKEN"), "another": "0" * 64, "none": None}
        answers = {name: _answer(token) for name, token in tokens.items()}
    return {"finished": finished, "listening": listening, "answers": answers}


def _listening(process: psutil.Process) -> list[str]:
    try:
        return [link.laddr.ip for link in process.net_connections() if link.status == "LISTEN"]
    except psutil.NoSuchProcess:  # a worker that has just died
        return []


def _answer(token: str | None) -> str:
    import grpc
    import ray

    channel = grpc.insecure_channel(ray.get_runtime_context().gcs_address)
    check = channel.unary_unary("/ray.rpc.NodeInfoGcsService/CheckAlive")
    metadata = () if token is None else (("authorization", f"Bearer {token}"),)
    name: str = check.future(b"", metadata=metadata, timeout=30).code().name
    return name


if __name__ == "__main__":
    print(json.dumps(seen()))
