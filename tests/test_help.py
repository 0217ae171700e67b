"""What a terminal offers before a command is given: help with examples, and completion by the shell."""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from robofleet import cli
from robofleet.bus.arena_file import claimed
from robofleet.config.load import load_config

ROOT = Path(__file__).parents[1]


def _commands(group: Any, *before: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the words of every command and group, and itself."""
    for name, command in group.commands.items():
        yield (*before, name), command
        if hasattr(command, "commands"):
            yield from _commands(command, *before, name)


COMMANDS = dict(_commands(get_command(cli.app)))
SINGLE = [words for words, command in COMMANDS.items() if not hasattr(command, "commands")]


def helped(*words: str) -> str:
    result = CliRunner().invoke(cli.app, [*words, "--help"], env={"COLUMNS": "80"}, prog_name="robofleet")
    assert result.exit_code == 0, result.output
    return result.stdout


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_the_help_of_every_command_is_short_lines_with_an_example(words: tuple[str, ...]) -> None:
    text = helped(*words)
    assert text.isascii()
    assert max(map(len, text.splitlines())) <= 80 or "  $ " in max(text.splitlines(), key=len)
    assert len(text.splitlines()[0]) <= 60, "it stands in one line of the list of commands"
    assert re.search(rf"^  \$ robofleet {' '.join(words)}( |$)", text, re.MULTILINE)
    assert f"Usage: robofleet {' '.join(words)} " in text


@pytest.mark.parametrize("words", SINGLE, ids=" ".join)
def test_every_argument_and_option_is_explained_and_named_by_its_unit(words: tuple[str, ...]) -> None:
    command = COMMANDS[words].loaded
    for param in command.params:
        if getattr(param, "hidden", False):
            continue
        assert (param.help or "").endswith("."), param.name
        assert param.metavar or getattr(param, "is_flag", False), param.name
    for example in re.findall(rf"^ *\$ robofleet {' '.join(words)} (.+)", command.help, re.MULTILINE):
        command.make_context(words[-1], shlex.split(example))  # a usage error where it is none


def test_help_looks_the_same_with_every_version_of_typer() -> None:
    assert (
        helped("keys", "list")
        == """\
List the certificates, and when each ends.

Usage: robofleet keys list ARENA [OPTIONS]

Arguments
  ARENA  The arena: arena.name of the configuration.

Options
  --json  Print the result as one JSON object.
  --help  Show this message and exit.

Examples
  $ robofleet keys list lab
"""
    )


def test_the_help_is_one_screen_of_all_commands_by_task() -> None:
    lines = helped().splitlines()
    assert len(lines) <= 40
    assert max(map(len, lines)) <= 80
    listed = [command for words, command in COMMANDS.items() if len(words) == 1]
    (more,) = (line for line in lines if line.startswith("More: "))
    for command in listed:
        if command.rich_help_panel is None:
            assert command.name in more.removeprefix("More: ").split(", ")
        else:
            assert sum(bool(re.match(rf".{{14}}{command.name}  ", line)) for line in lines) == 1, command.name


def test_every_word_of_the_help_is_plain_or_a_term() -> None:
    terms = (ROOT / "configs" / "TERMS.md").read_text().casefold()
    for word in ("arena", "configuration", "fleet", "gamepad", "Robotarium", "paper", "fault", "emergency stop", "hold",
                 "pose", "park", "run", "report", "replay", "recording", "tag", "calibration board", "ROS 2",
                 "Foxglove", "Lichtblick", "rerun", "operator", "key", "storm", "sweep", "laboratory"):  # fmt: skip
        assert word.casefold() in helped().casefold(), word
        assert re.search(rf"^\| [^|]*\b{word.casefold()}\b[^|]*\|", terms, re.MULTILINE), f"{word} is no term"


@pytest.mark.parametrize("process", [words[1] for words in SINGLE if words[0] == "node"])
def test_a_process_answers_to_its_old_name_and_says_the_new_one(process: str) -> None:
    result = CliRunner().invoke(cli.app, [process, "--help"], env={"COLUMNS": "80"}, prog_name="robofleet")
    assert result.stdout == helped("node", process)
    assert result.stderr == f"`robofleet {process}` is now `robofleet node {process}`\n"
    assert (process,) not in COMMANDS


@pytest.fixture
def shell(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with ``robofleet`` in it, as it is installed; the arenas lab and hall have a run."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "runtime"))
    (tmp_path / "tmp").mkdir()
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    program = tmp_path / "robofleet"
    program.write_text(f"#!{sys.executable}\nfrom robofleet.cli import main\nmain()\n")
    program.chmod(0o755)
    return tmp_path


def completed(folder: Path, *words: str) -> list[str]:
    """Return what bash offers for the last word, with what robofleet itself installs."""
    script = f"""
        eval "$(_ROBOFLEET_COMPLETE=source_bash robofleet)"
        COMP_WORDS=({" ".join(map(repr, words))}) COMP_CWORD={len(words) - 1}
        _robofleet_completion robofleet
        printf '%s\\n' "${{COMPREPLY[@]}}"
    """
    done = subprocess.run(["bash", "-c", script], cwd=folder, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return done.stdout.split()


@pytest.mark.slow
def test_bash_completes_commands_options_and_arenas_that_have_a_run(shell: Path) -> None:
    config = load_config(ROOT / "configs" / "platoon.yaml", ["bus.endpoint=unixsock-stream//run/lab/bus.sock"])
    with ExitStack() as runs:
        for name in ("lab", "hall"):
            arena = config.arena.model_copy(update={"name": name})
            runs.enter_context(claimed(config.model_copy(update={"arena": arena}), shell))
        assert sorted(completed(shell, "robofleet", "hold", "")) == ["hall", "lab"]
        assert completed(shell, "robofleet", "stop", "h") == ["hall"]
    assert completed(shell, "robofleet", "stop", "") == []
    assert completed(shell, "robofleet", "stat") == ["status"]
    assert completed(shell, "robofleet", "run", "--lock") == ["--lockstep"]


@pytest.mark.slow
def test_bash_is_left_to_complete_files(shell: Path) -> None:
    assert completed(shell, "robofleet", "run", "conf") == []
    script = 'eval "$(_ROBOFLEET_COMPLETE=source_bash robofleet)"; complete -p robofleet'
    done = subprocess.run(["bash", "-c", script], cwd=shell, capture_output=True, text=True, check=True)
    assert "-o default" in done.stdout  # files, where robofleet offers nothing
