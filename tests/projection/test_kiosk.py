"""The full-screen browser of a projector on this computer, which a test's own program stands for."""

import os
import sys
from pathlib import Path

import pytest

from robofleet.projection.display import DisplayError
from robofleet.projection.kiosk import kiosk
from tests.runs.realrun import wait

ADDRESS = "http://127.0.0.1:5/"


@pytest.fixture
def started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put a Chromium into the path that writes its options into this file, and stays."""
    chromium, options = tmp_path / "chromium", tmp_path / "options"
    chromium.write_text(
        f"#!{sys.executable}\nimport pathlib, signal, sys\n"
        f"part = pathlib.Path({str(options)!r} + '.part')\n"
        f"part.write_text('\\n'.join(sys.argv[1:]))\npart.rename({str(options)!r})\nsignal.pause()\n"
    )
    chromium.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("DISPLAY", ":0")
    return options


@pytest.mark.parametrize(("user", "sandbox"), [(0, False), (1000, True)])
def test_a_kiosk_is_full_screen_and_starts_also_as_root(
    started: Path, monkeypatch: pytest.MonkeyPatch, user: int, sandbox: bool
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: user)
    with kiosk(ADDRESS, (1920, 1080)):
        assert wait(started.exists, 10)
        *options, address = started.read_text().splitlines()
    assert address == ADDRESS
    assert {"--kiosk", "--window-size=1921,1081"} <= {*options}
    assert ("--no-sandbox" not in options) == sandbox
    (profile,) = (option.partition("=")[2] for option in options if option.startswith("--user-data-dir="))
    assert not Path(profile).exists()


def test_without_a_browser_or_a_screen_it_says_what_to_do(started: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with (
        pytest.raises(DisplayError, match=f"no screen here .*: open {ADDRESS} in a browser"),
        kiosk(ADDRESS, (1920, 1080)),
    ):
        pass
    monkeypatch.setenv("PATH", str(started.parent / "nothing"))
    with pytest.raises(DisplayError, match="no Chromium here"), kiosk(ADDRESS, (1920, 1080)):
        pass
