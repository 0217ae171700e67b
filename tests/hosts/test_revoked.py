"""A certificate that is revoked while a run is on: its owner is cut off at once, and the run and all others go on."""

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import mkdtemp

import pytest

from robofleet.bus.bus import Subscription
from robofleet.bus.credentials import AUTHORITY, Credentials, keys_folder
from robofleet.bus.joining import joined
from robofleet.bus.keys import SAFE_REQUEST, STATE
from robofleet.bus.permissions import VIEWER, access_control
from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.config.load import load_config
from robofleet.hosts.authority import ROUTER, Authority, identities
from robofleet.hosts.network import Keys
from tests.endpoints import free_port
from tests.runs.realrun import ALONE, CLOCK, PLATOON, RealRun, wait

ARENA = "platoon"


@pytest.fixture
def authority(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Authority:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    made = Authority.create(ARENA, keys_folder(ARENA))
    made.issue(ROUTER, ROUTER, addresses=["127.0.0.1"])
    for name in ("eve", "bob"):
        made.issue(name, VIEWER)
    return made


class Viewer:
    """Somebody on another computer who hears where the run is."""

    def __init__(self, authority: Authority, name: str, endpoint: str, stack: ExitStack) -> None:
        theirs = Path(
            mkdtemp(dir=authority.folder.parent)
        )  # on their own computer: a revocation takes nothing away there
        for file in Credentials.at(authority.folder, name)[1:]:
            shutil.copy(file, theirs)
        own = Credentials.at(theirs, name)
        self.bus: ZenohBus = joined(ARENA, endpoint, name, CLOCK, 20.0, credentials=own)
        stack.callback(self.bus.close)
        self._states: Subscription = self.bus.newest(STATE)

    def hears(self) -> bool:
        """Return whether something came since the last call."""
        return self._states.take() is not None


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def test_a_revocation_is_not_missed_where_the_keys_could_not_be_read_at_first(authority: Authority) -> None:
    keys, permitted = Keys(load_config(PLATOON)), access_control(ARENA, identities(authority))
    authority.revoke("eve")
    certificate = authority.folder / AUTHORITY
    away = certificate.rename(certificate.with_suffix(".away"))
    assert not keys.changed(permitted)
    away.rename(certificate)
    assert keys.changed(permitted)
    assert not keys.changed(permitted), "once"


@pytest.mark.slow
def test_who_is_revoked_in_a_run_hears_and_says_nothing_more_and_the_others_come_back(
    real_run: Callable[..., RealRun], authority: Authority, stack: ExitStack
) -> None:
    endpoints = [f"{link}/127.0.0.1:{free_port()}" for link in ("tls", "quic")]
    run = real_run(*ALONE, "--set", f"bus.listen={json.dumps(endpoints)}", "--duration", "600")
    run.wait_until_running()
    viewers = {(name, at): Viewer(authority, name, at, stack) for name in ("eve", "bob") for at in endpoints}
    for viewer in viewers.values():
        assert wait(viewer.hears, 20), "everybody hears before"

    def log(line: str) -> int:
        return (run.folder / "log" / "router.log").read_text().count(line)

    def anew() -> int:
        return log("the router begins anew")

    for name in ("carol", "dave"):
        authority.issue(name, VIEWER)
    authority.renew("bob")
    authority.revoke("dave")  # whom nobody ever let in
    for _ in range(20):
        assert wait(viewers["bob", endpoints[0]].hears, 5)
    assert anew() == 0, "other keys disturb no run"

    authority.revoke("eve")
    assert wait(anew, 10)
    bobs = [viewers["bob", at] for at in endpoints]
    carol = Viewer(authority, "carol", endpoints[0], stack)
    for viewer in (*bobs, carol):
        assert wait(viewer.hears, 20), "who is not revoked is back"

    eves = [viewers["eve", at] for at in endpoints]
    by_both = [f"eve is revoked, or unknown: from {link}/" for link in ("tls", "quic")]  # a link may knock twice
    assert wait(lambda: all(map(log, by_both)), 20), "she knocks again, by both links"
    for viewer in eves:
        viewer.hears()  # what came before
    for _ in range(20):
        for viewer in (*bobs, carol):
            assert wait(viewer.hears, 5)
    assert not any(viewer.hears() for viewer in eves), "who is revoked hears nothing"

    for viewer in eves:
        viewer.bus.ask(SAFE_REQUEST, "supervisor", b"estop")
    answer = bobs[0].bus.ask(SAFE_REQUEST, "supervisor", b"status")
    assert wait(lambda: answer.take() is not None, 5)
    run.wait_for(lambda: run.newest.startswith(("running", "held")))
    assert run.asked("resume").exit_code == 0 if run.newest.startswith("held") else True
    run.wait_for(lambda: run.newest.startswith("running"))
    assert not any(run.latched().values()), "and says nothing"
    assert anew() == 1
