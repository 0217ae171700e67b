"""A person's stick, a gamepad's and the page's own: what is wished, by which tick, and what happens at the release."""

import itertools
import math
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from selenium.webdriver import ActionChains, Chrome, Keys
from selenium.webdriver.common.by import By

from robofleet.behaviours.interface import WishKind
from robofleet.bus import keys
from robofleet.bus.bus import MemoryBus
from robofleet.bus.keys import STATE, STATUS, TICK, key, split
from robofleet.bus.messages import RUN_STATE, SCRIPT_WISH, TICK_RECORD, UNIT_STATUS, RunState, ScriptWish
from robofleet.bus.permissions import PAGE
from robofleet.config import groups
from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.core.clock import MS
from robofleet.gateways.gamepad import command
from robofleet.gateways.gamepad.pads import ABS_X, ABS_Y, BTN_TR, EV_ABS, EV_KEY, EventPad
from robofleet.operator.hand import Hand, Hands, Stick, drivers
from robofleet.runs.lockstep import Lockstep
from robofleet.safety.supervisor import NOBODY, Event, Phase
from tests.gateways.piped_pad import PipedDevice
from tests.operator.page.browser import chromium
from tests.operator.page.openpage import Fleet, Seen, opened
from tests.operator.page.webstand import WebStand, web_stand
from tests.runs.realrun import CLOCK, wait

TELEOP = SHIPPED / "teleop.yaml"
GROUP, MOST_V, MOST_OMEGA, CRAWL = "teleop", 0.1, 1.2, 0.05
STUB = """
  const buttons = Array.from({ length: 17 }, () => ({ pressed: false }));
  window.pad = { connected: true, index: 0, axes: [0, 0, 0, 0], buttons };
  window.pads = [];
  navigator.getGamepads = () => window.pads;
"""
WHEELS_WITHIN_S, STANDS_WITHIN_S = 0.060, 0.150


class Wished:
    """What was wished of the group, in order."""

    def __init__(self, stand: WebStand, group: str = GROUP) -> None:
        self._stream = stand._bus.stream(key(stand.config.arena.name, keys.TELEOP, group), capacity=4096)
        self.all: list[ScriptWish] = []
        self.roles: set[str] = set()  # of the senders, as their keys say

    def newest(self) -> ScriptWish | None:
        for _, full, payload in self._stream.drain():
            if (wish := SCRIPT_WISH.decode(payload)) is not None:
                self.all.append(wish)
                self.roles.add(split(full)[1].partition("/")[0])
        return self.all[-1] if self.all else None

    def is_(self, kind: WishKind, v: float = 0.0, omega: float = 0.0, within: float = 1e-6) -> bool:
        wish = self.newest()
        return wish is not None and wish.kind == kind and wish.robots[0][1:3] == pytest.approx((v, omega), abs=within)


@pytest.fixture(scope="module")
def stand(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WebStand]:
    with web_stand(tmp_path_factory.mktemp("run"), "tracker.source=truth", file=TELEOP) as stand:
        yield stand


@pytest.fixture(scope="module")
def browser() -> Iterator[Chrome]:
    with chromium() as browser:
        browser.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": STUB})
        yield browser


@pytest.fixture
def page(browser: Chrome, stand: WebStand) -> Iterator[Seen]:
    with opened(browser, stand) as page:
        yield page


@pytest.mark.slow
def test_a_gamepad_on_the_page_drives_while_a_shoulder_button_is_held(page: Seen, stand: WebStand) -> None:
    wished = Wished(stand)
    page.becomes(lambda: "press any button" in page.text("drive-gamepad"))
    page.run("pads = [pad]; pad.axes = [-0.5, -1, 0, 0]")
    page.becomes(lambda: "hold L1 or R1" in page.text("drive-gamepad"))
    assert wished.newest() is None, "without the button nothing is said"
    page.run("pad.buttons[5].pressed = true")
    page.becomes(lambda: wished.is_(WishKind.BODY, MOST_V, 0.5 * MOST_OMEGA))
    assert [wish.kind for wish in wished.all[:2]] == [WishKind.STAND, WishKind.BODY], "but that it was up"
    assert page.text("drive-words") == "You drive r1."
    before = wished.all[-1].echo_tick
    page.becomes(lambda: (wished.newest() or wished.all[-1]).echo_tick > before)
    assert wished.all[-1].echo_tick <= stand._seq, "of a tick that it has seen"
    assert [robot.told for robot in wished.all[-1].robots] == [1, 0, 0, 0]
    page.run("pad.axes = [0.02, 0.03, 0, 0]")
    page.becomes(lambda: wished.is_(WishKind.BODY))
    page.run("pad.buttons[5].pressed = false")
    page.becomes(lambda: wished.is_(WishKind.STAND))
    page.run("pad.axes = [0, -1, 0, 0]")
    count = len(wished.all)
    page.becomes(lambda: page.text("drive-words").startswith("Hold the stick to drive r1."))
    wished.newest()
    assert len(wished.all) == count, "the release is said once, and nothing after it"


