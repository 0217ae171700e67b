"""Projectors' pages at the server: who may open and switch them, what is told, and what stands in the way."""

import asyncio
import json
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed

from robofleet.bus.zenoh_bus import ZenohBus
from robofleet.config.load import load_config
from robofleet.config.tree import Config
from robofleet.core.refusal import RefusedError
from robofleet.operator.page import projectors
from robofleet.operator.page.feed import Feed
from robofleet.operator.page.known_page import forget, keep, page_for_others, page_of
from robofleet.operator.page.page_address import Addresses, projector_address
from robofleet.operator.page.process import projected
from robofleet.safety.supervisor import Event, Phase
from tests.operator.page.secureweb import HOST, Visitor, keys_in, trusting
from tests.operator.page.webstand import CLOCK, WebStand, web_stand
from tests.projection.projectors import SIZE, tilted
from tests.shipped import PLATOON


def hanging(*names: str, apart_m: float = 1.0) -> str:
    """Return the override that hangs calibrated projectors above the arena, side by side."""
    rows: list[dict[str, Any]] = []
    for k, name in enumerate(names):
        optics = tilted(apart_m * (k - (len(names) - 1) / 2)).model.model_dump(mode="json")
        rows.append({"name": name, "width": SIZE[0], "height": SIZE[1], "calibration": optics | {"delay_s": 0.05}})
    return f"projectors={json.dumps(rows)}"


def config(*overrides: str) -> Config:
    return load_config(PLATOON, overrides)


@pytest.fixture(scope="module")
def stand(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebStand]:
    with web_stand(tmp_path_factory.mktemp("run"), "tracker.source=truth", hanging("main")) as stand:
        yield stand


def test_an_operator_switches_what_every_page_is_told_is_shown(stand: WebStand) -> None:
    with stand.page() as operator, stand.page() as projector:
        before = operator.next("showing")
        assert before["show"] == list(stand.config.projection.show)
        assert before["pages"] == []
        projector.say(projector="main", size_px=[960, 540])
        assert operator.next("showing", lambda frame: frame["pages"])["pages"] == [
            {"name": "main", "size_px": [960, 540]}
        ]
        operator.say(show=["halos", "large"])
        for page in operator, projector:
            assert page.next("showing", lambda frame: frame["show"] != before["show"])["show"] == ["halos", "large"]
        stand.say_showing("walls")
        stand.say_showing("paths")
        assert operator.next("showing")["show"] == ["paths"], "another server's operator switches it here, too"
        operator.say(show=["halos", "large"])
        assert operator.next("showing")["show"] == ["halos", "large"]
    with stand.page() as late:
        showing = late.next("showing", lambda frame: not frame["pages"])  # a browser that is gone is told, too
        assert showing["show"] == ["halos", "large"]
        late.say(show=before["show"])
        late.next("showing", lambda frame: frame["show"] == before["show"])


def test_a_server_that_begins_later_shows_what_an_operator_has_switched(stand: WebStand, tmp_path: Path) -> None:
    other = ZenohBus(stand.config.arena.name, stand.config.bus.endpoint, "other", CLOCK)

    async def shows() -> tuple[str, ...]:
        feed = Feed(stand.config, tmp_path, other, CLOCK, str)
        running = asyncio.create_task(feed.run())
        async with asyncio.timeout(5):
            while feed.show == stand.config.projection.show:
                await asyncio.sleep(0.01)
        running.cancel()
        return feed.show

    with closing(other), stand.page() as operator:
        operator.say(show=["halos", "large"])
        operator.next("showing", lambda frame: frame["show"] == ["halos", "large"])
        assert asyncio.run(shows()) == ("halos", "large")


@pytest.mark.parametrize(
    "nonsense",
    [{"show": ["walls"]}, {"show": "halos"}, {"show": [["halos"]]}, {"projector": "r9", "size_px": [1, 1]},
     {"projector": "main", "size_px": [1.5, 2]}, {"projector": "main"}],
    ids=str,
)  # fmt: skip
def test_a_page_that_makes_no_sense_is_closed(stand: WebStand, nonsense: dict[str, Any]) -> None:
    with stand.page() as page:
        page.say(**nonsense)
        with pytest.raises(ConnectionClosed) as closed:
            while True:
                page.heard_one()
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008


def test_a_viewer_sees_a_projectors_page_and_switches_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keys = keys_in(tmp_path / "keys")
    with (
        web_stand(tmp_path, "tracker.source=truth", hanging("main"), host=HOST, keys=keys) as stand,
        ExitStack() as end,
    ):
        viewer = Visitor(stand, trusting(tmp_path / "keys"))
        end.callback(viewer.client.close)
        entering = viewer.enter(projector_address(stand.addresses.viewer, 'main">&x'))
        assert 'url=/projector?name=main%22%3E%26x&amp;"' in entering.text
        monkeypatch.setenv("XDG_RUNTIME_DIR", end.enter_context(tempfile.TemporaryDirectory()))
        assert page_for_others("platoon") == ""
        keep("platoon", stand.addresses)
        assert page_of("platoon") is None, "it is none of this computer's alone"
        assert page_for_others("platoon") == f"https://{stand.authority}"
        assert viewer.client.get("/projector?name=main").status_code == 200
        page = end.enter_context(viewer.page())
        page.say(show=["large"])
        answer = page.next("answer")
        assert (answer["to"], answer["ok"]) == ("show", False)
        assert answer["text"].startswith("refused (403)")
        with viewer.page() as other:
            assert other.next("showing")["show"] == list(stand.config.projection.show)


