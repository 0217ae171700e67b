"""What an operator's command does until its request is out: little, and nothing that other users could delay."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.endpoints import short_folder
from tests.operator.asked_run import asked_run, until_asked

HEAVY = {
    "numpy", "numba", "cv2", "matplotlib", "pydantic", "pydantic_core", "typer", "rich", "yaml", "importlib.metadata",
    "robofleet.cli", "robofleet.config.tree",
}  # fmt: skip
STRANGERS = 3000
NOBODY = 65534
as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can be somebody else")


@pytest.fixture(scope="module")
def environment() -> Iterator[dict[str, str]]:
    """Give an environment in which there is one run, and many files in the names of others."""
    folder = short_folder()
    folder.chmod(0o755)
    register = folder / "tmp" / "robofleet"
    for made, mode in ((folder / "run", 0o700), (register.parent, 0o1777), (register, 0o1777)):
        made.mkdir()
        made.chmod(mode)
    for k in range(STRANGERS):
        file = register / f"lab{k}.{NOBODY}.json"
        file.write_text("{}")
        if os.geteuid() == 0:
            os.chown(file, NOBODY, NOBODY)
    found = os.environ | {"TMPDIR": str(register.parent), "XDG_RUNTIME_DIR": str(folder / "run")}
    with asked_run(found):
        yield found


@pytest.mark.slow_after_first
@pytest.mark.parametrize("words", ["stop", "stop platoon", "hold platoon"])
def test_a_request_is_out_before_any_library_is_loaded_or_file_of_another_user_opened(
    environment: dict[str, str], words: str
) -> None:
    asking = until_asked(words.split(), environment)
    assert asking.what == ("estop" if words.startswith("stop") else "hold")
    assert HEAVY & {*asking.modules} == set()
    files = {Path(file).name for file in asking.opened if file.endswith(".json")}
    assert len(files) == 1, "the own run's"


@pytest.mark.slow
@as_root
def test_root_stops_a_run_of_another_user_whose_file_the_registers_owner_removed() -> None:
    """As seen: who makes /tmp/robofleet first can remove what others write there, or give it a mode of his own."""
    folder = short_folder()
    folder.chmod(0o755)
    temporary = folder / "tmp"
    temporary.mkdir()
    temporary.chmod(0o1777)
    theirs = {name: value for name, value in os.environ.items() if name != "XDG_RUNTIME_DIR"} | {
        "TMPDIR": str(temporary)
    }
    mine = theirs | {"XDG_RUNTIME_DIR": str(folder / "root")}
    with asked_run(theirs, NOBODY) as printed:
        (temporary / "robofleet").rename(temporary / "away")
        (temporary / "robofleet").mkdir(mode=0o700)
        os.chown(temporary / "robofleet", 1, 1)
        command = [sys.executable, "-m", "robofleet", "stop"]
        stopped = subprocess.run(command, env=mine, capture_output=True, text=True, check=False, timeout=60)
        complaint, answer = stopped.stderr.splitlines()
        assert complaint.startswith(f"some runs may not be listed: {temporary}/robofleet is not the folder")
        assert answer.startswith("emergency stop of platoon: NOT acknowledged"), "no robot is there that could say so"
        assert printed.readline() == "estop\n"
