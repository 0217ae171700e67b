"""From a person's hand to the bus and to the gate: until it lets the wheels turn, and until they stand again.

    python -m tools.measure.latency.hand_latency --times 20 --stick

A real run without pixels. A gamepad's events come through a pipe, or with ``--page`` from a stub of the Gamepad API in
Chromium; with ``--stick`` a touch holds the page's stick there. A time at the gate ends when the driver's status that
says so arrives: up to 20 ms after it became so. ``none``: how often nothing came within five seconds.
"""

import itertools
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np

from robofleet.bus.bus import Stream
from robofleet.bus.joining import joined
from robofleet.bus.keys import STATUS, TELEOP, key
from robofleet.bus.messages import SCRIPT_WISH, UNIT_STATUS
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, epoch_ns
from robofleet.gateways.gamepad import command
from robofleet.gateways.gamepad.pads import ABS_Y, BTN_TR, EV_ABS, EV_KEY, EventPad
from tests.gateways.piped_pad import PipedDevice
from tests.operator.page.browser import LYING, chromium, show_as
from tests.operator.test_hand import GROUP, STUB
from tests.operator.test_hand import TELEOP as CONFIG
from tests.runs.realrun import CLOCK, RealRun, wait
from tools.measure.program import program

_WITHIN_NS = 5 * S
_LISTEN = """for (const kind of ["pointerdown", "pointerup"])
    document.getElementById("drive-stick").addEventListener(
        kind, (event) => (window.at = performance.timeOrigin + event.timeStamp), true);"""
Act = Callable[[bool], int]  # hold the stick, or let it go; returns when that was


@contextmanager
def pad(config: Config, bus: ZenohBus) -> Iterator[Act]:
    """Drive by a gamepad of this computer."""
    device = PipedDevice()

    def drive() -> None:
        with suppress(OSError, ValueError):  # it is closed
            command.drive(EventPad(device), config, bus, CLOCK, GROUP, lambda: False)

    thread = threading.Thread(target=drive)
    thread.start()
    device.happens((EV_ABS, ABS_Y, -32768))

    def act(held: bool) -> int:
        now_ns = CLOCK.now_ns()
        device.happens((EV_KEY, BTN_TR, int(held)))
        return now_ns

    yield act
    device.close()
    thread.join()


@contextmanager
def page(address: str) -> Iterator[Act]:
    """Drive by the operator's page."""
    with chromium() as browser:
        browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": STUB})
        browser.get(address)
        browser.execute_script("pads = [pad]; pad.axes = [0, -1, 0, 0]")

        def act(held: bool) -> int:
            script = f"pad.buttons[5].pressed = {str(held).lower()}; return performance.timeOrigin + performance.now()"
            return round(float(browser.execute_script(script)) * MS) - epoch_ns()

        yield act


@contextmanager
def stick(address: str) -> Iterator[Act]:
    """Drive by a finger on the page's stick."""
    with chromium() as browser:
        show_as(browser, LYING)
        browser.get(address)
        ring = browser.find_element("id", "drive-stick")
        assert wait(ring.is_displayed, 30.0)
        browser.execute_script(_LISTEN)
        turns_to = itertools.cycle((0.1, 0.9))  # on the spot: parts of its width

        def act(held: bool) -> int:
            box = ring.rect
            point = {"x": box["x"] + next(turns_to) * box["width"], "y": box["y"] + box["height"] / 2}
            event = {"type": "touchStart", "touchPoints": [point]} if held else {"type": "touchEnd", "touchPoints": []}
            browser.execute_cdp_cmd("Input.dispatchTouchEvent", event)
            return round(float(browser.execute_script("return at")) * MS) - epoch_ns()

        yield act


def until(stream: Stream, shows: Callable[[bytes], bool], since_ns: int) -> float:
    """Return how long it took until a message showed it [ms]; NaN: too long."""
    while CLOCK.now_ns() < since_ns + _WITHIN_NS:
        for at_ns, _, payload in stream.drain():
            if at_ns > since_ns and shows(payload):
                return (at_ns - since_ns) / MS
        CLOCK.sleep_until(CLOCK.now_ns() + MS)
    return float("nan")


def says(held: bool) -> Callable[[bytes], bool]:
    """Return whether a setpoint drives the first robot, or lets it stand."""
    return lambda payload: (wish := SCRIPT_WISH.decode(payload)) is not None and any(wish.robots[0][1:3]) == held


def turns(held: bool) -> Callable[[bytes], bool]:
    """Return whether the first robot's gate lets it turn, or stand."""
    return lambda payload: (
        (status := UNIT_STATUS.decode(payload)) is not None and bool(status.robots[0].left_output_rad_s) == held
    )


def main() -> None:
    arguments = program(
        __doc__,
        times=20,
        page=(False, "a gamepad at the operator's page, in Chromium"),
        stick=(False, "a touch on the page's stick, in Chromium"),
    ).parse_args()
    with tempfile.TemporaryDirectory() as name, ExitStack() as held:
        by_page = stick if arguments.stick else page if arguments.page else None
        web = ["--web", "--no-browser"] if by_page else []
        alone = "tracker.source=truth", "drivers.robots_per_process=1"
        run = RealRun(Path(name), *web, *(word for override in alone for word in ("--set", override)), config=CONFIG)
        held.callback(run.clean_up)
        run.wait_until_running()
        config = load_config(run.folder / "config.yaml")
        bus = joined(config.arena.name, config.bus.endpoint, "operator", CLOCK, 60.0)
        held.callback(bus.close)
        statuses = bus.stream(key(config.arena.name, STATUS, "r1"), capacity=4096)
        setpoints = bus.stream(key(config.arena.name, TELEOP, GROUP), capacity=4096)
        if by_page is not None:
            address = run.said.split("the operator's page: ")[1].split()[0]
            act = held.enter_context(by_page(address))
        else:
            act = held.enter_context(pad(config, bus))
        CLOCK.sleep_until(CLOCK.now_ns() + S)
        found = []
        for _ in range(arguments.times):
            for is_held, pause_ns in (True, S // 4), (False, S // 2):
                since_ns = act(is_held)
                found += [until(setpoints, says(is_held), since_ns), until(statuses, turns(is_held), since_ns)]
                CLOCK.sleep_until(CLOCK.now_ns() + pause_ns)
    print(f"{'ms':<34}{'p50':>8}{'p90':>8}{'p99':>8}{'max':>8}{'none':>8}")
    rows = "held, to the bus", "held, to wheels that turn", "let go, to the bus", "let go, to wheels at zero"
    for what, times in zip(rows, np.array(found).reshape(-1, len(rows)).T, strict=True):
        values = np.nanpercentile(times, (50, 90, 99, 100))
        print(f"{what:<34}" + "".join(f"{value:>8.0f}" for value in values) + f"{np.isnan(times).sum():>8}")


if __name__ == "__main__":
    main()