def test_a_strangers_projector_is_refused(stand: WebStand) -> None:
    assert httpx.post(f"http://{stand.authority}/once").status_code == 403
    for path in ("projector?name=main", "projector/background", "projector/veil/main"):
        assert httpx.get(f"http://{stand.authority}/{path}").status_code == 403


def test_a_tick_says_how_old_it_is(stand: WebStand) -> None:
    with stand.page() as page:
        page.next("hello")
        stand.say_state(Phase.RUNNING, Event.PROVED)
        stand.say_tick(1)
        first = page.next("tick", lambda tick: tick["tick"])
        assert 0.0 <= first["age_ms"] < 1000.0
        later = page.next("tick", lambda tick: tick["seq"] > first["seq"] + 1)  # nothing new came
        assert later["age_ms"] > first["age_ms"]


def test_two_projectors_veils_leave_each_place_its_light(stand: WebStand) -> None:
    both = config(hanging("left", "right"))
    light = []
    for name in ("left", "right"):
        png = cv2.imdecode(np.frombuffer(projectors.veil(both, name), np.uint8), cv2.IMREAD_UNCHANGED)
        assert png is not None
        assert png.shape == (*SIZE[::-1], 4)
        light.append((1.0 - png[..., 3] / 255.0) ** 2.2)
    x, y = np.meshgrid(np.linspace(-1.2, 1.2, 25), np.linspace(-0.5, 0.5, 11))
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    total = np.zeros(len(points))
    for k, own in enumerate(light):
        pixels = tilted(k - 0.5).pixels(points)
        lit = np.isfinite(pixels[:, 0])
        total[lit] += own[tuple(np.round(pixels[lit]).astype(int).T[::-1])]
    assert total == pytest.approx(1.0, abs=0.03)


def test_what_cannot_be_projected_is_refused_in_a_line(tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match="has no projector: write"):
        projectors.calibrated(config())
    two = config(hanging("left", "right"))
    assert [projector.name for projector in projectors.calibrated(two)] == ["left", "right"]
    with pytest.raises(RefusedError, match="there is no projector 'lef': did you mean 'left'"):
        projectors.calibrated(two, "lef")
    with pytest.raises(RefusedError, match="projector main is not calibrated: run robofleet calibrate projector"):
        projectors.calibrated(config("projectors=[{name: main, width: 960, height: 540}]"))
    (tmp_path / "text.png").write_text("a picture of a lawn")
    for file, why in (tmp_path / "none.png", "No such file"), (tmp_path / "text.png", "is no image"):
        with pytest.raises(RefusedError, match=f"projection.background: .*{why}"):
            projectors.background(config(f"projection.background={file}"))


def test_a_runs_page_is_found_while_it_is_served(stand: WebStand, monkeypatch: pytest.MonkeyPatch) -> None:
    with tempfile.TemporaryDirectory() as folder:  # short: a socket's path stands there
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        assert page_of("platoon") is None
        keep("platoon", stand.addresses)
        known = page_of("platoon")
        assert known is not None
        assert known._replace(once=stand.once) == stand.addresses
        address = projector_address(known.once, "main&token=1")  # a name that no configuration has
        opened = httpx.get(address)
        assert opened.status_code == 303
        assert opened.headers["location"] == f"/projector?name=main%26token%3D1&token={stand.token}"
        assert httpx.get(address).status_code == 403, "it opens once"
        assert httpx.get(stand.once).status_code == 303
        assert (Path(folder) / "robofleet" / "platoon.page").stat().st_mode & 0o077 == 0
        gone = Addresses("http://127.0.0.1:9/?token=ab", "http://127.0.0.1:9/open?once=cd")
        forget("platoon", gone)  # another run's
        assert page_of("platoon") is not None
        keep("platoon", gone)
        assert page_of("platoon") is None, "nobody serves it"
        forget("platoon", gone)
        assert not (Path(folder) / "robofleet" / "platoon.page").exists()


def test_the_command_says_what_to_open(monkeypatch: pytest.MonkeyPatch) -> None:
    at = Addresses("http://127.0.0.1:5/?token=ab", "http://127.0.0.1:5/open?once=cd")
    lines = projected(config(hanging("left", "right")).projectors, None, at).splitlines()
    assert lines[0] == "the projector left: http://127.0.0.1:5/projector?name=left&token=ab"
    assert lines[2].endswith(at.page)
    for screen in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(screen, raising=False)
    with ExitStack() as opened, pytest.raises(RefusedError, match="--kiosk: there is no"):
        projected(config(hanging("left")).projectors, opened, at)