@pytest.mark.slow
def test_in_a_held_run_it_drives_the_chosen_robot_out_after_the_button_was_let_go(page: Seen, stand: WebStand) -> None:
    wished = Wished(stand)
    page.run("pads = [pad]; pad.axes = [0, -1, 0, 0]")
    page.becomes(lambda: "hold L1 or R1" in page.text("drive-gamepad"))
    page.run("pad.buttons[5].pressed = true")
    page.becomes(lambda: wished.is_(WishKind.BODY, MOST_V))
    assert not page.shown("drive-robot")
    page.fleet.phase, page.fleet.cause = Phase.HOLD, Event.DEADLOCKED
    page.becomes(lambda: wished.is_(WishKind.STAND))
    page.becomes(lambda: page.shown("drive-robot"))
    page.run("document.getElementById('drive-robot').value = 'r3'")
    page.becomes(lambda: page.text("drive-words") == "Let go, then press again.")
    count = len(wished.all)
    page.becomes(lambda: page.run("return window.robofleet.state.tick.phase") == "hold")
    wished.newest()
    assert len(wished.all) == count, "it was held for something else, and not let go since"
    page.run("pad.buttons[5].pressed = false")
    page.becomes(lambda: "Hold the stick to drive r3 out" in page.text("drive-words"))
    page.run("pad.buttons[5].pressed = true")
    page.becomes(lambda: (wish := wished.newest()) is not None and wish.kind == WishKind.RESCUE)
    newest = wished.all[-1]
    assert page.text("drive-words") == "You drive r3 out at a crawl."
    assert [robot.told for robot in newest.robots] == [0, 0, 1, 0]
    assert newest.robots[2].first == pytest.approx(CRAWL)
    assert wished.roles == {PAGE}, "who commands is known by the key"
    page.fleet.phase, page.fleet.cause = Phase.RUNNING, Event.RESUME_REQUESTED
    page.becomes(lambda: wished.is_(WishKind.STAND))
    page.run("pad.buttons[5].pressed = false")
    page.becomes(lambda: not page.shown("drive-robot"))


@pytest.mark.slow
def test_a_gamepad_that_is_unplugged_or_a_page_that_is_closed_lets_the_robot_stand(page: Seen, stand: WebStand) -> None:
    wished = Wished(stand)
    for ending in ("pads = []", "location.href = 'about:blank'"):
        wished.all.clear()
        page.run("pad.buttons[4].pressed = false; pad.axes = [0, -1, 0, 0]; pads = [pad]")
        page.becomes(lambda: "hold L1 or R1" in page.text("drive-gamepad"))
        page.run("pad.buttons[4].pressed = true")
        page.becomes(lambda: wished.is_(WishKind.BODY, MOST_V))
        page.browser.execute_script(ending)
        assert wait(lambda: wished.is_(WishKind.STAND), 5.0), ending


@pytest.mark.slow
def test_a_gamepad_drives_nothing_from_another_tab_nor_when_the_page_is_seen_again(page: Seen, stand: WebStand) -> None:
    wished, window = Wished(stand), page.browser.current_window_handle
    page.run("pads = [pad]; pad.buttons[5].pressed = false; pad.axes = [0, -1, 0, 0]")
    page.becomes(lambda: "hold L1 or R1" in page.text("drive-gamepad"))
    page.run("pad.buttons[5].pressed = true")
    page.becomes(lambda: wished.is_(WishKind.BODY, MOST_V))
    page.browser.switch_to.new_window("tab")
    assert wait(lambda: wished.is_(WishKind.STAND), 5.0)
    page.browser.close()
    page.browser.switch_to.window(window)
    page.becomes(lambda: page.text("drive-words") == "Let go, then press again.")
    assert wished.is_(WishKind.STAND)


