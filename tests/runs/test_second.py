"""A process that is started by hand where one is at work already: it is refused and named, and nothing is disturbed."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest
import zenoh

from tests.runs.realrun import ALONE, RealRun, wait

pytestmark = pytest.mark.long

Start = Callable[..., RealRun]


@contextmanager
def forged(endpoint: str, full: str, received: list[str]) -> Iterator[None]:
    """Say that nobody else need be asked, answer ok, and do nothing."""

    def answer(query: zenoh.Query) -> None:
        received.append("" if query.payload is None else query.payload.to_string())
        query.reply(query.key_expr, "ok")
        kept.append(query)  # it never ends

    kept: list[zenoh.Query] = []
    config = zenoh.Config()
    for name, value in (("mode", "client"), ("connect/endpoints", [endpoint])):
        config.insert_json5(name, json.dumps(value))
    session = zenoh.open(config)
    try:
        queryable = session.declare_queryable(full, zenoh.handlers.Callback(answer, indirect=False), complete=True)
        assert wait(lambda: [r for r in session.liveliness().get("rf/platoon/alive/supervisor/**") if r.ok], 5)
        yield
        queryable.undeclare()
    finally:
        session.close()  # type: ignore[no-untyped-call]


def test_a_second_of_each_process_is_refused_and_the_run_goes_on(real_run: Start) -> None:
    run = real_run(*ALONE)
    run.wait_until_running()
    before = {process.pid for process in run.children()}
    (copy := run.folder.parent / "copy").mkdir()
    (copy / "config.yaml").write_text((run.folder / "config.yaml").read_text())
    for name, role, *more in (
        ("supervisor", "supervisor"), ("tracker", "tracker"), ("controller", "controller"), ("recorder", "recorder"),
        ("driver", "driver-r1", "--robots", "r1"),
    ):  # fmt: skip
        second = run.robofleet("node", name, str(copy / "config.yaml"), *more)
        (pid,) = [process.pid for process in run.children(name)]
        assert second.returncode == 2, (name, second.stderr)
        assert f"the arena platoon has a {role} already (process {pid}): end that one first" in second.stderr
    router = run.robofleet("node", "router", str(copy / "config.yaml"))
    assert router.returncode == 2
    assert "bus.endpoint: " in router.stderr
    assert "in use" in router.stderr
    assert sorted(file.name for file in copy.iterdir()) == ["config.yaml"], "nothing is left half done"
    found = json.loads(run.robofleet("status", "--json").stdout)
    assert found["phase"] in ("running", "hold"), "a machine that is too busy may hold it; nothing ends it"
    assert {process.pid for process in run.children()} == before

    stolen: list[str] = []
    with forged(found["endpoint"], "rf/platoon/request/supervisor", stolen):
        assert run.robofleet("hold").stdout == "ok\n"
        run.wait_for(lambda: "\nheld: " in run.said)
        stopped = run.robofleet("stop")
        assert (stopped.returncode, stopped.stderr) == (0, "")
        assert {"hold", "estop"} <= set(stolen)
    assert run.ended() == 1
    assert run.latched() == {"r1": 2}


def test_a_bare_stop_stops_every_arena_wherever_it_was_started(real_run: Start) -> None:
    tcp = "--set", "bus.endpoint=tcp/127.0.0.1:0", "--set", "bus.insecure=loopback"
    runs = [
        real_run(*ALONE, "--set", f"arena.name={name}", *where, name=name)
        for name, where in (("lab", ()), ("hall", tcp))
    ]
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
        assert run.ended() == 1
        assert run.summary["cause"].startswith("emergency stop (emergency stop requested)")
