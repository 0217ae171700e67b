"""Sentences for a terminal and for a pipe."""

from io import StringIO

import pytest

from robofleet.core.sentences import wrapped


class Terminal(StringIO):
    """A stream that a person reads."""

    def isatty(self) -> bool:
        return True


SENTENCE = "the emergency stop holds: look at the robots, then `robofleet reset platoon` and start them again"


@pytest.mark.parametrize("width", [20, 40, 80])
def test_a_terminal_gets_whole_words_and_whole_commands(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    lines = wrapped(SENTENCE, Terminal()).split("\n")
    assert " ".join(lines) == SENTENCE
    assert all(len(line) <= width or "`" in line for line in lines)
    assert any("`robofleet reset platoon`" in line for line in lines)


def test_lines_stay_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert wrapped("one\ntwo\n", Terminal()) == "one\ntwo\n"


def test_a_long_path_is_not_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    path = "/a/folder/with-a-name/that-is/longer-than-the/terminal"
    assert f"\n{path}\n" in wrapped(f"written: {path} now", Terminal())


def test_a_pipe_gets_what_was_written() -> None:
    assert wrapped(SENTENCE, StringIO()) == SENTENCE
