"""Figures of a laboratory whose robots have computers of their own, in network namespaces, by root:

    python -m tools.measure.hosts.laboratory lap
    python -m tools.measure.hosts.laboratory radio bursts --laps 20
    python -m tools.measure.hosts.laboratory cut 0.2 1 10 60
    python -m tools.measure.hosts.laboratory laboratory
    python -m tools.measure.hosts.laboratory stop --times 100

Each prints one JSON object. All traffic stays inside the namespaces, and a run is bounded in time.
"""

import argparse
import json
import re
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from robofleet.bus.keys import STATE, STATUS, key
from robofleet.bus.messages import RUN_STATE, UNIT_STATUS
from robofleet.core.clock import MS, S, WallClock
from robofleet.recording.reading import read
from robofleet.recording.run import Recording
from robofleet.safety.latches import GateStatus
from robofleet.safety.supervisor import Event, Phase
from tests.hosts.fleet import ALONE, PORT, Fleet, configuration, ended, join, said
from tests.hosts.network import Network
from tests.recording.recorded import in_order
from tests.runs.realrun import wait
from tools.measure.hosts.radio import PATTERNS

ROBOTS = "r1", "r2", "r3", "r4"
RADIO = "air"
CLOCK = WallClock()
_LAP_S = 24.0
_ARMED_S = 120
_TRUTH = "--set", "tracker.source=truth"


@contextmanager
def laboratory(pattern: str | None = None, seed: int = 1) -> Iterator[tuple[Network, ExitStack]]:
    """Make the hosts, and let them join; ``pattern``: of the radio that is between the robots and the router."""
    with tempfile.TemporaryDirectory(prefix="rf") as folder, ExitStack() as stack:
        others = ALONE if pattern is None else (*ALONE, RADIO)
        network = Network(Path(folder), ["lab", *others, *ROBOTS], others)
        stack.callback(network.close)
        join(network, ROBOTS, None if pattern is None else RADIO)
        if pattern is not None:
            air = network[RADIO]
            words = sys.executable, "-m", "tools.measure.hosts.radio", f"{air.address}:{PORT}"
            radio = subprocess.Popen(
                air.command(*words, f"{network['lab'].address}:{PORT}", pattern, "--seed", str(seed))
            )
            stack.callback(radio.wait)
            stack.callback(radio.kill)
        yield network, stack


def begun(fleet: Fleet, run: "subprocess.Popen[bytes]", name: str) -> None:
    """Wait until a run drives."""
    assert wait(lambda: fleet.phase() == "running" or run.poll() is not None, _ARMED_S), fleet.log(name)
    assert run.poll() is None, fleet.log(name)


def summary(network: Network, name: str) -> dict[str, Any]:
    """Return what a run says of itself."""
    found = json.loads((network["lab"].folder / name / "summary.json").read_text())
    return {
        "outcome": found["outcome"], "cause": found["cause"],
        "control_error_mm": found["control_error_mm"]["mean"],
        "exposure_to_wheel_ms": found["latency_ms"]["exposure_to_wheel"],
    }  # fmt: skip


