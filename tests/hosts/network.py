"""Hosts in network namespaces of their own, joined by a switch: each has its own files, keys and address."""

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from tests.runs.realrun import own_folders

_NUMBER = 77  # of the private network 10.77.0.0/24, which nothing outside the namespaces sees


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True, timeout=20)


def unavailable() -> str:
    """Return why this machine makes no namespaces; empty where it does."""
    probe = f"rf{os.getpid()}probe"
    try:
        _ip("netns", "add", probe)
        _ip("netns", "del", probe)
    except (OSError, subprocess.SubprocessError) as error:
        reason = getattr(error, "stderr", "") or str(error)
        return f"NO NAMESPACES: {reason.strip().splitlines()[-1] if reason.strip() else 'ip netns does not work'}"
    return ""


class Host:
    """One computer."""

    def __init__(self, name: str, namespace: str, port: str, address: str, folder: Path, runtime: Path | None) -> None:
        self.name, self.namespace, self.port, self.address, self.folder = name, namespace, port, address, folder
        folder.mkdir()
        self.environment = own_folders(folder) | {"XDG_CONFIG_HOME": str(folder / "config")}
        if runtime is not None:
            self.environment["XDG_RUNTIME_DIR"] = str(runtime)

    def command(self, *words: str) -> list[str]:
        """Return what runs a program on this host."""
        return ["ip", "netns", "exec", self.namespace, *words]

    def robofleet(self, *words: str, within_s: float = 60) -> "subprocess.CompletedProcess[str]":
        """Run robofleet here to its end."""
        command = self.command(sys.executable, "-W", "error", "-m", "robofleet", *words)
        return subprocess.run(
            command, env=self.environment, capture_output=True, text=True, timeout=within_s, check=False
        )

    def begin(self, *words: str, log: Path) -> "subprocess.Popen[bytes]":
        """Start robofleet here."""
        command = self.command(sys.executable, "-W", "error", "-m", "robofleet", *words)
        with log.open("wb") as log_file:
            return subprocess.Popen(
                command, env=self.environment, stdin=subprocess.DEVNULL, stdout=log_file, stderr=log_file
            )


class Network:
    """Hosts at one switch; those ``alone`` have no robot's port. All traffic stays inside."""

    def __init__(self, folder: Path, names: Sequence[str], alone: Sequence[str] = ()) -> None:
        self._alone = alone
        self._prefix = f"rf{os.getpid()}"
        self._switch = f"{self._prefix}sw"
        self._made = [self._switch]
        _ip("netns", "add", self._switch)
        _ip("-n", self._switch, "link", "add", "br0", "type", "bridge")
        _ip("-n", self._switch, "link", "set", "br0", "up")
        runtime = folder / "runtime"
        runtime.mkdir(mode=0o700)
        self.hosts = {name: self._host(name, number, folder, runtime) for number, name in enumerate(names, start=1)}

    def _host(self, name: str, number: int, folder: Path, runtime: Path) -> Host:
        namespace, port, address = f"{self._prefix}{name}", f"v{number}", f"10.{_NUMBER}.0.{number}"
        _ip("netns", "add", namespace)
        self._made.append(namespace)
        _ip("-n", self._switch, "link", "add", port, "type", "veth", "peer", "name", "eth0", "netns", namespace)
        _ip("-n", self._switch, "link", "set", port, "master", "br0", "up")
        _ip("-n", namespace, "link", "set", "lo", "up")
        _ip("-n", namespace, "link", "set", "eth0", "up")
        _ip("-n", namespace, "address", "add", f"{address}/24", "dev", "eth0")
        # Twins answer on pseudo-terminals in the laboratory's folder: those of the robots' ports.
        return Host(name, namespace, port, address, folder / name, runtime if name not in self._alone else None)

    def __getitem__(self, name: str) -> Host:
        """Return a host."""
        return self.hosts[name]

    @contextmanager
    def cut(self, name: str) -> Iterator[None]:
        """Let nothing pass between a host and the switch."""
        port = self.hosts[name].port
        _ip("-n", self._switch, "link", "set", port, "down")
        try:
            yield
        finally:
            _ip("-n", self._switch, "link", "set", port, "up")

    def packets(self, name: str) -> tuple[int, int]:
        """Return how many packets a host has received and sent."""
        counters = [
            subprocess.run(
                self.hosts[name].command("cat", f"/sys/class/net/eth0/statistics/{way}_packets"),
                check=True, capture_output=True, text=True, timeout=20,
            ).stdout
            for way in ("rx", "tx")
        ]  # fmt: skip
        return int(counters[0]), int(counters[1])

    def close(self) -> None:
        """Remove everything."""
        for namespace in reversed(self._made):
            subprocess.run(["ip", "netns", "del", namespace], check=False, capture_output=True, timeout=20)
