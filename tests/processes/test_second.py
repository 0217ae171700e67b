"""A process that is started by hand where one is at work already: it is refused and named, and nothing is disturbed."""

import json
from collections.abc import Callable

from tests.processes.realrun import ALONE, RealRun

Start = Callable[..., RealRun]


def test_a_second_of_each_process_is_refused_and_the_run_goes_on(real_run: Start) -> None:
    run = real_run(*ALONE)
    run.wait_until_running()
    (copy := run.folder.parent / "copy").mkdir()
    (copy / "config.yaml").write_text((run.folder / "config.yaml").read_text())
    for name, role, *more in (
        ("supervisor", "supervisor"), ("tracker", "tracker"), ("controller", "controller"), ("recorder", "recorder"),
        ("driver", "driver-r1", "--robots", "r1"),
    ):  # fmt: skip
        second = run.robofleet(name, str(copy / "config.yaml"), *more)
        (pid,) = [process.pid for process in run.children(name)]
        assert second.returncode == 2, (name, second.stderr)
        assert f"the arena platoon has a {role} already (process {pid}): end that one first" in second.stderr
    router = run.robofleet("router", str(copy / "config.yaml"))
    assert router.returncode == 2
    assert "bus.endpoint: " in router.stderr
    assert "in use" in router.stderr
    assert sorted(file.name for file in copy.iterdir()) == ["config.yaml"], "nothing is left half done"
    found = json.loads(run.robofleet("status", "--json").stdout)
    assert found["phase"] == "running"
    assert run.robofleet("hold").stdout == "ok\n"
    phases = dict.fromkeys(line.split()[0].strip(":") for line in run.said.splitlines())
    assert list(phases)[:4] == ["compiling", "starting", "arming", "running"]
    assert phases.keys() <= {"compiling", "starting", "arming", "running", "held"}, run.said


def test_a_bare_stop_stops_every_arena_wherever_it_was_started(real_run: Start) -> None:
    runs = [real_run(*ALONE, "--set", f"arena.name={name}", name=name) for name in ("lab", "hall")]
    for run in runs:
        run.wait_until_running()
    elsewhere = runs[0].folder.parent / "elsewhere"
    runs[0].environment["XDG_RUNTIME_DIR"] = str(elsewhere)  # another login, a service, cron
    stopped = runs[0].robofleet("stop")
    assert (stopped.returncode, stopped.stderr) == (0, "")
    lines = stopped.stdout.splitlines()
    assert [line.partition(": every robot has latched its gate")[0] for line in lines] == [
        "emergency stop of hall", "emergency stop of lab",
    ]  # fmt: skip
    for run in runs:
        assert run.ended(20) == 1
        assert run.summary["cause"].startswith("emergency stop (emergency stop requested)")