def closed(recording: Recording) -> dict[str, Any]:
    """Return how often a gate was closed while the fleet ran, why and how long, and how often the run was held.

    A closed gate slows its wheels as fast as they may be slowed: the robot has ``stopped`` where they came to rest.
    """
    arena = recording.config.arena.name
    units = {key(arena, STATUS, unit): unit for unit in recording.config.units}
    phase, began = Phase.IDLE, dict[str, int]()
    newest, last_ns = dict[str, GateStatus](), dict[str, int]()
    why: Counter[str] = Counter()
    lasted_ms: list[float] = []
    held: Counter[str] = Counter()
    stopped: set[tuple[str, int]] = set()  # unit, and when its gate closed
    running_ns, hurried, statuses = 0, 0, 0
    for full, payload in in_order(recording):
        if full == key(arena, STATE) and (state := RUN_STATE.decode(payload)) is not None:
            if state.phase != phase and state.phase == Phase.HOLD:
                held[Event(state.cause).name] += 1
            phase = Phase(state.phase)
        elif full in units and (status := UNIT_STATUS.decode(payload)) is not None:
            unit, gate = units[full], GateStatus(status.robots[0].gate)
            if phase is Phase.RUNNING:
                statuses, hurried = statuses + 1, hurried + status.hurry
                running_ns += max(0, status.stamp_ns - last_ns.get(unit, status.stamp_ns))
                if gate is not GateStatus.OPEN and newest.get(unit) is GateStatus.OPEN:
                    why[gate.name] += 1
                    began[unit] = status.stamp_ns
                robot = status.robots[0]
                if (
                    gate is not GateStatus.OPEN
                    and unit in began
                    and robot.left_output_rad_s == robot.right_output_rad_s == 0.0
                ):
                    stopped.add((unit, began[unit]))
            if gate is GateStatus.OPEN and unit in began:
                lasted_ms.append((status.stamp_ns - began.pop(unit)) / MS)
            last_ns[unit], newest[unit] = status.stamp_ns, gate
    hours = running_ns / S / 3600
    return {
        "robot_hours": round(hours, 3), "gates_closed": dict(why), "stopped": len(stopped),
        "closed_ms": {str(q): round(float(np.percentile(lasted_ms, q))) for q in (50, 90, 100)} if lasted_ms else None,
        "closed_per_robot_hour": round(sum(why.values()) / hours, 2) if hours else None, "held": dict(held),
        "told_to_hurry": round(hurried / statuses, 3) if statuses else None,
    }  # fmt: skip


def lap() -> dict[str, Any]:
    """One lap through the rendered camera, with the page open on a host of its own."""
    with laboratory() as (network, stack):
        lab, phone = network["lab"], network["phone"]
        said(lab, "keys", "add", "platoon", "web", "--address", lab.address)
        file = configuration(network, *ROBOTS)
        fleet = Fleet(network, ROBOTS, stack)
        run = fleet.run(file, "lap", "--web-host", lab.address)
        begun(fleet, run, "lap")
        (address,) = re.findall(r"for a viewer: (\S+)", fleet.log("lap"))
        authority = phone.folder / "config" / "robofleet" / "keys" / "platoon" / "authority.pem"
        looking = phone.command(sys.executable, "-m", "tools.measure.hosts.visitor", address, str(authority), "60")
        page = subprocess.Popen(looking, stdout=subprocess.PIPE, text=True)
        stack.callback(page.kill)
        daemons = {robot: psutil.Process(fleet.daemons[robot].pid) for robot in ROBOTS}
        daemons = {robot: next(iter(process.children()), process) for robot, process in daemons.items()}
        before = {robot: (network.packets(robot), sum(daemons[robot].cpu_times()[:2])) for robot in ROBOTS}
        began_ns = CLOCK.now_ns()
        CLOCK.sleep_until(began_ns + 15 * S)
        took_s = (CLOCK.now_ns() - began_ns) / S
        used = {}
        for robot, (packets, cpu) in before.items():
            from_robot, here = (
                round((b - a) / took_s, 1) for a, b in zip(packets, network.packets(robot), strict=True)
            )
            own = daemons[robot]
            used[robot] = {
                "to_it_per_s": from_robot, "from_it_per_s": here,
                "cpu_percent": round(100 * (sum(own.cpu_times()[:2]) - cpu) / took_s, 1),
                "memory_mb": round(own.memory_info().rss / 1e6, 1),
                "own_memory_mb": round(own.memory_full_info().uss / 1e6, 1),
            }  # fmt: skip
        assert run.wait(120) is not None
        shown = json.loads(page.communicate(timeout=30)[0] or "{}")
        recording = read(lab.folder / "lap")
        return {**summary(network, "lap"), **closed(recording), "page": shown, "daemons": used}


