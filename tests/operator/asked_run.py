"""A run without robots: its files, its router, and a supervisor that prints what it is asked, until its input ends.

    python -m tests.operator.asked_run [USER]

``USER``: a number; root becomes that user. ``until_asked`` starts a command, and says how that one came to its request.
"""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, NamedTuple

from robofleet.bus.arena_file import claimed
from robofleet.bus.endpoint import settled
from robofleet.bus.keys import SAFE_REQUEST
from robofleet.bus.zenoh_bus import ZenohBus, open_router
from robofleet.config.load import load_config
from robofleet.core.clock import MS, WallClock
from tests.shipped import PLATOON

_UNTIL_ASKED = """
import json, os, sys
opened = []
sys.addaudithook(lambda event, args: opened.append(str(args[0])) if event == "open" else None)
import robofleet.bus.zenoh_bus as bus

def ask(self, topic, name, payload):
    used = os.times()
    found = {"what": payload.decode(), "modules": sorted(sys.modules), "opened": opened, "cpu_s": used.user + used.system}
    print(json.dumps(found), flush=True)
    os._exit(0)

bus.ZenohBus.ask = ask
from robofleet.__main__ import main
main()
"""  # noqa: E501


class Asking(NamedTuple):
    """How a command came to its first request."""

    what: str
    modules: list[str]
    opened: list[str]  # files
    cpu_s: float


def until_asked(words: Sequence[str], environment: dict[str, str]) -> Asking:
    """Run a command until it sends its first request, which goes nowhere."""
    command = [sys.executable, "-c", _UNTIL_ASKED, *words]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, (done.stdout, done.stderr)
    return Asking(**json.loads(done.stdout))


@contextmanager
def asked_run(environment: dict[str, str], user: int | None = None) -> Iterator[IO[str]]:
    """Have such a run, and give what it prints."""
    command = [sys.executable, "-m", "tests.operator.asked_run", *([] if user is None else [str(user)])]
    run = subprocess.Popen(command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert run.stdin is not None
    assert run.stdout is not None
    try:
        assert run.stdout.readline() == "ready\n"
        yield run.stdout
    finally:
        run.stdin.close()
        run.wait(30)
        run.stdout.close()


def main() -> None:
    """Be the run."""
    config, clock = load_config(PLATOON), WallClock()
    for user in map(int, sys.argv[1:]):
        os.setgroups([])
        os.setresgid(user, user, user)
        os.setresuid(user, user, user)
    config = settled(config, listen=True)
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    with ExitStack() as held:
        held.enter_context(claimed(config, Path("/nowhere")))
        held.callback(open_router(config.bus.endpoint).close)
        bus = ZenohBus(config.arena.name, config.bus.endpoint, "supervisor", clock, roles=("supervisor",))
        held.callback(bus.close)
        take = bus.serve(SAFE_REQUEST, "supervisor")
        print("ready", flush=True)
        while not ended.is_set():
            if (request := take()) is not None:
                print(request.payload.decode(), flush=True)
                request.reply(b"ok")
            clock.sleep_until(clock.now_ns() + MS)


if __name__ == "__main__":
    main()
