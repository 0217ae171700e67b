"""What a laboratory with robots of their own computers does: joins them once, and runs."""

import signal
import subprocess
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from tests.command import robofleet
from tests.hosts.network import Host, Network
from tests.runs.realrun import PLATOON, newest, wait

PORT = 7447
ALONE = "desk", "phone"
OPERATOR, VIEWER = "alice", "bob"


def join(network: Network, robots: tuple[str, ...], radio: str | None = None) -> None:
    """Do what a laboratory does once: an authority, certificates, and a bundle for each host.

    ``radio``: the host by which the robots reach the router; None: they reach it themselves.
    """
    lab = network["lab"]
    kept(lab, "keys", "init", "platoon")
    reached = [lab.address] if radio is None else [lab.address, network[radio].address]
    kept(lab, "keys", "add", "platoon", "router", *(word for address in reached for word in ("--address", address)))
    who = {**{robot: (robot, "unit") for robot in robots}, "desk": (OPERATOR, "operator"), "phone": (VIEWER, "viewer")}
    for host, (name, kind) in who.items():
        kept(lab, "keys", "add", "platoon", name, "--kind", kind)
        file = lab.folder / f"{name}.bundle"
        router = f"quic/{reached[-1] if host in robots else lab.address}:{PORT}"
        kept(lab, "keys", "bundle", "platoon", name, "--router", router, "--out", str(file))
        assert "the keys of" in kept(network[host], "join", str(file))


def kept(host: Host, *words: str) -> str:
    """Return what a command says that only reads and writes a host's files: it runs in this process."""
    done = robofleet(*words, env=host.environment)
    assert done.exit_code == 0, done.stderr
    return done.stdout


def said(host: Host, *words: str) -> str:
    """Return what a command says that must succeed."""
    done = host.robofleet(*words)
    assert done.returncode == 0, done.stderr
    return done.stdout


def configuration(network: Network, *robots: str, **run: Any) -> Path:
    """Write the configuration of a laboratory whose robots are at these hosts."""
    tree = yaml.safe_load(PLATOON.read_text())
    tree["robots"] = [robot | {"driver": "gternal", "twin": "gternal", "unit": robot["id"]} for robot in tree["robots"]]
    tree["robots"] = [robot for robot in tree["robots"] if robot["id"] in robots]
    tree["groups"][0]["robots"] = list(robots)
    tree["drivers"] = {"started_by": "daemon"}
    tree["bus"] = {"listen": [f"quic/{network['lab'].address}:{PORT}"]}
    tree["run"] = {**tree["run"], **run}
    file = network["lab"].folder / "lab.yaml"
    file.write_text(yaml.safe_dump(tree))
    return file


class Fleet:
    """Daemons that wait on their hosts, and one run after the other."""

    def __init__(self, network: Network, robots: tuple[str, ...], stack: ExitStack) -> None:
        self.network, self._stack = network, stack
        self.logs = {robot: network[robot].folder / "driver.log" for robot in robots}
        self.daemons: dict[str, subprocess.Popen[bytes]] = {}
        for robot in robots:
            self.begin(robot)

    def begin(self, robot: str) -> None:
        """Start a robot's driver."""
        self.daemons[robot] = self.network[robot].begin("node", "driver", "--unit", robot, log=self.logs[robot])
        self._stack.callback(ended, self.daemons[robot])

    def end(self, robot: str, number: signal.Signals) -> None:
        """End a robot's driver by a signal."""
        self.daemons[robot].send_signal(number)
        self.daemons[robot].wait(20)

    def run(self, file: Path, name: str, *words: str) -> "subprocess.Popen[bytes]":
        """Start a run in the laboratory; its folder has this name."""
        lab = self.network["lab"]
        run = lab.begin("run", str(file), "--out", str(lab.folder / name), *words, log=lab.folder / f"{name}.log")
        self._stack.callback(ended, run)
        return run

    def drive(self, file: Path, name: str, *words: str) -> tuple["subprocess.Popen[bytes]", str]:
        """Start a run that drives; returns it and its folder's name.

        A firmware's twin is a process here: where a busy machine does not run it for a while, its robot stops late, and
        the checks before the start rightly refuse a robot that travels further than it should. Then it is started anew.
        """
        for attempt in ("", "-2", "-3"):
            run, run_name = self.run(file, name + attempt, *words, *(["--reset"] if attempt else [])), name + attempt
            log = partial(self.log, run_name)
            assert wait(
                lambda run=run, run_name=run_name: self.tells(run_name, "running") or run.poll() is not None, 150
            ), log()
            if run.poll() is None:
                return run, run_name
            assert "it travels" in log(), log()
        raise AssertionError("three starts were refused")

    def phase(self) -> str:
        """Return where the run is, as the laboratory sees it."""
        found = self.network["lab"].robofleet("status", "--json")
        return str(yaml.safe_load(found.stdout)["phase"]) if found.returncode == 0 else ""

    def tells(self, name: str, where: str) -> bool:
        """Return whether the newest that a run says is that it is there: a look at its log costs nothing."""
        return newest(self.log(name)).startswith(where)

    def log(self, name: str) -> str:
        """Return what a run said."""
        return (self.network["lab"].folder / f"{name}.log").read_text()


def ended(process: "subprocess.Popen[bytes]") -> None:
    """End a process, if it is still there."""
    if process.poll() is None:
        process.terminate()
        process.wait(20)
