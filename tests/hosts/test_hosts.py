"""Robots with computers of their own: real namespaces, certificates, links and firmware's twins."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
import yaml

from robofleet.bus.keys import STATUS
from robofleet.recording.reading import read
from robofleet.safety.latches import Latch
from tests.hosts.fleet import ALONE, Fleet, configuration, ended, join, said
from tests.hosts.network import Network, unavailable
from tests.runs.realrun import wait, was_busy


@pytest.fixture
def network(alone: None, tmp_path: Path) -> Iterator[Callable[..., Network]]:
    if why := unavailable():
        pytest.skip(why)
    with ExitStack() as stack:

        def made(*robots: str) -> Network:
            network = Network(tmp_path, ["lab", *ALONE, *robots], ALONE)
            stack.callback(network.close)
            join(network, robots)
            return network

        yield made


@pytest.mark.slow
def test_two_runs_on_robots_that_wait_and_an_operator_a_viewer_and_a_cut_link(
    network: Callable[..., Network],
) -> None:
    robots = "r1", "r2"
    net = network(*robots)
    file = configuration(net, *robots, duration_s=300.0)
    with ExitStack() as stack:
        fleet = Fleet(net, robots, stack)
        run, name = fleet.drive(file, "first", "--set", "tracker.source=truth")

        hosts = yaml.safe_load(said(net["lab"], "hosts", "--json"))["units"]
        assert [host["unit"] for host in hosts] == list(robots)
        assert all(host["certificate_ends"] and host["round_trip_ms"] and host["loss"] < 0.5 for host in hosts)

        seen = yaml.safe_load(said(net["phone"], "hosts", "--json"))["units"]
        assert [host["unit"] for host in seen] == list(robots)
        assert all(host["state"] == "drives" and host["round_trip_ms"] for host in seen)

        assert net["phone"].robofleet("hold").stdout.startswith("ok")
        assert wait(lambda: fleet.tells(name, "held: hold requested"), 20), fleet.log(name)
        assert fleet.phase() == "hold"
        refused = net["phone"].robofleet("resume")
        assert refused.returncode == 1
        assert fleet.phase() == "hold"
        assert net["desk"].robofleet("resume").stdout.startswith("ok")
        assert wait(lambda: fleet.tells(name, "running"), 20), fleet.log(name)

        with net.cut("r2"):
            assert wait(lambda: fleet.tells(name, "held"), 20), "a robot that nobody reaches does not stop the run"
        assert wait(lambda: net["desk"].robofleet("resume").stdout.startswith("ok"), 30)
        assert wait(lambda: fleet.tells(name, "running"), 20), "a robot whose link is back drives again"

        stopped = net["desk"].robofleet("stop")
        acknowledged = stopped.stdout.startswith("emergency stop of platoon: every robot acknowledged")
        assert acknowledged or was_busy(fleet.log(name)), stopped.stderr
        assert wait(lambda: run.poll() is not None, 60)
        recording = read(net["lab"].folder / name)
        assert all(recording.of_robot(STATUS, robot)["latch"].max() >= Latch.EMERGENCY_STOP for robot in robots)

        again, name = fleet.drive(file, "again", "--set", "tracker.source=truth", "--reset", "--duration", "4")
        assert again.wait(100) == 0, fleet.log(name)
        assert all(daemon.poll() is None for daemon in fleet.daemons.values())


@pytest.mark.long
def test_a_robot_refuses_what_its_own_file_does_not_allow_and_the_run_says_so(network: Callable[..., Network]) -> None:
    net = network("r1")
    own = net["r1"].folder / "config" / "robofleet" / "robot.yaml"
    own.write_text(own.read_text().replace("allows: {}", "allows: {max_wheel_speed_rad_s: 5.0}"))
    file = configuration(net, "r1", duration_s=1.0)
    with ExitStack() as stack:
        fleet = Fleet(net, ("r1",), stack)
        run = fleet.run(file, "run", "--set", "tracker.source=truth")
        assert run.wait(150) == 1
        assert "robot.yaml on this robot does not allow wheels of 12.5 rad/s (allowed: 5)" in fleet.log("run")


@pytest.mark.long
def test_a_router_that_stays_shows_robots_that_wait_and_shuts_out_who_is_revoked(
    network: Callable[..., Network],
) -> None:
    robots = "r1", "r2"
    net = network(*robots)
    lab = net["lab"]
    file = configuration(net, *robots, duration_s=1.0)
    tree = yaml.safe_load(file.read_text())
    tree["bus"]["router"] = "service"
    file.write_text(yaml.safe_dump(tree))

    refused = lab.robofleet("run", str(file), "--out", str(lab.folder / "too-early"))
    assert refused.returncode == 2
    assert "no router listens at" in refused.stderr
    with ExitStack() as stack:
        router = lab.begin("router", str(file), log=lab.folder / "router.log")
        stack.callback(ended, router)
        fleet = Fleet(net, robots, stack)

        def states() -> list[str]:
            found = lab.robofleet("hosts", str(file), "--json")
            return [host["state"] for host in yaml.safe_load(found.stdout)["units"]] if found.returncode == 0 else []

        assert wait(lambda: states() == ["waits", "waits"], 60), fleet.logs["r1"].read_text()
        run = fleet.run(file, "run", "--set", "tracker.source=truth")
        assert run.wait(150) == 0, fleet.log("run")
        assert states() == ["waits", "waits"]
        said(lab, "keys", "revoke", "platoon", "r2")
        assert wait(lambda: states() == ["waits", "silent"], 60), (lab.folder / "router.log").read_text()
        assert router.poll() is None