@pytest.mark.slow
def test_a_mouse_and_keys_drive_while_they_hold_the_pages_stick(page: Seen, stand: WebStand) -> None:
    wished, acts = Wished(stand), ActionChains(page.browser, duration=0)
    ring = page.browser.find_element(By.ID, "drive-stick")
    acts.move_to_element_with_offset(ring, 0, -44).click_and_hold().perform()
    page.becomes(lambda: wished.is_(WishKind.BODY, 0.5 * MOST_V, within=0.02))  # a pixel
    acts.reset_actions()
    page.becomes(lambda: wished.is_(WishKind.STAND))
    assert page.run("return document.activeElement") == ring
    acts.key_down("s").key_down(Keys.ARROW_RIGHT).perform()
    page.becomes(lambda: wished.is_(WishKind.BODY, -MOST_V, -MOST_OMEGA))
    acts.reset_actions()
    page.becomes(lambda: wished.is_(WishKind.STAND))


@pytest.mark.parametrize("cut", [True, False], ids=["cut", "closed"])
def test_a_page_whose_link_ends_lets_the_robots_stand(stand: WebStand, cut: bool) -> None:
    wished = Wished(stand)
    with stand.page() as page:
        for held in False, True:
            page.say(drive=GROUP, stick=[1, 0, held], tick=3)
        assert wait(lambda: wished.is_(WishKind.BODY, MOST_V), 5.0)
        if cut:
            page.socket.socket.shutdown(socket.SHUT_RDWR)
        else:
            page.socket.close()
        assert wait(lambda: wished.is_(WishKind.STAND), 5.0)


def test_a_page_that_floods_drives_no_oftener_and_delays_no_stop(stand: WebStand) -> None:
    wished, count = Wished(stand), 3000
    with stand.page() as page, stand.page() as other:
        page.say(drive=GROUP, stick=[0, 0, False], tick=3)
        began_ns = CLOCK.now_ns()
        for k in range(count):
            page.say(drive=GROUP, stick=[k / count, 0, True], tick=3)
        other.say(do="estop")
        assert wait(lambda: b"estop" in stand.requests, 1.0)
        page.say(drive=GROUP, stick=[0, 0, False], tick=4)
        assert wait(lambda: wished.is_(WishKind.STAND) and wished.all[-1].echo_tick == 4, 5.0)
        took_ns = CLOCK.now_ns() - began_ns
    assert 1 < len(wished.all) <= 3 + took_ns / (4 * MS)


def test_a_new_hand_drives_nothing_until_it_has_said_that_the_button_is_up() -> None:
    """As where a page's link breaks and opens again under a finger that was never lifted."""
    config = load_config(TELEOP)
    bus, kinds = Lockstep(config).bus, list[WishKind]()
    bus.tap(lambda message: kinds.append(WishKind(wish.kind)) if (wish := SCRIPT_WISH.decode(message[1])) else None)
    hands, instants = Hands(bus, config, lambda: next(instants)), itertools.count(0, 10 * MS)
    for tick, stick, out in ((0, HELD, None), (1, HELD, None), (2, HELD, "r2"), (3, HELD, "r2")):
        assert hands.drive(GROUP, stick, tick, out)
    assert not kinds
    for stick in (LET_GO, LET_GO, HELD):
        hands.drive(GROUP, stick, 4, "r2")
    assert kinds == [WishKind.STAND, WishKind.RESCUE]
    hands.drive(GROUP, HELD, 5)
    hands.drive(GROUP, HELD, 6)
    assert kinds[2:] == [WishKind.STAND], "it is held for something else"


@pytest.mark.parametrize(
    "message",
    [
        {"drive": "nobody", "stick": [0, 0, True], "tick": 1},
        {"drive": GROUP, "stick": [math.nan, 0, True], "tick": 1},
        {"drive": GROUP, "stick": [0, math.nan, True], "tick": 1},
        {"drive": GROUP, "stick": [math.inf, 0, True], "tick": 1},
        {"drive": GROUP, "stick": [0, -1.01, True], "tick": 1},
        {"drive": GROUP, "stick": [10**300, 0, True], "tick": 1},
        {"drive": GROUP, "stick": [0, 0, 1], "tick": 1},
        {"drive": GROUP, "stick": [0, 0, True], "tick": -1},
        {"drive": GROUP, "stick": [0, 0, True], "tick": 1 << 40},
        {"drive": GROUP, "stick": [0, 0, True]},
        {"drive": GROUP, "stick": [0, 0, True], "tick": 1, "out": "nobody"},
        {"drive": GROUP, "stick": [0, 0, True], "tick": 1, "out": 3},
    ],
)
def test_what_no_stick_says_drives_nothing_and_closes_the_page(stand: WebStand, message: dict[str, object]) -> None:
    wished = Wished(stand)
    with stand.page() as page:
        page.say(**message)
        assert wait(lambda: page.socket.close_code is not None or _closed(page.socket.recv), 3.0)
    assert wished.newest() is None


