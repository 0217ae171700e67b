"""Every command of every README and guide works as it stands, in the order in which it stands.

Cheap commands run in a copy of the configurations; every other one is parsed by the program's own parser, its
configuration is loaded, and the files that it names must be there. What this test does not understand fails.
"""

import argparse
import re
import runpy
import shlex
import shutil
import sys
import tomllib
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.main import get_command
from typer.testing import CliRunner

from robofleet import Fleet, cli
from robofleet.config.load import load_config
from robofleet.experiments.paper import EXPERIMENTS
from robofleet.operator.ending import Ending
from robofleet.runs.check import load_checked
from robofleet.studies.progress import bar
from robofleet.studies.sweep.load import load as load_sweep

ROOT = Path(__file__).parents[1]
FOLDERS = ("configs", "drivers", "robofleet", "tests", "tools")
GUIDES = [*ROOT.glob("*.md"), *(guide for folder in FOLDERS for guide in (ROOT / folder).rglob("*.md"))]
PLACEHOLDERS = {
    "CONFIG": "configs/platoon.yaml", "RUN": "tests/recordings/platoon.mcap", "FILE": "configs/faults/lossy.yaml",
    "SWEEP": "configs/sweeps/gains.yaml", "SCRIPT": "tools/measure/seeded.py", "CHECKOUT": "tests",
    "ARENA": "platoon", "DIR": "new", "NAME": "all", "N": "3", "S": "5", "SEED": "7", "KEY=VALUE": "run.seed=3",
    "CAMERA": "configs/cameras/overhead.yaml", "SURVEY": "survey.yaml", "IMAGES": "photos",
    "/etc/robofleet/lab.yaml": "configs/lab.yaml",  # where tools/deploy installs it
}  # fmt: skip
WRITTEN = {  # by a measurement, or by the reader whom the text tells what to write
    "survey.yaml", "photos", "configs/cameras/ceiling.yaml", "robots.mp4",
    "drivers/firmware/build/uno.hex", "drivers/firmware/build/pico.uf2",
}  # fmt: skip
SHELL = {  # what a system has; a path of the project that it is given must be there
    "cd", "cp", "export", "git", "grep", "install", "ls", "mkdir", "mutmut", "rm", "sed", "source", "sudo", "systemctl",
    "tar", "udevadm", "usermod", "apt", "jupyter", "make", "arduino-cli", "idf.py",
}  # fmt: skip
PROGRAMS = {*SHELL, "robofleet", "python", "python3", "pip", "pytest", "ruff", "mypy", "lint-imports", "calibrate.py"}
MISTAKEN = "lab/lesson/exercise1.yaml"  # its reader finds the mistakes
SCRIPTS = {"calibrate.py": "calibrate", "tag_sheet.py": "sheet"}  # of tools/: the command that each is
SHOWN = (  # blocks that show what something looks like, by their beginning
    "running ", "robot ", "bound not met", "core <", "camera ->", "script ->", "# yaml-language-server", "ros2 launch ",
    "COBS(",
)  # fmt: skip


class Understood(Exception):  # noqa: N818 - no error: a program's parser took its arguments
    """The arguments were parsed: nothing more is wanted."""


