"""A script that fails in real time: its robots stand at once, the run is held with a cause, another one goes on."""

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest

from robofleet.bus.keys import WISH, key
from robofleet.bus.messages import SCRIPT_WISH
from robofleet.core.clock import MS
from robofleet.recording.reading import read
from robofleet.recording.run import Recording, Run
from robofleet.safety.supervisor import Event
from tests.command import robofleet
from tests.runs.realrun import RealRun, own_folders, wait, was_busy

CONFIG = Path(__file__).parents[2] / "configs" / "script.yaml"
TARGET_MS, OUTPUT_MS = 230, 330  # after the newest wish's tick; the output follows along a ramp
WITHIN_S = 60.0
SCRIPT = """
import sys, time
import numpy as np
from robofleet import Fleet

def body(fleet, t):
{body}

with Fleet("script") as fleet:
    if fleet.phase == "hold":
        fleet.resume()
    for t in fleet.ticks():
        fleet.drive(np.tile([0.05, 0.4], (4, 1)))
        if t > 1.0:
            print("driving", flush=True)
            body(fleet, t)
"""


OWN = """
import json, time
import numpy as np
from robofleet import Fleet

late = True
with Fleet({config!r}, out={out!r}, settings=["tracker.source=truth"]) as fleet:
    fleet.go_to({{"r1": (-0.8, 0.5, 0)}})
    for t in fleet.ticks(1, resume=True):
        fleet.drive(np.tile([0.05, 0.4], (4, 1)))
        if late and t > 0.5:
            late = False
            time.sleep(1.0)
    fleet.keep(rounds=3)
print(json.dumps(fleet.summary))
"""