def _closed(receive: Callable[[float], object]) -> bool:
    try:
        receive(0.1)
    except TimeoutError:
        return False
    except Exception:  # noqa: BLE001 - whatever says that it is closed
        return True
    return False


@contextmanager
def at_a_computer(stand: WebStand, phase: Phase, out: str = "") -> Iterator[tuple[PipedDevice, Wished, Fleet]]:
    """Drive by a gamepad of this computer, or the robot ``out`` of a held run; it stands when that is ended."""
    wished, pad, over = Wished(stand), PipedDevice(), threading.Event()
    arguments = EventPad(pad), stand.config, stand._bus, CLOCK, GROUP, over.is_set, out
    thread = threading.Thread(target=command.drive, args=arguments)
    with Fleet(stand).alive() as fleet:
        fleet.phase = phase
        thread.start()
        yield pad, wished, fleet
        over.set()
    thread.join(10.0)  # the supervisor is silent now
    assert not thread.is_alive()
    assert wait(lambda: wished.is_(WishKind.STAND), 5.0)


@pytest.mark.slow
def test_a_gamepad_at_a_computer_drives_and_stands_when_it_is_let_go_or_ended(stand: WebStand) -> None:
    with at_a_computer(stand, Phase.RUNNING) as (pad, wished, _):
        assert wait(lambda: wished.is_(WishKind.STAND), 5.0)
        pad.happens((EV_ABS, ABS_Y, -32768), (EV_ABS, ABS_X, 0))
        pad.happens((EV_KEY, BTN_TR, 1))
        assert wait(lambda: wished.is_(WishKind.BODY, MOST_V, MOST_OMEGA), 5.0)
        pad.happens((EV_KEY, BTN_TR, 0))
        assert wait(lambda: wished.is_(WishKind.STAND), 5.0)
        pad.happens((EV_KEY, BTN_TR, 1))
        assert wait(lambda: wished.is_(WishKind.BODY, MOST_V, MOST_OMEGA), 5.0)


@pytest.mark.slow
def test_a_gamepad_at_a_computer_is_told_that_another_person_drives(
    stand: WebStand, capsys: pytest.CaptureFixture[str]
) -> None:
    with at_a_computer(stand, Phase.RUNNING) as (pad, wished, fleet):
        fleet.figures = {"wish_epoch": [77.0] * 4, "command_age": [0.033] * 4}
        pad.happens((EV_ABS, ABS_Y, -32768), (EV_KEY, BTN_TR, 0))
        assert wait(lambda: wished.is_(WishKind.STAND), 5.0)

        def pressed() -> None:
            for value in 0, 1:
                pad.happens((EV_KEY, BTN_TR, value))

        def refused() -> bool:
            """Press again where the tick was not known yet."""
            pressed()
            return "another person drives teleop: let go, wait, then press again" in capsys.readouterr().err

        assert wait(refused, 5.0)
        for figures in fleet.figures, {}:  # when the other one has let go, it needs a new press
            fleet.figures, tick = figures, fleet.ticks
            count = len(wished.all)
            assert wait(lambda tick=tick: fleet.ticks > tick + 8, 5.0)
            assert wished.newest() and {wish.kind for wish in wished.all[count:]} <= {WishKind.STAND}
        assert wait(lambda: pressed() or wished.is_(WishKind.BODY, MOST_V), 5.0)


def test_a_gamepad_at_a_computer_drives_no_robot_of_the_arenas_next_run() -> None:
    """Its supervisor is another one; its bus may be in the same place."""
    config, device = load_config(TELEOP), PipedDevice()
    bus = MemoryBus(config.arena.name, CLOCK, 0)
    say = bus.publisher(STATE)
    thread = threading.Thread(
        target=command.drive, args=(EventPad(device), config, bus, CLOCK, GROUP, lambda: False), daemon=True
    )
    thread.start()

    def ends(epoch: int) -> bool:
        say(RUN_STATE.encode(RunState(epoch, 1, Phase.RUNNING, 0, NOBODY, 0.0, 0, ())))
        thread.join(0.05)
        return not thread.is_alive()

    device.happens((EV_KEY, BTN_TR, 0))
    assert not any(ends(1) for _ in range(10))
    assert wait(lambda: ends(2), 5.0)