def radio(pattern: str, laps: int, seed: int) -> dict[str, Any]:
    """Laps over a radio that loses and delays packets; a hold is resumed, and counted."""
    with laboratory(pattern, seed) as (network, stack):
        file = configuration(network, *ROBOTS, duration_s=laps * _LAP_S)
        fleet = Fleet(network, ROBOTS, stack)
        run = fleet.run(file, "radio", *_TRUTH)
        begun(fleet, run, "radio")
        before, began_ns = {robot: network.packets(robot) for robot in ROBOTS}, CLOCK.now_ns()
        while run.poll() is None and CLOCK.now_ns() - began_ns < 2 * laps * _LAP_S * S:
            if fleet.phase() == "hold":
                network["desk"].robofleet("resume")
            wait(lambda: run.poll() is not None, 2)
        took_s = (CLOCK.now_ns() - began_ns) / S
        packets = [
            (after - start) / took_s
            for robot, counts in before.items()
            for start, after in zip(counts, network.packets(robot), strict=True)
        ]
        if run.poll() is None:
            run.send_signal(signal.SIGINT)
            run.wait(60)
        found = closed(read(network["lab"].folder / "radio"))
        both = sum(packets) / len(ROBOTS)
        return {"pattern": pattern, "laps": laps, **summary(network, "radio"), **found, "packets_per_s": round(both)}


def cut(seconds: list[float]) -> list[dict[str, Any]]:
    """One robot's link is away for some time, again and again in one run; then a driver that is killed."""
    with laboratory() as (network, stack):
        file = configuration(network, *ROBOTS, duration_s=sum(seconds) + 60.0 * (len(seconds) + 1))
        fleet = Fleet(network, ROBOTS, stack)
        run = fleet.run(file, "cut", *_TRUTH)
        begun(fleet, run, "cut")
        found = []
        for away_s in seconds:
            with network.cut("r2"):
                CLOCK.sleep_until(CLOCK.now_ns() + round(away_s * S))
            found.append({"cut_s": away_s, **_back(network, fleet)})
        fleet.end("r2", signal.SIGKILL)
        CLOCK.sleep_until(CLOCK.now_ns() + S)
        fleet.begin("r2")
        found.append({"cut_s": "driver killed, begun again a second later", **_back(network, fleet)})
        run.send_signal(signal.SIGINT)
        run.wait(60)
        stopped = _stopped_ms(read(network["lab"].folder / "cut"), "r2")
        return [
            {**figures, "zero_after_nonce_ms": ms} for figures, ms in zip(found, stopped + [None] * 9, strict=False)
        ]


def _back(network: Network, fleet: Fleet) -> dict[str, Any]:
    """Resume as soon as that can be; returns how long the fleet stood after the link was back."""
    began_ns, resumes = CLOCK.now_ns(), 0
    while fleet.phase() != "running" and CLOCK.now_ns() - began_ns < 60 * S:
        resumes += network["desk"].robofleet("resume").stdout.startswith("ok")
    return {"drives_after_s": round((CLOCK.now_ns() - began_ns) / S, 2), "resumes": resumes}


def _stopped_ms(recording: Recording, unit: str) -> list[float]:
    """Return how old a gate's newest nonce was whenever it closed, by what its next status says."""
    rows = recording.of_robot(STATUS, unit)
    gaps = [
        (before, after)
        for before, after in pairwise(rows)
        if after["stamp_ns"] - before["stamp_ns"] > 150 * MS and after["boot_id"] == before["boot_id"]
    ]
    return [round(float(after["target_after_ns"]) / MS, 1) for _, after in gaps]


