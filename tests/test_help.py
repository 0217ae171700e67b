"""What a terminal offers before a command is given: help with examples, and completion by the shell."""

import os
import re
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from robofleet import cli
from robofleet.bus.arena_file import claimed
from robofleet.config.load import load_config

ROOT = Path(__file__).parents[1]
COMMANDS = sorted(get_command(cli.app).commands)  # type: ignore[attr-defined]


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_every_command_has_an_example(command: str) -> None:
    result = CliRunner().invoke(cli.app, [command, "--help"], env={"COLUMNS": "80"})
    assert result.exit_code == 0
    assert re.search(rf"^ \$ robofleet {command}( |$)", result.stdout, re.MULTILINE)


def test_the_help_names_every_command_and_says_what_to_do_first() -> None:
    text = CliRunner().invoke(cli.app, ["--help"], env={"COLUMNS": "80"}).stdout
    assert [command for command in COMMANDS if not re.search(rf"^│ {command} ", text, re.MULTILINE)] == []
    assert "robofleet check configs/platoon.yaml" in text


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