def driven(stick_of: Callable[[int], Stick | None]) -> np.ndarray:
    """Return what each robot's gate lets through in a run in lockstep: instants [s], its faster wheel [rad/s].

    A robot a column, in the order of the group; a status a row, with 0 for the robots of which it says nothing.

    ``said``: what a person does at a tick of the run; None: the link is dead.
    """
    config = load_config(TELEOP, ["run.duration_s=1.5", "tracker.source=truth", "drivers.robots_per_process=1"])
    run = Lockstep(config)
    hand = Hand(run.bus, config, GROUP)
    tick, statuses = key(config.arena.name, TICK), [key(config.arena.name, STATUS, robot_id) for robot_id in config.ids]
    found: list[tuple[float, ...]] = []

    def tap(message: tuple[str, bytes]) -> None:
        full, payload = message
        now_s = run.clock.now_ns() / 1e9
        if full == tick and (record := TICK_RECORD.decode(payload)) is not None and record.run_tick >= 0:
            started.append(now_s) if not started else None
            if (stick := stick_of(record.run_tick)) is not None:
                hand.drive(stick, record.tick)
        elif full in statuses and started and (status := UNIT_STATUS.decode(payload)) is not None:
            (gate,) = status.robots
            fastest = max(abs(gate.left_output_rad_s), abs(gate.right_output_rad_s))
            found.append((now_s - started[0], *(fastest * (full == robot_id) for robot_id in statuses)))

    started: list[float] = []
    run.bus.tap(tap)
    run.run()
    return np.array(found)


@pytest.mark.slow
def test_the_second_person_waits_and_everybody_sees_who_drives() -> None:
    config = load_config(TELEOP, ["run.duration_s=3", "tracker.source=truth"])
    run, described = Lockstep(config), groups.descriptions(config)
    first, second = (Hand(run.bus, config, GROUP) for _ in range(2))
    seen: dict[int, int | None] = {}

    def tap(message: tuple[str, bytes]) -> None:
        if message[0] == key(config.arena.name, TICK) and (record := TICK_RECORD.decode(message[1])) is not None:
            tick = record.run_tick
            seen[tick] = drivers(described, record).get(GROUP)
            first.drive(HELD if 5 <= tick < 20 else LET_GO, record.tick)
            second.drive(HELD if 10 <= tick < 40 else LET_GO, record.tick)

    run.bus.tap(tap)
    run.run()
    names = {first.epoch: 1, second.epoch: 2, None: 0}
    turns = [names[seen[tick]] for tick in range(60)]
    assert [number for number, _ in itertools.groupby(turns)] in ([0, 1, 2, 0], [0, 1, 0, 2, 0])
    assert turns[15] == 1 and turns[30] == 2


HELD, LET_GO, TICK_S = Stick(1.0, 0.0, True), Stick(1.0, 0.0, False), 0.033


@pytest.mark.slow_after_first
@pytest.mark.parametrize("end", [LET_GO, None], ids=["let go", "link dead"])
def test_wheels_follow_the_stick_and_stand_soon_after_its_end(end: Stick | None) -> None:
    begin_tick, end_tick = 10, 30
    wheels = driven(lambda tick: LET_GO if tick < begin_tick else HELD if tick < end_tick else end)
    times, turning = wheels[:, 0], wheels[:, 1:] > 0.0
    assert turning[:, 1:].any(axis=0).all(), "the others follow"
    first, last = times[turning[:, 0]].min(), times[turning.any(axis=1)].max()
    assert begin_tick * TICK_S < first <= begin_tick * TICK_S + WHEELS_WITHIN_S + 0.02, "and a status is 20 ms apart"
    newest = (end_tick if end is not None else end_tick - 1) * TICK_S
    allowed = 0.040 if end is not None else STANDS_WITHIN_S + TICK_S
    assert newest < last <= newest + allowed + 0.02


def test_without_the_button_nothing_is_driven() -> None:
    assert not driven(lambda _: LET_GO)[:, 1:].any()


@pytest.mark.slow
def test_a_gamepad_at_a_computer_drives_out_of_a_held_run_whom_it_was_told(stand: WebStand) -> None:
    with at_a_computer(stand, Phase.HOLD, "r2") as (pad, wished, _):
        pad.happens((EV_ABS, ABS_Y, 32767), (EV_ABS, ABS_X, 128), (EV_KEY, BTN_TR, 0))

        def out() -> bool:
            """Press again where the phase was not known yet."""
            wish = wished.newest()
            if wish is None or wish.kind != WishKind.RESCUE:
                pad.happens((EV_KEY, BTN_TR, 0))
                pad.happens((EV_KEY, BTN_TR, 1))
                return False
            return wish.robots[1][:2] == pytest.approx((1, -CRAWL), abs=1e-3)

        assert wait(out, 5.0)


@pytest.mark.slow
def test_a_group_that_nobody_drives_by_hand_has_no_hand() -> None:
    config = load_config(SHIPPED / "platoon.yaml")
    hands = Hands(Lockstep(config).bus, config, lambda: 0)
    assert not hands.drive("platoon", HELD, 1)