def blocks(text: str) -> Iterator[list[str]]:
    """Yield what is indented as code, or fenced without a language, block by block."""
    text = re.sub(r"^```(python|math)\n.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    fenced = re.compile(r"^```\w*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
    text = fenced.sub(lambda code: re.sub("^", "    ", code[1], flags=re.MULTILINE), text)
    for indented, lines in groupby(text.split("\n"), lambda line: line.startswith("    ")):
        if indented:
            yield "\n".join(line.strip() for line in lines).replace("\\\n", " ").split("\n")


def program(command: str) -> str:
    """Return the first word of a command, without the environment's folder."""
    return re.sub(r"^.*\.venv/bin/", "", command.partition(" ")[0])


def is_command(text: str) -> bool:
    return program(text) in PROGRAMS or text.startswith(("tools/", ".venv/bin/"))


def is_yaml(lines: list[str]) -> bool:
    try:
        return isinstance(yaml.safe_load("\n".join(lines).replace(", ...", "")), (dict, list))
    except yaml.YAMLError:
        return False


def commands(guide: Path) -> Iterator[str]:
    """Yield the commands of a guide's blocks and lines, in order; a block that is nothing known is a failure."""
    text = guide.read_text()
    for block in blocks(text):
        if not is_command(block[0]):
            assert is_yaml(block) or block[0].startswith(SHOWN), f"neither command nor YAML: {block[0]}"
            continue
        for line in block:
            command = re.split(r"\s{2,}(?=[^-\s])", line)[0]  # behind wide space: what it is for
            assert is_command(command), f"not understood: {line}"
            yield command
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    prose = "\n".join(line for line in prose.split("\n") if not line.startswith("    "))
    yield from (span for span in re.findall(r"`([^`\n]+)`", prose) if is_command(span))


def split(command: str) -> Iterator[list[str]]:
    """Yield the words of each part of a command line; placeholders are filled in."""
    words = [PLACEHOLDERS.get(word, word) for word in shlex.split(command)]
    for joint, part in groupby(words, lambda word: word in {"&&", ";", "|"}):
        if not joint:
            yield [*part]


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder like the project's: its configurations are a copy."""
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    for name in ("drivers", "tests", "tools", "robofleet"):
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize("guide", GUIDES, ids=lambda guide: str(guide.relative_to(ROOT)))
@pytest.mark.usefixtures("desk")
def test_every_command_of_a_guide_works(guide: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for command in commands(guide):
        for words in split(command):
            try:
                understand(words, monkeypatch)
            except Exception as error:
                raise AssertionError(f"{guide.relative_to(ROOT)}: {command}") from error


def understand(words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a command if that is cheap, else parse it; raises where it would not work."""
    name, *arguments = re.sub(r"^.*\.venv/bin/", "", words[0]), *words[1:]
    if name in {"python", "python3"} and arguments[:2] == ["-m", "pip"]:
        name, *arguments = arguments[1:]
    if name == "robofleet":
        robofleet(arguments, monkeypatch)
    elif name in {"python", "python3"} and arguments[:1] == ["-m"]:
        module(arguments[1], arguments[2:], monkeypatch)
    elif name in {"python", "python3"} and arguments:
        script(arguments[0], arguments[1:], monkeypatch)
    elif name.endswith(".py") and name not in SHELL:
        script(f"tools/{name}" if name == "calibrate.py" else name, arguments, monkeypatch)
    elif name == "pip" and arguments[0] == "wheel":
        assert (ROOT / arguments[-1] / "pyproject.toml").is_file()
    elif name == "pip" and arguments != ["uninstall", "robofleet"]:
        install(arguments)
    elif name == "pytest":
        there([word for word in arguments if "/" in word])
    elif name == "cp" and len(arguments) == 2 and arguments[0] not in WRITTEN:
        shutil.copy(*arguments)
    elif name.startswith("tools/"):
        there([name])
    else:
        assert name in PROGRAMS
        there([word for word in arguments if word.startswith(tuple(f"{folder}/" for folder in FOLDERS))])


def present(path: str) -> bool:
    return any(Path().glob(path)) if "*" in path else Path(path).exists()


def there(paths: list[str]) -> None:
    assert [path for path in paths if path not in WRITTEN and not present(path)] == []


def robofleet(arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    if not arguments:
        return
    name, *rest = arguments
    group: Any = get_command(cli.app)
    if name.startswith("--"):
        assert name in {"--help", *(option for parameter in group.params for option in parameter.opts)}
        return
    command = group.commands.get(name) or group.commands["node"].commands[name]  # a process by its old name
    if rest and hasattr(command, "commands"):
        (command, *_), rest = [command.commands[part] for part in rest[0].split("|")], rest[1:]
    command = getattr(command, "loaded", command)
    if name in {"schema", "init", "check"} and rest and "lab.yaml" not in "".join(rest):
        assert CliRunner().invoke(cli.app, arguments).exit_code == (2 if MISTAKEN in rest else 0)
    elif "--lockstep" in rest and "tracker.source=truth" in rest:  # images take long
        run_shortly(arguments, monkeypatch)
    elif rest:  # `robofleet run` names a command; it needs no arguments there
        values = parsed(command, rest)
        for config in filter(None, (values.get("config"), values.get("live"))):
            changes, faults = [*(values.get("overrides") or ())], values.get("faults")
            if values.get("lockstep"):
                load_checked(config, changes, faults, lockstep=True)
            else:  # there may be no such camera, no such port here
                load_config(Path(config), changes, faults)
        if name == "sweep" and "sweep" in values:
            load_sweep(values["sweep"], lambda sweep: bar("checks", sweep))
        if name == "paper":
            assert values["experiment"] in {"all", *EXPERIMENTS}
        if name not in ("web", "project"):  # their run is an arena, as a rule
            there([str(values[run]) for run in ("run", "other") if values.get(run) is not None])
        there([str(values[file]) for file in ("camera", "survey") if isinstance(values.get(file), Path)])


def run_shortly(arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a lockstep command, without its report and for a moment only."""
    with monkeypatch.context() as patched:
        patched.setattr(Ending, "write_report", lambda _: None)
        done = CliRunner().invoke(cli.app, [*arguments, "--duration=0.2", "--quiet", "--out=tried"])
    shutil.rmtree("tried", ignore_errors=True)
    assert done.exit_code == 0, done.output


def parsed(command: Any, arguments: list[str]) -> dict[str, Any]:
    """Return the values that a command would be called with; its own complaint is raised."""
    if "--help" in arguments:
        return {}
    values: dict[str, Any] = command.make_context(command.name, arguments).params
    return values


def module(name: str, arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    if name == "venv":
        return
    path = ROOT / Path(*name.split("."))
    file = path / "__main__.py" if path.is_dir() else path.with_suffix(".py")
    assert file.is_file(), f"there is no module {name}"
    argparse_only(file, name, arguments, monkeypatch)


def script(path: str, arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    file = ROOT / path
    assert file.is_file(), f"there is no {path}"
    if file.name in SCRIPTS:
        robofleet([SCRIPTS[file.name], *arguments], monkeypatch)
    else:
        argparse_only(file, None, arguments, monkeypatch)


def argparse_only(file: Path, name: str | None, arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a program up to where its parser has taken its arguments."""
    text = file.read_text()
    if "Fleet.from_arguments(" in text:
        Fleet.from_arguments("configs/script.yaml", arguments)
        return
    if "argparse" not in text and "program(" not in text:
        known = set(arguments) <= set(re.findall(r'"(--\w+)"', text))
        assert known, f"{file.name} takes no {arguments}"
        return

    def parse(parser: argparse.ArgumentParser, *_: object, **__: object) -> None:
        _, unknown = parser.parse_known_args(arguments)
        assert unknown == []
        raise Understood

    with monkeypatch.context() as patched:
        patched.setattr(argparse.ArgumentParser, "parse_args", parse)
        if name is not None:
            patched.delitem(sys.modules, name, raising=False)  # runpy wants it fresh
        patched.setattr(sys, "argv", [str(file), *arguments])
        patched.setattr(sys, "path", [str(file.parent), *sys.path])
        with pytest.raises(Understood):
            if name is None:
                runpy.run_path(str(file), run_name="__main__")
            else:
                runpy.run_module(name, run_name="__main__")


def install(arguments: list[str]) -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert arguments[0] == "install"
    for wanted in re.findall(r"\[([\w,]+)\]", " ".join(arguments)):
        assert set(wanted.split(",")) <= extras.keys()


def test_a_command_that_does_not_work_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, desk: Path) -> None:
    assert desk == tmp_path
    for wrong in (
        "robofleet run configs/platoon.yaml --sets run.seed=3",
        "robofleet run configs/platoon.yaml --set run.seeds=3",
        "robofleet run configs/plato.yaml",
        "robofleet runs configs/platoon.yaml",
        "robofleet check configs/platoon.yaml --set groups.0.settings.path_rate=9",
        "robofleet paper platon",
        "robofleet --versoin",
        "python -m tools.measure.runs.kills --often 25",
        "python -m tools.measure.runs.kill",
        "robofleet calibrate offset configs/lab.yaml",
        "python tools/calibrate.py offsets configs/labs.yaml",
        "pip install -e '.[labs]'",
        "pytest tests/driver/x",
        "sl configs",
    ):
        with pytest.raises((Exception, SystemExit)):  # each parser has its own
            for words in split(wrong):
                understand(words, monkeypatch)


@pytest.mark.parametrize("guide", GUIDES, ids=lambda guide: str(guide.relative_to(ROOT)))
def test_every_link_of_a_guide_leads_somewhere(guide: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", guide.read_text()):
        if target.startswith("http"):
            continue
        name, _, heading = target.partition("#")
        page = guide.parent / name if name else guide
        assert page.exists(), target
        if heading:
            headings = re.findall(r"^#+ (.*)$", page.read_text(), re.MULTILINE)
            assert heading in {re.sub(r"[^\w\- ]", "", line.lower()).replace(" ", "-") for line in headings}, target


@pytest.mark.parametrize("guide", GUIDES, ids=lambda guide: str(guide.relative_to(ROOT)))
def test_a_guide_is_short_enough_to_be_read(guide: Path) -> None:
    assert len(guide.read_bytes()) <= 12 * 1024
