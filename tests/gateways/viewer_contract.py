"""What every live viewer keeps: it gets what a recording gets, and what cannot be is refused in a line."""

import socket
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from robofleet.core import refusal
from robofleet.gateways.viewers.server import Server
from robofleet.operator.viewer_address import DEFAULTS, Address, completed, option
from tests.command import robofleet
from tests.shipped import PLATOON

HERE = Address("127.0.0.1", 0)
Messages = dict[str, list[Any]]  # by topic, in one order


class Seen(NamedTuple):
    """What was told of a run in lockstep."""

    recorded: Messages
    early: Messages  # by a viewer that was there before the run
    late: Messages  # by one that came when the run was over


class ViewerContract:
    """Checks for every kind of viewer; the file of tests has a fixture ``seen``."""

    viewer: str
    package: str  # of its library
    drawn: frozenset[str]  # topics that every run with a camera has

    def server(self, at: Address) -> Server:
        """Return a server that shows no run."""
        raise NotImplementedError

    @pytest.mark.slow
    def test_a_viewer_gets_what_the_recording_gets(self, seen: Seen) -> None:
        assert self.drawn <= set(seen.recorded)
        for topic, messages in seen.recorded.items():
            assert seen.early[topic] == messages, topic

    @pytest.mark.parametrize("following", [[], ["--quiet"], ["lab.yaml"], ["127.0.0.1:9000"]])
    def test_the_address_may_be_left_out(self, following: list[str]) -> None:
        at = following if following[:1] == ["127.0.0.1:9000"] else [DEFAULTS[self.viewer], *following]
        assert completed(["run", option(self.viewer), *following]) == ["run", option(self.viewer), *at]

    @pytest.mark.parametrize("text", ["nonsense", "127.0.0.1", "127.0.0.1:x", "127.0.0.1:65536", ":8765", "a b:1"])
    def test_what_is_no_address_is_refused(self, text: str) -> None:
        assert DEFAULTS[self.viewer] in self.refused(text)

    def test_a_port_in_use_is_refused_before_anything_starts(self, tmp_path: Path) -> None:
        with socket.create_server(("127.0.0.1", 0)) as taken:
            at = f"127.0.0.1:{taken.getsockname()[1]}"
            line = self.refused(at, "--out", str(tmp_path / "run"))
            with pytest.raises(OSError, match="in use"):
                self.server(Address(*taken.getsockname()))
        assert line == f"{option(self.viewer)} {at}: Address already in use: name a port that is free, or 0 for any\n"
        assert not (tmp_path / "run").exists()

    def test_without_the_library_a_line_says_what_brings_it(self, monkeypatch: pytest.MonkeyPatch) -> None:
        find_spec = refusal.find_spec
        monkeypatch.setattr(refusal, "find_spec", lambda name: None if name == self.package else find_spec(name))
        line = self.refused()
        assert f"this needs {self.package}: " in line and f"[{self.viewer}]" in line

    def test_a_run_in_lockstep_has_no_viewers(self) -> None:
        assert "--lockstep" in self.refused(str(HERE), "--lockstep")

    def refused(self, *words: str) -> str:
        """Return the line by which a run with this viewer is refused."""
        result = robofleet("run", PLATOON, option(self.viewer), *words)
        assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (2, "", 1), result.output
        return result.stderr
