"""How long a tick takes to the operator's page, and whether the controller feels that pages are open.

    python -m tools.measure.latency.web_latency --robots 4
    python -m tools.measure.latency.web_latency --robots 100 [--synthetic]

Real processes and real browsers (headless Chromium through selenium). Update: from the arrival of a TickRecord at the
page's server to the page's word that it has drawn it. Blocks without a page and with pages take turns. With
``--synthetic`` there is no fleet: ticks, states and statuses of so many robots are published at their rates.
"""

import argparse
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import psutil
from selenium.webdriver import Chrome

from robofleet.bus.bus import Inbox
from robofleet.bus.keys import STATE, TICK, key
from robofleet.bus.messages import RUN_STATE
from robofleet.bus.requests import asked
from robofleet.bus.zenoh_bus import ZenohBus, open_router
from robofleet.config.load import load_config, resolved_yaml
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, WallClock
from robofleet.operator.page import feed, process, server
from robofleet.operator.page.page_address import Addresses
from robofleet.safety.supervisor import Event, Phase
from tests.endpoints import own_endpoint
from tests.nodes.longfleet import fleet_of
from tests.operator.page.browser import chromium
from tests.operator.page.webstand import WebStand
from tests.runs.realrun import own_folders
from tests.shipped import PLATOON
from tools.measure.fleet import started
from tools.measure.program import program
from tools.measure.runs.recorder_cost import heard

CLOCK = WallClock()
_ARMED_WITHIN_S = 5.0  # a robot, and as much for the whole


class MeasuredPage(feed.Page):
    """Keeps how long each tick took to be drawn."""

    took_ms: list[float] = []  # noqa: RUF012 - one process has one list

    def drawn(self, seq: int) -> None:
        now_ns = CLOCK.now_ns()
        self.took_ms += [(now_ns - at_ns) / MS for sent, at_ns in self._undrawn if sent == seq and at_ns]
        super().drawn(seq)


def measured_server(file: Path, descriptor: int) -> None:
    """Be the page's server; what was measured is written beside the configuration in the end."""
    vars(server)["Page"] = MeasuredPage
    listening = socket.create_server(("127.0.0.1", 0))
    process.of_run(load_config(file), file.parent, descriptor, listening, "127.0.0.1", None)
    (file.parent / "took_ms.json").write_text(json.dumps(MeasuredPage.took_ms))


@contextmanager
def real_fleet(config: Config, file: Path, log: Path) -> Iterator[ZenohBus]:
    """Start every process of a run, and the run."""
    children = started(config, file, log)
    try:
        bus = ZenohBus(config.arena.name, config.bus.endpoint, "latency", CLOCK)
        try:
            yield bus
        finally:
            bus.close()
    finally:
        children.reap(CLOCK)


def start(bus: ZenohBus, robots: int) -> str:
    """Start the run and wait until it drives; returns the phase that it came to."""
    print(asked(bus, CLOCK, "supervisor", b"start").decode(), file=sys.stderr)
    state, deadline_ns = (
        Inbox(bus.newest(STATE), RUN_STATE.decode),
        CLOCK.now_ns() + round(_ARMED_WITHIN_S * (1 + robots) * S),
    )
    phase, newest = Phase.ARMED, None
    while phase is Phase.ARMED and CLOCK.now_ns() < deadline_ns:
        CLOCK.sleep_until(CLOCK.now_ns() + 20 * MS)
        if (newest := state.take()) is not None and newest.cause != Event.NOTHING:
            phase = Phase(newest.phase)
    return phase.name if newest is None else f"{phase.name} ({Event(newest.cause).name})"


@contextmanager
def synthetic_fleet(config: Config) -> Iterator[ZenohBus]:
    """Run another process that says what a fleet would say."""
    router = open_router(config.bus.endpoint)
    bus = ZenohBus(config.arena.name, config.bus.endpoint, "latency", CLOCK)
    command = [sys.executable, "-m", "tools.measure.latency.web_latency", "--robots", str(len(config.robots))]
    saying = subprocess.Popen([*command, "--say", config.bus.endpoint])
    try:
        yield bus
    finally:
        saying.terminate()
        saying.wait()
        bus.close()
        router.close()  # type: ignore[no-untyped-call]


def say(config: Config) -> None:
    """Publish what a fleet would say, for ever."""
    bus = ZenohBus(config.arena.name, config.bus.endpoint, "say", CLOCK)
    stand = WebStand(config, bus, Addresses("http://nowhere/?token=none", ""), lambda: None, threading.Event())
    due = {"tick": 33 * MS, "state": 40 * MS, "status": 20 * MS}
    next_ns = dict.fromkeys(due, CLOCK.now_ns())
    run_tick = 0
    while True:
        CLOCK.sleep_until(min(next_ns.values()))
        for what in [what for what, at_ns in next_ns.items() if at_ns <= CLOCK.now_ns()]:
            next_ns[what] += due[what]
            if what == "tick":
                stand.say_tick(run_tick := run_tick + 1)
            elif what == "state":
                stand.say_state(Phase.RUNNING, Event.PROVED)
            else:
                for robot in stand.robots:
                    stand.say_status(robot)


