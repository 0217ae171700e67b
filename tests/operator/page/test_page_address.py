"""How the operator comes to the page: a browser that is opened, an address with what to do, a QR code."""

import io
import socket
import sys
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
import pytest
from rich.console import Console

from robofleet.core.refusal import RefusedError
from robofleet.operator.page.browser import opener
from robofleet.operator.page.page_address import Addresses, address_lines, listening
from robofleet.operator.terminal.qr_code import qr_code

SECRET = "0123456789abcdef" * 2
PAGE = f"http://127.0.0.1:43210/?token={SECRET}"
HERE = Addresses(PAGE, PAGE.replace("/?token", "/open?once"))
PHONE_PAGE = "https://192.168.100.105:43210/open?once=m3Zk0Qv7TtY5c1WnR8aJxA"
THERE = Addresses(PHONE_PAGE, f"{PHONE_PAGE}-once", f"{PHONE_PAGE}-viewer", ":".join(["AB"] * 32))
BY_PYTHON = [sys.executable, "-P", "-m", "webbrowser"]
DESKTOP = {"DISPLAY": ":0"}


@pytest.mark.parametrize(
    ("environment", "changes", "command"),
    [
        (DESKTOP, {}, BY_PYTHON),
        ({"WAYLAND_DISPLAY": "wayland-0"}, {}, BY_PYTHON),
        ({}, {}, None),
        (DESKTOP, {"installed": ("lynx", "w3m")}, None),
        (DESKTOP, {"root": True}, None),
        (DESKTOP | {"SSH_CONNECTION": "10.0.0.2 5 10.0.0.1 22"}, {}, None),
        (DESKTOP | {"SSH_TTY": "/dev/pts/1"}, {}, None),
        (DESKTOP | {"BROWSER": "w3m"}, {}, None),
        (DESKTOP | {"BROWSER": "/usr/bin/lynx %s:firefox"}, {}, None),
        ({"BROWSER": "/vscode/helpers/browser.sh", "SSH_CONNECTION": "a 1 b 2"}, {"root": True}, BY_PYTHON),
        ({}, {"windows": True, "installed": ("wslview",)}, ["wslview"]),
        (DESKTOP, {"windows": True}, BY_PYTHON),
        ({}, {"windows": True}, None),
    ],
    ids=str,
)
def test_a_browser_is_opened_where_a_window_can_be_seen(
    environment: Mapping[str, str], changes: dict[str, Any], command: list[str] | None
) -> None:
    how: dict[str, Any] = {"root": False, "windows": False, "installed": ("xdg-open",)} | changes
    installed = how.pop("installed")
    assert opener(environment, found=lambda name: name if name in installed else None, **how) == command


def test_the_address_comes_with_what_somebody_elsewhere_has_to_do() -> None:
    assert address_lines(HERE, opened=True, environment={}).splitlines()[0] == f"the operator's page: {PAGE}"
    far = address_lines(HERE, opened=False, environment={"SSH_CONNECTION": "10.0.0.2 5 10.0.0.1 22", "USER": "ada"})
    assert "`ssh -N -L 43210:127.0.0.1:43210 ada@10.0.0.1`" in far
    assert "--web-host" in address_lines(HERE, opened=False, environment={})


@pytest.mark.parametrize("environment", [{}, {"SSH_CONNECTION": "10.0.0.2 5 10.0.0.1 22", "USER": "ada"}], ids=str)
def test_beyond_this_computer_there_is_an_address_for_an_operator_and_one_for_a_viewer(
    environment: Mapping[str, str],
) -> None:
    lines = address_lines(THERE, opened=False, environment=environment)
    assert lines.splitlines()[:2] == [f"the operator's page: {THERE.page}", f"  for a viewer: {THERE.viewer}"]
    assert THERE.fingerprint in lines.splitlines()[2]
    assert THERE.once not in lines
    assert "ssh" not in lines


@pytest.mark.parametrize("at", [HERE, THERE], ids=["here", "there"])
def test_a_launcher_reads_the_addresses_that_its_page_says(at: Addresses) -> None:
    assert Addresses.read(at.line() + "\n") == at


@pytest.mark.parametrize("line", ["", "http://127.0.0.1:1/", "one two three"])
def test_half_a_line_is_no_address(line: str) -> None:
    assert Addresses.read(line) is None


def terminal(encoding: str = "utf-8", width: int = 100, **changes: Any) -> Console:
    file = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    how: dict[str, Any] = {"force_terminal": True, "color_system": "truecolor", "height": 60, "_environ": {}} | changes
    return Console(file=file, width=width, **how)


def seen(console: Console) -> Any:
    """Return what a camera sees of a terminal whose colours are unknown: grey where nothing sets one."""
    shown = console.file
    assert isinstance(shown, io.TextIOWrapper)
    shown.flush()
    assert isinstance(shown.buffer, io.BytesIO)
    lines = shown.buffer.getvalue().decode(shown.encoding).splitlines()
    cells: list[list[tuple[int, int]]] = []
    for line in lines:
        row: list[tuple[int, int]] = []
        ink, paper = 128, 128
        for part in line.split("\x1b[")[1:]:
            codes, _, text = part.partition("m")
            colours = codes.split(";")
            if "38" in colours:
                ink = int(colours[colours.index("38") + 2])
            if "48" in colours:
                paper = int(colours[colours.index("48") + 2])
            if codes == "0":
                ink, paper = 128, 128
            halves = {" ": (paper, paper), "▀": (ink, paper), "▄": (paper, ink), "█": (ink, ink)}
            row += [halves[character] for character in text]
        cells.append(row)
    image = np.array(cells, dtype=np.uint8).transpose(0, 2, 1).reshape(2 * len(cells), -1)
    return cv2.resize(np.pad(image, 6, constant_values=0), None, fx=8, fy=8, interpolation=cv2.INTER_NEAREST)


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_a_phone_reads_the_address_whatever_the_terminals_colours_are(encoding: str) -> None:
    console = terminal(encoding, width=80)
    code = qr_code(PHONE_PAGE, console)
    assert code is not None
    console.print(code)
    text, *_ = cv2.QRCodeDetector().detectAndDecode(seen(console))
    assert text == PHONE_PAGE


@pytest.mark.parametrize(
    "changes",
    [
        {"width": 40},
        {"height": 20},
        {"color_system": None},
        {"force_terminal": False},
        {"encoding": "ascii", "width": 60},
    ],
    ids=str,
)
def test_where_a_code_could_not_be_read_the_address_stands_alone(changes: dict[str, Any]) -> None:
    assert qr_code(PHONE_PAGE, terminal(**changes)) is None


@pytest.mark.parametrize(
    ("host", "why"),
    [
        ("198.51.100.7", "Cannot assign requested address: name an address of this machine"),
        ("0.0.0.0", "name one of this machine's addresses"),
        ("no-such-name.invalid", "name an address of this machine"),
        ("fe80::1%nowhere", "name an address of this machine"),
    ],
)
def test_an_address_that_this_machine_does_not_have_is_refused_in_a_line(host: str, why: str) -> None:
    with pytest.raises(RefusedError) as refused:
        listening(host, 0, "--web-host")
    assert str(refused.value).startswith(f"--web-host {host}: ")
    assert why in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_port_in_use_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        with pytest.raises(RefusedError, match=f"--port {port}: Address already in use: .*, and a port that is free"):
            listening("127.0.0.1", port, "--host")
