"""A radio between robots and their router: a proxy of UDP that loses and delays packets, by a seed.

    python -m tools.measure.hosts.radio 10.77.0.9:7447 10.77.0.1:7447 bursts --seed 1

Packets are lost when they are sent, and do not overtake each other. Each robot has a channel of its own.
"""

import argparse
import heapq
import itertools
import os
import random
import selectors
import socket
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import NamedTuple

from robofleet.core.clock import S, WallClock

_LARGEST = 65535
_CLIENTS = 64
Address = tuple[str, int]
Lost = Callable[[float], bool]  # whether a packet that is sent at an instant [s] is lost


_CLOCK = WallClock()


def _now() -> float:
    return _CLOCK.now_ns() / S


class Pattern(NamedTuple):
    """What a radio does to packets."""

    losing: Callable[[random.Random], tuple[Lost, Lost]]  # of one robot's channel: to it, and from it
    jitter_s: float  # delays are uniform from 0 to this


def _outages(draw: random.Random, share: float, longest_s: float) -> Lost:
    """Nothing passes for a while, uniform up to ``longest_s``, in both directions; ``share`` of all time."""
    bad_s = longest_s / 2
    good_s = bad_s * (1 - share) / share
    began, ends = 0.0, 0.0

    def lost(now: float) -> bool:
        nonlocal began, ends
        while now >= ends:
            began = ends + draw.expovariate(1 / good_s) if ends else now + draw.expovariate(1 / good_s)
            ends = began + draw.uniform(0, longest_s)
        return began <= now

    return lost


def _gilbert(draw: random.Random, good: float, bad: float) -> Lost:
    """Gilbert's model: runs of packets that pass and of packets that are lost, geometric, of these mean lengths."""
    losing = False

    def lost(_now: float) -> bool:
        nonlocal losing
        losing = draw.random() >= 1 / bad if losing else draw.random() < 1 / good
        return losing

    return lost


def _both(lost: Lost) -> tuple[Lost, Lost]:
    return lost, lost


def _each(good: float, bad: float) -> Callable[[random.Random], tuple[Lost, Lost]]:
    return lambda draw: (_gilbert(draw, good, bad), _gilbert(draw, good, bad))


PATTERNS = {
    "none": Pattern(lambda _: _both(lambda _now: False), 0.0),
    "bursts": Pattern(lambda draw: _both(_outages(draw, 0.05, 0.060)), 0.020),
    # Presets of the network emulator in str0m (github.com/algesten/str0m, crate str0m-netem: GilbertElliot).
    "wifi": Pattern(_each(200, 2), 0.0),
    "wifi_lossy": Pattern(_each(40, 2), 0.0),
}


class _Way:
    """One direction of a robot's channel."""

    def __init__(self, lost: Lost, jitter_s: float, draw: random.Random) -> None:
        self._lost, self._jitter_s, self._draw, self._newest = lost, jitter_s, draw, 0.0
        self.packets, self.losses = 0, 0

    def due(self, now: float) -> float | None:
        """Return when a packet that is sent now arrives; None where it is lost."""
        self.packets += 1
        if self._lost(now):
            self.losses += 1
            return None
        self._newest = max(self._newest, now + self._draw.uniform(0, self._jitter_s))
        return self._newest


def serve(listen: Address, to: Address, pattern: Pattern, seed: int) -> None:
    """Pass on what arrives, until this process is ended."""
    choosing = selectors.DefaultSelector()
    front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    front.bind(listen)
    front.setblocking(False)
    choosing.register(front, selectors.EVENT_READ, None)
    clients: dict[Address, tuple[socket.socket, _Way, _Way]] = {}
    waiting: list[tuple[float, int, Callable[[], object]]] = []
    order = itertools.count()

    def client(address: Address) -> tuple[socket.socket, _Way, _Way]:
        if address not in clients:
            assert len(clients) < _CLIENTS
            back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            back.connect(to)
            back.setblocking(False)
            choosing.register(back, selectors.EVENT_READ, address)
            draw = random.Random(f"{seed} {address[0]}")
            from_client, here = pattern.losing(draw)
            clients[address] = back, _Way(from_client, pattern.jitter_s, draw), _Way(here, pattern.jitter_s, draw)
        return clients[address]

    def pass_on(due: float | None, send: Callable[[], object]) -> None:
        if due is not None:
            heapq.heappush(waiting, (due, next(order), send))

    while True:
        left = None if not waiting else max(0.0, waiting[0][0] - _now())
        for key, _ in choosing.select(left):
            source = key.fileobj
            assert isinstance(source, socket.socket)
            while True:
                try:
                    data, sender = source.recvfrom(_LARGEST)
                except (BlockingIOError, ConnectionRefusedError):
                    break
                now = _now()
                if key.data is None:
                    back, _, up = client(sender)
                    pass_on(up.due(now), partial(back.send, data))
                else:
                    _, down, _ = client(key.data)
                    pass_on(down.due(now), partial(front.sendto, data, key.data))
        while waiting and waiting[0][0] <= _now():
            with suppress(BlockingIOError, ConnectionRefusedError):
                heapq.heappop(waiting)[2]()


def _address(text: str) -> Address:
    host, _, port = text.rpartition(":")
    return host, int(port)


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("listen", type=_address)
    arguments.add_argument("to", type=_address)
    arguments.add_argument("pattern", choices=PATTERNS)
    arguments.add_argument("--seed", type=int, default=1)
    options = arguments.parse_args()
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(30))  # it is the air, which no process delays
    serve(options.listen, options.to, PATTERNS[options.pattern], options.seed)