@pytest.mark.slow
def test_a_run_of_its_own_begins_and_ends_with_the_script_and_goes_on_after_it_was_late(
    alone_for_a_module: None, tmp_path: Path
) -> None:
    environment = own_folders(tmp_path)
    file = tmp_path / "own.py"
    file.write_text(OWN.format(config=str(CONFIG), out=str(tmp_path / "run")))
    command = [sys.executable, "-W", "error", str(file)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert (result["outcome"], result["cause"]) == ("completed", None)
    assert result["groups"]["script"]["kept"] == {"rounds": 3}
    assert result == json.loads((tmp_path / "run" / "summary.json").read_text())
    recording = read(tmp_path / "run")
    assert np.abs(Run(recording).items["left_rad_s"]).max() > 0.0
    assert Event.SCRIPT_SILENT in {event for event, *_ in stops(recording)}, "it was late, and held"
    assert "no arena has a run" in robofleet("status", env=environment).stderr


@pytest.mark.long
def test_a_run_of_its_own_ends_with_a_script_that_is_killed(alone_for_a_module: None, tmp_path: Path) -> None:
    environment, folder = own_folders(tmp_path), tmp_path / "run"
    file = tmp_path / "own.py"
    loop = "fleet.ticks():\n        print(t, flush=True)"
    source = OWN.format(config=str(CONFIG), out=str(folder)).replace("fleet.ticks(1, resume=True):", loop)
    file.write_text(source)
    script = subprocess.Popen([sys.executable, str(file)], stdout=subprocess.PIPE, text=True, env=environment)
    assert script.stdout is not None
    script.stdout.readline()
    script.kill()
    script.communicate()
    assert wait((folder / "report.html").exists, WITHIN_S)
    assert json.loads((folder / "summary.json").read_text())["outcome"] == "stopped"
    assert wait(lambda: not left(folder), WITHIN_S)


def left(folder: Path) -> list[str]:
    """Return what is left of a run's processes."""
    lines = (process.info["cmdline"] or [] for process in psutil.process_iter(["cmdline"]))
    return [" ".join(line) for line in lines if any(str(folder) in word for word in line)]


class Scripts:
    """A run, and the scripts that join it, one after the other."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.run = RealRun(folder, "--set", "tracker.source=truth", config=CONFIG)
        self._environment = own_folders(folder)
        self.count = 0
        self._started: list[subprocess.Popen[str]] = []

    def start(self, body: str) -> "subprocess.Popen[str]":
        """Start a script and wait until it has driven for a second."""
        self.count += 1
        file = self._folder / f"script{self.count}.py"
        file.write_text(SCRIPT.format(body="".join(f"    {line}\n" for line in body.splitlines())))
        with (self._folder / f"script{self.count}.stderr").open("w") as errors:
            script = subprocess.Popen(
                [sys.executable, str(file)], stdout=subprocess.PIPE, stderr=errors, text=True, env=self._environment
            )
        self._started.append(script)
        assert script.stdout is not None
        assert script.stdout.readline() == "driving\n", self.errors
        return script

    def clean_up(self) -> None:
        for script in self._started:
            script.kill()
            script.communicate()
        self.run.clean_up()

    @property
    def errors(self) -> str:
        return (self._folder / f"script{self.count}.stderr").read_text()

    def status(self) -> str:
        return self.run.asked("status", "--json").stdout

    def held(self, cause: str) -> int:
        """Return how many times the run has been held by a cause; its terminal names the group, too."""
        return self.run.said.count(f"\nheld: {cause.replace('its group', 'its group script')}")


@pytest.fixture(scope="module")
def scripts(alone_for_a_module: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scripts]:
    scripts = Scripts(tmp_path_factory.mktemp("scripts"))
    try:
        scripts.run.wait_until_running()
        yield scripts
    finally:
        scripts.clean_up()


def stops(recording: Recording) -> list[tuple[Event, float, float]]:
    """Return of each hold its cause, and from the newest wish's tick to zero targets and to zero outputs [ms]."""
    arena = recording.config.arena.name
    run = Run(recording, every_tick=True)
    ticks = dict(zip(run.ticks["tick"].tolist(), run.ticks["stamp_ns"].tolist(), strict=True))
    failed = run.items["failed"][:, 0]
    found = []
    for k in np.flatnonzero((failed > 0) & (np.roll(failed, 1) == 0)).tolist():
        newest = run.group_figures[0].figures["wish"][k, 0]
        setpoints = [SCRIPT_WISH.decode_head(p) for p in recording.messages[key(arena, WISH, "script")]]
        epoch = run.group_figures[0].figures["wish_epoch"][k, 0]
        wish = next(w for w in setpoints if w is not None and (w.epoch, w.seq) == (epoch, newest))
        since_ns = ticks[wish.echo_tick]
        assert not np.abs(run.items["left_rad_s"][k:][:3]).any()  # what is commanded from that tick on
        target_ms = (int(run.ticks["stamp_ns"][k]) + int(run.ticks["lateness_ns"][k]) - since_ns) / MS
        output_ms = (
            max(
                int(rows["stamp_ns"][(rows["stamp_ns"] > since_ns) & (rows["left_output_rad_s"] == 0.0)][0]) - since_ns
                for rows in run.statuses
            )
            / MS
        )
        found.append((Event(int(failed[k])), target_ms, output_ms))
    return found


CASES: dict[str, tuple[str, Callable[["subprocess.Popen[str]"], object], Event]] = {
    "killed": ("pass", lambda script: script.kill(), Event.SCRIPT_SILENT),
    "stopped as in a debugger": ("pass", lambda script: script.send_signal(signal.SIGSTOP), Event.SCRIPT_SILENT),
    "hangs": ("time.sleep(1000)", lambda _: None, Event.SCRIPT_SILENT),
    "raises": ("raise RuntimeError('no solution')", lambda _: None, Event.SCRIPT_FAILED),
    "sends at 1 kHz, then dies": (
        "end = time.monotonic() + 2\nwhile time.monotonic() < end:\n"
        "    fleet.drive(np.tile([0.05, -0.4], (4, 1)))\n    time.sleep(0.001)\nimport os; os._exit(1)",
        lambda _: None,
        Event.SCRIPT_SILENT,
    ),
}  # fmt: skip
WORDS = {
    Event.SCRIPT_SILENT: "r1: the behaviour of its group no longer hears from its script",
    Event.SCRIPT_FAILED: "r1: the behaviour of its group has lost its script: it ended by an error",
}


FAST = "killed", "raises"  # one of each event; what else is silent is silent alike


@pytest.mark.slow
@pytest.mark.parametrize(
    "case", [case if case in FAST else pytest.param(case, marks=pytest.mark.long) for case in CASES]
)
def test_its_robots_stand_at_once_the_run_is_held_and_another_script_goes_on(scripts: Scripts, case: str) -> None:
    body, strike, event = CASES[case]
    before, held = len(stops(read(scripts.run.folder))), scripts.held(WORDS[event])
    script = scripts.start(body)
    strike(script)
    assert wait(lambda: scripts.held(WORDS[event]) > held, WITHIN_S), scripts.run.said
    found = json.loads(scripts.status())
    assert found["phase"] == "hold" and WORDS[event] in found["cause"]
    script.kill()
    script.wait()
    if event is Event.SCRIPT_FAILED:
        assert "RuntimeError: no solution" in scripts.errors
    (stop,) = stops(read(scripts.run.folder))[before:]
    print(case, stop)
    assert stop[0] is event
    if not was_busy(scripts.run.said):
        assert stop[1] <= TARGET_MS
        assert stop[2] <= OUTPUT_MS


@pytest.mark.slow
def test_a_script_that_ends_well_leaves_a_run_that_goes_on_with_robots_that_stand(scripts: Scripts) -> None:
    before = len(stops(read(scripts.run.folder)))
    script = scripts.start("sys.exit()")
    assert script.wait(WITHIN_S) == 0, scripts.errors
    run = Run(read(scripts.run.folder))
    assert wait(lambda: stands(scripts.run.folder), WITHIN_S)
    assert json.loads(scripts.status())["phase"] == "running"
    assert len(stops(read(scripts.run.folder))) == before
    assert np.abs(run.items["left_rad_s"]).max() > 0.0


def stands(folder: Path) -> bool:
    return all(not rows["left_output_rad_s"][-1] for rows in Run(read(folder), every_tick=True).statuses)