def first_picture_ms(browser: Chrome) -> float | None:
    """Return the time from the navigation's start to the first tick drawn [ms]."""
    found = browser.execute_script("return performance.getEntriesByName('first-tick-drawn')[0]?.startTime")
    return None if found is None else float(found)


def busy_s(browser: Chrome) -> tuple[float, int]:
    """Return how long the page's thread has computed [s of its processor], and the ticks that it drew meanwhile."""
    metrics = browser.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    (spent,) = (metric["value"] for metric in metrics if metric["name"] == "TaskDuration")
    return float(spent), int(browser.execute_script("return window.robofleet?.state.drawn ?? 0"))


def measure(bus: ZenohBus, config: Config, url: str, pages: int, seconds: float, rounds: int) -> None:
    """Print lateness without and with pages, and how soon a page shows something."""
    late: dict[int, list[float]] = {0: [], pages: []}
    first: list[float] = []
    drawing_ms: list[float] = []  # of a page's processor, for a tick
    stream = bus.stream(key(config.arena.name, TICK), capacity=1 << 16)
    with ExitStack() as opened:
        browsers = [opened.enter_context(chromium()) for _ in range(pages)]
        for browser in browsers:
            browser.set_window_size(1280, 900)
            browser.execute_cdp_cmd("Performance.enable", {"timeDomain": "threadTicks"})
        for _ in range(rounds):
            late[0] += heard(stream, seconds / rounds)[:, 0].tolist()
            for browser in browsers:
                browser.get(url)
            CLOCK.sleep_until(CLOCK.now_ns() + 2 * S)
            psutil.cpu_percent()
            before = [busy_s(browser) for browser in browsers]
            late[pages] += heard(stream, seconds / rounds)[:, 0].tolist()
            busy = psutil.cpu_percent()
            for (began_s, had), (spent_s, has) in zip(before, map(busy_s, browsers), strict=True):
                drawing_ms.append(1e3 * (spent_s - began_s) / max(1, has - had))
            first += [ms for browser in browsers if (ms := first_picture_ms(browser)) is not None]
            for browser in browsers:
                browser.get("about:blank")
    for count, found in late.items():
        print(f"lateness with {count} pages: {figures(found)} us of {len(found)} ticks in {seconds:.0f} s")
    print(f"first picture after opening: {figures(first)} ms of {len(first)} openings")
    print(f"a tick takes {figures(drawing_ms)} ms of the page's thread, in {len(drawing_ms)} blocks")
    print(f"processors {busy:.0f} % busy with {pages} pages")


def figures(values: list[float]) -> str:
    if not values:
        return "nothing"
    p50, p99 = np.percentile(values, (50, 99))
    return f"p50 {p50:.1f}, p99 {p99:.1f}, worst {max(values):.1f}"


@contextmanager
def served(file: Path) -> Iterator[str]:
    """Start the measured server and return the page's address."""
    ours, theirs = socket.socketpair()
    command = [sys.executable, "-m", "tools.measure.latency.web_latency", "--serve", str(file)]
    with theirs, ours:
        child = subprocess.Popen([*command, "--lifeline", str(theirs.fileno())], pass_fds=[theirs.fileno()])
        try:
            yield ours.recv(256).decode().split()[0]
            watched = psutil.Process(child.pid)
            cpu = watched.cpu_times()
            print(f"the server used {cpu.user + cpu.system:.1f} s, {watched.memory_info().rss / 1e6:.0f} MB")
        finally:
            child.terminate()
            child.wait(10)


def main() -> None:
    parser = program(
        __doc__, robots=4, pages=3, seconds=40.0, rounds=4, idle=(False, "do not start the fleet"), synthetic=False
    )
    for name, kind in (("--serve", Path), ("--lifeline", int), ("--say", str)):
        parser.add_argument(name, type=kind, help=argparse.SUPPRESS)
    a = parser.parse_args()
    if a.serve is not None:
        measured_server(a.serve, a.lifeline)
        return
    config = load_config(PLATOON, [*fleet_of(a.robots), f"bus.endpoint={a.say or own_endpoint()}"])
    if a.say is not None:
        say(config)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        os.environ.update(own_folders(folder))
        (folder / "config.yaml").write_text(resolved_yaml(config))
        fleet = synthetic_fleet(config) if a.synthetic else real_fleet(config, folder / "config.yaml", folder)
        with fleet as bus:
            if not a.synthetic and not a.idle:
                print(f"phase: {start(bus, a.robots)}")
            with served(folder / "config.yaml") as url:
                measure(bus, config, url, a.pages, a.seconds, a.rounds)
        took_ms = json.loads((folder / "took_ms.json").read_text())
        print(f"update, {a.robots} robots, {a.pages} pages: {figures(took_ms)} ms of {len(took_ms)} ticks drawn")


if __name__ == "__main__":
    main()