def laboratory_dies() -> dict[str, Any]:
    """Kill all that the laboratory's computer runs, the router too, and start a run again: the robots come back."""
    with laboratory() as (network, stack):
        file = configuration(network, *ROBOTS, duration_s=300.0)
        fleet = Fleet(network, ROBOTS, stack)
        run = fleet.run(file, "first", *_TRUTH)
        begun(fleet, run, "first")
        processes = [psutil.Process(run.pid), *psutil.Process(run.pid).children(recursive=True)]
        twins = [process for process in processes if "twins" in process.cmdline()]  # they are the robots
        for process in processes:
            if process not in twins:
                process.kill()
        CLOCK.sleep_until(CLOCK.now_ns() + S)
        for process in twins:
            process.kill()
        run.wait(20)
        live, began_ns = all(daemon.poll() is None for daemon in fleet.daemons.values()), CLOCK.now_ns()
        again = fleet.run(file, "second", *_TRUTH, "--reset")
        begun(fleet, again, "second")
        drives_s = (CLOCK.now_ns() - began_ns) / S
        again.send_signal(signal.SIGINT)
        again.wait(60)
        recording = read(network["lab"].folder / "second")
        stood = {robot: recording.of_robot(STATUS, robot)[0]["target_after_ns"] / MS for robot in ROBOTS}
        return {"daemons_live": live, "drives_after_start_s": round(drives_s, 1), "zero_after_nonce_ms": stood}


def stop(times: int, driving: int) -> dict[str, Any]:
    """Emergency stops from the operator's host: of robots that wait, reset after each, and of some that drive."""
    with laboratory() as (network, stack):
        lab, file = network["lab"], configuration(network, *ROBOTS, duration_s=300.0)
        fleet = Fleet(network, ROBOTS, stack)
        took: dict[str, list[float]] = {"waiting": [], "driving": []}
        failed = []

        def stopped(robots: str) -> None:
            answer = network["desk"].robofleet("stop")
            if answer.returncode == 0:
                took[robots].append(float(answer.stdout.rsplit("after ", 1)[1].split()[0]))
            else:
                failed.append(answer.stderr)

        desk, names = network["desk"], ("router", "twins", "supervisor")  # one by one: no launcher ends at a stop
        alone = [lab.begin(process, str(file), log=lab.folder / f"{process}.log") for process in names]
        for process in alone:
            stack.callback(ended, process)
        assert wait(lambda: desk.robofleet("reset").stdout.startswith("ok"), 60)
        for _ in range(times):
            stopped("waiting")
            assert wait(lambda: desk.robofleet("reset").stdout.startswith("ok"), 20)
        for process in reversed(alone):
            ended(process)
        for number in range(driving):
            run = fleet.run(file, f"stop{number}", *_TRUTH, "--reset")
            begun(fleet, run, f"stop{number}")
            stopped("driving")
            run.wait(60)
        figures = {
            robots: {"times": len(ms), "median_ms": float(np.median(ms)), "worst_ms": max(ms)}
            for robots, ms in took.items()
            if ms
        }
        return {**figures, "failed": failed}


def main() -> None:
    """Measure what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    what = parser.add_subparsers(dest="what", required=True)
    what.add_parser("lap")
    air = what.add_parser("radio")
    air.add_argument("pattern", choices=PATTERNS)
    air.add_argument("--laps", type=int, default=20)
    air.add_argument("--seed", type=int, default=1)
    what.add_parser("cut").add_argument("seconds", type=float, nargs="+")
    what.add_parser("laboratory")
    stops = what.add_parser("stop")
    stops.add_argument("--times", type=int, default=100)
    stops.add_argument("--driving", type=int, default=0)
    arguments = parser.parse_args()
    found: dict[str, Callable[[], Any]] = {
        "lap": lap, "radio": lambda: radio(arguments.pattern, arguments.laps, arguments.seed),
        "cut": lambda: cut(arguments.seconds),
        "laboratory": laboratory_dies, "stop": lambda: stop(arguments.times, arguments.driving),
    }  # fmt: skip
    print(json.dumps(found[arguments.what](), indent=1))


if __name__ == "__main__":
    main()
