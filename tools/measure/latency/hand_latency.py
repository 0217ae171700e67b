"""From a gamepad to the gate: how long until it lets the wheels turn, and until its target is zero after the release.

    python -m tools.measure.latency.hand_latency --times 20 --page

A real run without pixels. The gamepad's events come through a pipe, or with ``--page`` from a stub of the
Gamepad API in Chromium. A time ends when the driver's status that says so arrives: up to 20 ms after it became so.
"""

import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np

from robofleet.bus.bus import Stream
from robofleet.bus.joining import joined
from robofleet.bus.keys import STATUS, key
from robofleet.bus.messages import UNIT_STATUS
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.clock import MS, S, epoch_ns
from robofleet.gateways.gamepad import command
from robofleet.gateways.gamepad.pads import ABS_Y, BTN_TR, EV_ABS, EV_KEY, EventPad
from tests.gateways.piped_pad import PipedDevice
from tests.operator.page.browser import chromium
from tests.operator.test_hand import GROUP, STUB, TELEOP
from tests.runs.realrun import CLOCK, RealRun
from tools.measure.program import program

_WITHIN_NS = 5 * S
Act = Callable[[bool], int]  # hold the button, or let it go; returns when that was


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


def until(statuses: Stream, turning: bool, since_ns: int) -> float:
    """Return how long it took until the first robot's gate let it turn, or stand [ms]; NaN: too long."""
    while CLOCK.now_ns() < since_ns + _WITHIN_NS:
        for at_ns, _, payload in statuses.drain():
            status = UNIT_STATUS.decode(payload)
            if status is not None and at_ns > since_ns:
                if turning and status.robots[0].left_output_rad_s:
                    return (at_ns - since_ns) / MS
                if not turning and not status.robots[0].left_output_rad_s:
                    return (at_ns - since_ns) / MS
        CLOCK.sleep_until(CLOCK.now_ns() + MS)
    return float("nan")


def main() -> None:
    arguments = program(__doc__, times=20, page=(False, "by the operator's page, in Chromium")).parse_args()
    with tempfile.TemporaryDirectory() as name, ExitStack() as held:
        web = ["--web", "--no-browser"] if arguments.page else []
        alone = "tracker.source=truth", "drivers.robots_per_process=1"
        run = RealRun(Path(name), *web, *(word for override in alone for word in ("--set", override)), config=TELEOP)
        held.callback(run.clean_up)
        run.wait_until_running()
        config = load_config(run.folder / "config.yaml")
        bus = joined(config.arena.name, config.bus.endpoint, "operator", CLOCK, 60.0)
        held.callback(bus.close)
        statuses = bus.stream(key(config.arena.name, STATUS, "r1"), capacity=4096)
        if arguments.page:
            address = run.said.split("the operator's page: ")[1].split()[0]
            act = held.enter_context(page(address))
        else:
            act = held.enter_context(pad(config, bus))
        CLOCK.sleep_until(CLOCK.now_ns() + S)
        found = []
        for _ in range(arguments.times):
            went = until(statuses, True, act(True))
            CLOCK.sleep_until(CLOCK.now_ns() + S // 4)
            found.append((went, until(statuses, False, act(False))))
            CLOCK.sleep_until(CLOCK.now_ns() + S // 2)
    print(f"{'ms':<34}{'p50':>8}{'p90':>8}{'max':>8}")
    for what, times in zip(("held, to wheels that turn", "let go, to wheels at zero"), np.array(found).T, strict=True):
        p50, p90, most = np.percentile(times, (50, 90, 100))
        print(f"{what:<34}{p50:>8.0f}{p90:>8.0f}{most:>8.0f}")


if __name__ == "__main__":
    main()
