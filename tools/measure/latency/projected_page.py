"""What a projector's page shows and costs: pictures a second, and what the run's processes take of the processors.

    python -m tools.measure.latency.projected_page --robots 20 --turns 3 --seconds 20

One real run without pixels, with its page's server, and a headless Chromium without a GPU, on the same processors.
Turns without and with the page of a projector of 1920 x 1080 and of 3840 x 2160 pixels. The processor time is that of
the run's own processes, the page's server among them, and not the browser's.
"""

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import psutil
from selenium.webdriver import Chrome

from robofleet.config.load import load_config
from robofleet.core.clock import S
from robofleet.projection.model import Projector
from robofleet.tracking.camera import CameraGeometry
from tests.operator.page.browser import chromium, show_as
from tests.runs.realrun import CLOCK, RealRun, wait
from tools.measure.program import program

SIZES = {"hd": (1920, 1080), "uhd": (3840, 2160)}
_SETTLED_NS = 3 * S
_WITHIN_S = 60.0
_TILT_RAD = 0.0873  # 5 degrees


def above(arena_m: tuple[float, float], name: str) -> dict[str, object]:
    """Return a calibrated projector, tilted by 5 degrees, whose picture is some larger than an arena."""
    width, height = SIZES[name]
    T, focal = np.eye(4), 0.8 * width
    c, s = np.cos(_TILT_RAD), np.sin(_TILT_RAD)
    T[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    high = 1.3 * focal * max(arena_m[0] / width, arena_m[1] / height)
    T[:3, 3] = 0.0, -high * np.tan(_TILT_RAD), high
    K = [[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]]
    optics = Projector(CameraGeometry(K, [-0.03, 0.01, 5e-4, -4e-4], T), (width, height)).model.model_dump(mode="json")
    return {"name": name, "width": width, "height": height, "calibration": {**optics, "delay_s": 0.05}}


def cpu_s(pid: int) -> float:
    """Return the processor time that a process and its children have taken, user and system [s]."""
    root = psutil.Process(pid)
    times = [process.cpu_times() for process in (root, *root.children(recursive=True))]
    return float(sum(taken.user + taken.system for taken in times))


def turn(run: RealRun, seconds: float) -> float:
    """Return which share of a processor a run takes, once it has settled [%]."""
    CLOCK.sleep_until(CLOCK.now_ns() + _SETTLED_NS)
    began_ns, before = CLOCK.now_ns(), cpu_s(run.launcher.pid)
    CLOCK.sleep_until(began_ns + round(seconds * S))
    return 100.0 * (cpu_s(run.launcher.pid) - before) * S / (CLOCK.now_ns() - began_ns)


def projected(browser: Chrome, run: RealRun, address: str, name: str, seconds: float) -> tuple[float, float, float]:
    """Return the run's share of a processor while a projector's page is open [%], the page's pictures a second, and the
    processor time that the browser takes for each [ms]."""
    show_as(browser, SIZES[name])
    browser.get(address.replace("/?", f"/projector?name={name}&"))
    pictures = "return window.robofleet?.state.pictures ?? 0"
    assert wait(lambda: browser.execute_script(pictures) > 5, _WITHIN_S), browser.execute_script(
        "return JSON.stringify(robofleet.state.words)"
    )
    began_ns, before, taken_s = CLOCK.now_ns(), browser.execute_script(pictures), cpu_s(_pid(browser))
    share = turn(run, seconds)
    shown, taken_s = browser.execute_script(pictures) - before, cpu_s(_pid(browser)) - taken_s
    rate = shown * S / (CLOCK.now_ns() - began_ns)
    browser.get("about:blank")
    return share, rate, 1e3 * taken_s / shown


def _pid(browser: Chrome) -> int:
    return int(browser.service.process.pid)


def main() -> None:
    arguments = program(__doc__, robots=20, turns=(3, "of each side"), seconds=(20.0, "of each turn")).parse_args()
    shares: dict[str, list[float]] = {name: [] for name in ("without", *SIZES)}
    rates: dict[str, list[float]] = {name: [] for name in SIZES}
    costs_ms: dict[str, list[float]] = {name: [] for name in SIZES}
    with tempfile.TemporaryDirectory() as name, chromium() as browser:
        folder = Path(name)
        file, tool = folder / "fleet.yaml", Path(__file__).parents[3] / "tools" / "large_fleet.py"
        subprocess.run([sys.executable, str(tool), str(arguments.robots), "--out", str(file)], check=True)
        for size in SIZES:  # two would light the same floor, each with half of the light
            projectors = [above(load_config(file).arena.size_m, size)]
            options = "--duration", "3600", "--web", "--no-browser", "--set", f"projectors={json.dumps(projectors)}"
            run = RealRun(folder, *options, config=file, name=size)
            try:
                run.wait_until_running()
                found = re.search(r"http://\S+", run.said)
                assert found is not None, run.said
                turn(run, arguments.seconds)  # what has just started takes less, or more
                for _ in range(arguments.turns):
                    shares["without"].append(turn(run, arguments.seconds))
                    share, rate, cost_ms = projected(browser, run, found[0], size, arguments.seconds)
                    shares[size].append(share)
                    rates[size].append(rate)
                    costs_ms[size].append(cost_ms)
                    assert run.launcher.poll() is None, run.said
            finally:
                run.clean_up()
    base = float(np.median(shares["without"]))
    print(f"{arguments.robots} robots, {arguments.turns} turns of {arguments.seconds:g} s of each side; medians")
    print(f"without a page: the run takes {base:.1f} % of a processor ({_spread(shares['without'])})")
    for size, (width, height) in SIZES.items():
        share = float(np.median(shares[size]))
        print(
            f"{width} x {height}: {np.median(rates[size]):.1f} pictures/s ({_spread(rates[size])}), "
            f"{np.median(costs_ms[size]):.0f} ms of the browser's processor time each; the run takes "
            f"{share:.1f} % ({_spread(shares[size])}), {100.0 * (share / base - 1.0):+.1f} % of what it took"
        )


def _spread(values: list[float]) -> str:
    return " ".join(f"{value:.1f}" for value in values)


if __name__ == "__main__":
    main()
