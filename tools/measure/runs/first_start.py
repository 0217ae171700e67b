"""A first and a later start, and Ctrl-C in a first one: ``python -m tools.measure.runs.first_start [--times N]``.

Each in a pipe and in a terminal: when the first word and the page come and when the robots drive, the longest time
without a change of what is shown, and by what factor the time left was wrong after the first fifth of the start. The
compiled kernels stand in a cache of this program's own.
"""

import os
import pty
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple
from urllib.request import urlopen

from robofleet.core.clock import MS, S, WallClock
from tools.measure.program import program

PLATOON = Path(__file__).parents[3] / "configs" / "platoon.yaml"
_STARTING = re.compile(r"starting (\d+) %, about (\d+) s left")
_PAGE = re.compile(r"http://\S+")
_DRIVES = re.compile(r"\brunning +\d")
_PAGE_WITHIN_S = 60.0
_CLOCK = WallClock()


class Look(NamedTuple):
    """Something that was shown."""

    at_s: float
    text: str


class Start(NamedTuple):
    """What a start showed."""

    looks: list[Look]
    page_s: float | None  # when the page was served
    ended_s: float
    code: int

    def words(self, interrupted_after_s: float | None) -> str:
        if interrupted_after_s is not None:
            return f"ended after {self.ended_s - interrupted_after_s:.1f} s, exit code {self.code}"
        drives_s = next((look.at_s for look in self.looks if _DRIVES.search(look.text)), None)
        if drives_s is None:
            return f"does not drive, exit code {self.code}"
        until = [look for look in self.looks if look.at_s <= drives_s]
        changes_s = [0.0] + [b.at_s for a, b in zip([Look(0.0, ""), *until], until, strict=False) if a.text != b.text]
        silence_s = max(b - a for a, b in pairwise(changes_s))
        ratios = [
            (drives_s - look.at_s) / int(found[2])
            for look in until
            if (found := _STARTING.search(look.text)) and look.at_s >= drives_s / 5 and drives_s - look.at_s > 3.0
        ]
        wrong = max((max(ratio, 1.0 / ratio) for ratio in ratios), default=1.0)
        page = "-" if self.page_s is None else f"{self.page_s:.1f} s"
        return (
            f"first word {until[0].at_s:.1f} s, page {page}, drives {drives_s:.1f} s; longest without a change "
            f"{silence_s:.1f} s, {len(changes_s) - 1} changes; time left wrong by {wrong:.2f} at most"
        )


def start(folder: Path, cache: Path, *, terminal: bool, interrupted_after_s: float | None = None) -> Start:
    """Run for 3 s, in a pipe or in a terminal of 100 columns."""
    began_ns = _CLOCK.now_ns()
    read, write = pty.openpty() if terminal else os.pipe()
    run = subprocess.Popen(
        [
            *(sys.executable, "-m", "robofleet", "run", str(PLATOON), "--web", "--no-browser", "--duration", "3"),
            *("--set", "arena.name=first-start", "--out", str(folder / "run")),
        ],
        env=os.environ | {"XDG_STATE_HOME": str(folder), "XDG_CACHE_HOME": str(cache), "COLUMNS": "100"},
        stdin=subprocess.DEVNULL, stdout=write, stderr=write,
    )  # fmt: skip
    os.close(write)
    looks: list[Look] = []
    served_s: list[float] = []

    def at_s() -> float:
        return (_CLOCK.now_ns() - began_ns) / S

    def open_page(address: str) -> None:
        while at_s() < _PAGE_WITHIN_S:
            try:
                urlopen(address, timeout=5.0).close()
            except OSError:
                _CLOCK.sleep_until(_CLOCK.now_ns() + 50 * MS)
            else:
                served_s.append(at_s())
                return

    if interrupted_after_s is not None:
        threading.Timer(interrupted_after_s, run.send_signal, [signal.SIGINT]).start()
    opened = False
    for text in _texts(read):
        looks.append(Look(at_s(), text))
        if not opened and (found := _PAGE.search(text)):
            opened = True
            threading.Thread(target=open_page, args=(found[0],), daemon=True).start()
    code = run.wait()
    os.close(read)
    return Start(looks, min(served_s, default=None), at_s(), code)


def _texts(descriptor: int) -> Iterator[str]:
    """Yield what a program writes, without the signs that move a terminal's cursor."""
    while True:
        try:
            text = os.read(descriptor, 65536)
        except OSError:  # its terminal was closed
            return
        if not text:
            return
        if plain := re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text.decode(errors="replace")).strip():
            yield plain


def main() -> None:
    times = program(__doc__, times=(1, "of each")).parse_args().times
    with tempfile.TemporaryDirectory() as caches:
        cache = Path(caches)
        for name, cold, after_s in (
            ("first", True, None),
            ("later", False, None),
            ("Ctrl-C in a first one", True, 8.0),
        ):
            for where in ("pipe", "terminal"):
                for _ in range(times):
                    if cold:
                        shutil.rmtree(cache / "robofleet", ignore_errors=True)
                    with tempfile.TemporaryDirectory() as folder:
                        found = start(Path(folder), cache, terminal=where == "terminal", interrupted_after_s=after_s)
                    print(f"{name}, {where}: {found.words(after_s)}", flush=True)


if __name__ == "__main__":
    main()
