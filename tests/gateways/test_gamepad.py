"""Which devices are gamepads, what is read of one, and what is said where none can be read."""

import os
from pathlib import Path

import evdev
import pytest

from robofleet.bus.credentials import Credentials
from robofleet.config.files.names import SHIPPED
from robofleet.config.load import load_config
from robofleet.gateways.gamepad import command, pads
from robofleet.gateways.gamepad.pads import (
    ABS_X,
    ABS_Y,
    BTN_SOUTH,
    BTN_TL,
    BTN_TR,
    EV_ABS,
    EV_KEY,
    EV_SYN,
    SYN_DROPPED,
    SYN_REPORT,
    EventPad,
    Held,
    PadError,
    opened,
)
from robofleet.gateways.place import ArenaAccess
from robofleet.operator.hand import Stick
from tests.command import robofleet
from tests.gateways.piped_pad import SHOULDERS, STICK, PipedDevice

AT_REST = Stick(0.0, 0.0, False)
OTHERS = {EV_KEY: [BTN_SOUTH]}, {EV_KEY: SHOULDERS}, {EV_ABS: STICK}, {EV_KEY: SHOULDERS, EV_ABS: STICK[:1]}, {}
REPORT, DROPPED = (EV_SYN, SYN_REPORT, 0), (EV_SYN, SYN_DROPPED, 0)


def here(monkeypatch: pytest.MonkeyPatch, **devices: dict[int, list[object]] | None) -> None:
    """Let these devices be plugged in; None: a gamepad."""
    monkeypatch.setattr(evdev, "list_devices", lambda _: list(devices))
    monkeypatch.setattr(evdev, "InputDevice", lambda path: PipedDevice(path, devices[path]))


def test_a_gamepad_is_found_among_other_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    here(monkeypatch, **{f"other{k}": has for k, has in enumerate(OTHERS)}, pad=None)
    assert opened(None).name == opened(Path("pad")).name == "pad"


@pytest.mark.parametrize("role", ["script", "viewer"])
def test_who_has_not_joined_as_an_operator_is_told_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, role: str
) -> None:
    here(monkeypatch, pad=None)
    access = ArenaAccess(("quic/127.0.0.1:1",), Credentials.at(tmp_path, "carol"), role)
    monkeypatch.setattr(command, "run_of", lambda *_: (load_config(SHIPPED / "teleop.yaml"), access))
    refused = robofleet("teleop")
    assert refused.exit_code == 2
    (line,) = refused.stderr.splitlines()
    assert f"has joined teleop as {role}" in line and "--kind operator" in line


def test_a_gamepad_is_read_also_while_nothing_happens() -> None:
    device = PipedDevice()
    pad = EventPad(device)
    assert pad.fileno() == device.fd
    assert pad.read() == AT_REST
    device.happens((EV_KEY, BTN_TR, 1), (EV_ABS, ABS_Y, -32768), (EV_ABS, ABS_X, 255), REPORT)
    assert pad.read() == pad.read() == Stick(1.0, -1.0, True)
    device.happens((EV_KEY, BTN_TR, 0), REPORT)
    assert not pad.read().held


def test_a_gamepad_that_is_gone_is_an_error() -> None:
    device = PipedDevice()
    pad = EventPad(device)
    device.close()
    with pytest.raises(OSError, match="descriptor"):
        pad.read()


def test_after_dropped_events_a_button_counts_when_it_is_pressed_again() -> None:
    """A release may be among what was dropped; what is left of that report says nothing."""
    device = PipedDevice()
    pad = EventPad(device)
    device.happens((EV_KEY, BTN_TL, 1), (EV_ABS, ABS_Y, -32768), REPORT)
    assert pad.read() == Stick(1.0, 0.0, True)
    device.happens(DROPPED, (EV_KEY, BTN_TL, 1))
    assert pad.read() == AT_REST
    device.happens((EV_KEY, BTN_TL, 1), (EV_ABS, ABS_Y, -32768), REPORT)
    assert pad.read() == AT_REST
    device.happens((EV_ABS, ABS_X, 0), REPORT)
    assert pad.read() == Stick(0.0, 1.0, False)
    device.happens((EV_KEY, BTN_TL, 1), REPORT)
    assert pad.read() == Stick(0.0, 1.0, True)


def test_a_sticks_range_is_its_devices_own_and_only_shoulder_buttons_hold() -> None:
    held = Held({ABS_X: (0, 255), ABS_Y: (-32768, 32767)})
    assert held.take([(EV_ABS, ABS_X, 255), (EV_ABS, ABS_Y, -32768)]) == Stick(1.0, -1.0, False)
    assert held.take([(EV_ABS, ABS_X, 128), (EV_ABS, ABS_Y, 600)]) == AT_REST
    assert not held.take([(EV_KEY, BTN_SOUTH, 1)]).held
    assert held.take([(EV_KEY, BTN_TR, 1)]).held
    assert not held.take([(EV_KEY, BTN_TR, 0)]).held


@pytest.mark.parametrize("has", OTHERS)
def test_what_is_no_gamepad_is_refused(has: dict[int, list[object]], monkeypatch: pytest.MonkeyPatch) -> None:
    here(monkeypatch, keyboard=has)
    with pytest.raises(PadError, match="keyboard has no stick and no shoulder buttons"):
        opened(Path("keyboard"))
    with pytest.raises(PadError, match="plug one in"):
        opened(None)


def test_several_gamepads_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    here(monkeypatch, one=None, other=None)
    with pytest.raises(PadError, match="--device: one, other"):
        opened(None)


def test_a_device_that_is_not_there_or_is_not_permitted_is_one_line_with_a_cure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(PadError, match=r"event7: No such file .*--device"):
        opened(tmp_path / "event7")
    (tmp_path / "event7").touch()
    monkeypatch.setattr(pads, "_DEVICES", str(tmp_path))
    with pytest.raises(PadError, match="plug one in"):
        opened(None)
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(PadError, match="usermod -aG input"):
        opened(None)
    monkeypatch.setattr(os, "open", refuse)
    with pytest.raises(PadError, match=r"event7: this user may not read it: .*usermod -aG input"):
        opened(tmp_path / "event7")


def refuse(path: str, _: int) -> int:
    raise PermissionError(13, "Permission denied", path)
