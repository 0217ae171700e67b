"""The dead man's own process: a program that ``dead_man.py`` starts, with two descriptors and the stop bytes.

It imports no more than it needs, so that it is small, starts at once and has little that can fail.
"""

import os
import select
import signal
import sys

AGAIN_S = 0.05  # between two stops: the line may lose one
STOPS = 4  # after the driver's death
READY, STOPPED = b"r", b"s"  # to the driver
ALIVE, GOODBYE = b"a", b"g"  # from it


def main(line: int, signs: int, stop: bytes, silent_s: float) -> None:
    """Watch until the driver says goodbye or dies: ``signs`` come from it, ``stop`` goes to ``line``.

    Without a sign for ``silent_s`` it hangs.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # meant for the driver, which says goodbye then
    os.write(signs, READY)
    patience = None  # it is not watched before its first sign
    while True:
        if select.select([signs], [], [], patience)[0]:
            received = _read(signs)
            if received.endswith(GOODBYE):
                return
            if not received:
                break
            patience = silent_s
        else:
            if patience != AGAIN_S:
                _write(signs, STOPPED)  # first: a driver that goes on behind the stop must know of it
            _write(line, stop)
            patience = AGAIN_S
    for _ in range(STOPS):
        _write(line, stop)
        select.select([], [], [], AGAIN_S)


def _read(signs: int) -> bytes:
    try:
        return os.read(signs, 4096)
    except OSError:  # reset: it died with something unread
        return b""


def _write(descriptor: int, data: bytes) -> None:
    try:
        os.write(descriptor, data)
    except OSError:
        return  # the line takes nothing, or is gone: it may be there the next time


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), bytes.fromhex(sys.argv[3]), float(sys.argv[4]))
