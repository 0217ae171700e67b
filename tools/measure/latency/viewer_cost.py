"""What viewers cost the controller: lateness and computing time of its ticks without a server, with one, with a viewer.

    python -m tools.measure.latency.viewer_cost --robots 100 --turns 3 --seconds 10

One real run without pixels. The server of viewers is started and ended in turns, so that all sides see the same
machine; the viewer, a process of its own, takes every channel. The spread over the turns of one side is the noise.
"""

import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from robofleet.bus.joining import joined
from robofleet.bus.keys import TICK, key
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.config.load import load_config
from robofleet.core.clock import S
from tests.runs.realrun import CLOCK, RealRun, wait
from tools.measure.program import program
from tools.measure.runs.recorder_cost import heard, print_table

SIDES = "without", "server", "viewer"
_SETTLED_NS = 3 * S  # after a process was started or ended
_WITHIN_S = 60.0
_LOOK = (
    "import asyncio, sys; from tests.gateways.foxglove_client import Viewer, viewer\n"
    "async def look():\n"
    "    async with viewer(sys.argv[1]) as socket:\n"
    "        one = Viewer(socket)\n"
    "        while True:\n"
    "            await one.until(lambda: len(one.messages) > 10000, 1e6)\n"
    "            one.messages.clear()\n"
    "asyncio.run(look())\n"
)


@contextmanager
def side(name: str, run: RealRun, folder: Path) -> Iterator[None]:
    """Have what a side has beside the run."""
    started: list[subprocess.Popen[bytes]] = []
    try:
        if name != "without":
            output = folder / "foxglove.said"
            with output.open("wb") as out:
                command = [sys.executable, "-m", "robofleet", "foxglove", "--at", "127.0.0.1:0"]
                started.append(subprocess.Popen(command, env=run.environment, stderr=out))
            assert wait(lambda: re.search(r"ws://\S+:\d+", output.read_text()), _WITHIN_S), output.read_text()
        if name == "viewer":
            found = re.search(r"ws://[0-9.]+:\d+", output.read_text())
            assert found is not None
            started.append(subprocess.Popen([sys.executable, "-c", _LOOK, found[0]]))
        yield
    finally:
        for process in started[::-1]:
            process.terminate()
            process.wait(_WITHIN_S)


def ticks(bus: ZenohBus, arena: str, seconds: float) -> NDArray[np.float64]:
    """Return lateness and computing time of the ticks of some seconds (K, 2) [us]."""
    CLOCK.sleep_until(CLOCK.now_ns() + _SETTLED_NS)
    return heard(bus.stream(key(arena, TICK), capacity=1 << 14), seconds)


def main() -> None:
    arguments = program(__doc__, robots=100, turns=(3, "of each side"), seconds=(10.0, "of each turn")).parse_args()
    found: dict[str, list[NDArray[np.float64]]] = {name: [] for name in SIDES}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        file, tool = folder / "fleet.yaml", Path(__file__).parents[3] / "tools" / "large_fleet.py"
        size = [str(arguments.robots), "--units", str(max(1, arguments.robots // 25)), "--out", str(file)]
        subprocess.run([sys.executable, str(tool), *size], check=True)
        run = RealRun(folder, "--duration", "3600", config=file)
        try:
            run.wait_until_running()
            config = load_config(run.folder / "config.yaml")
            bus = joined(config.arena.name, config.bus.endpoint, "viewer", CLOCK, _WITHIN_S)
            for _ in range(arguments.turns):
                for side_name in SIDES:
                    with side(side_name, run, folder):
                        found[side_name].append(ticks(bus, config.arena.name, arguments.seconds))
                    assert run.launcher.poll() is None and len(found[side_name][-1]), run.said
            bus.close()
        finally:
            run.clean_up()
    print_table("beside", found)


if __name__ == "__main__":
    main()
