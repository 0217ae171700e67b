"""A run's folder that somebody made who means harm: one line and exit code 2, at once and in little memory."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from robofleet.recording.log import FILE, RunLog
from tests.recording import recorded
from tests.reports import hostile
from tests.reports.within import PATIENCE_S, Came, commands

REFUSED = 2
MINE = "somebody's work of a year"


def is_well(came: Came, *, may_succeed: bool = True) -> str:
    """Return what is wrong with how a command ended; nothing where it ended well."""
    if came.raised:
        return came.raised
    if came.took_s > PATIENCE_S:
        return f"it took {came.took_s:.0f} s"
    if not all(c.isprintable() or c == "\n" for c in came.stdout + came.stderr):
        return f"it writes to the terminal what a terminal obeys: {came.stderr!r}"
    if came.exit_code == REFUSED:
        good = len(came.stderr.splitlines()) == 1 and not came.stdout
        return "" if good else f"no single line: {came}"
    return "" if may_succeed and came.exit_code in (0, 1) else f"it is not refused: {came}"


@pytest.mark.slow
@pytest.mark.parametrize("every", [False, pytest.param(True, marks=pytest.mark.long)], ids=["in turn", "every"])
def test_no_recording_harms_who_looks_at_it(tmp_path: Path, every: bool) -> None:
    """``every``: each file by each command, not by one of them in turn."""
    lines, names = [], []
    for k, (name, data) in enumerate(hostile.runs(recorded.config())):
        folder = tmp_path / str(k)
        folder.mkdir()
        (folder / FILE).write_bytes(data)
        for command in ("report", "replay", "repair")[slice(None) if every else slice(k % 3, k % 3 + 1)]:
            names.append(f"{command}, {name}")
            lines.append((command, folder))
    wrong = {name: complaint for name, came in zip(names, commands(lines), strict=True) if (complaint := is_well(came))}
    assert not wrong, "\n".join(f"{name}: {complaint}" for name, complaint in wrong.items())


@pytest.fixture
def run(run_messages: recorded.Messages, tmp_path: Path) -> Path:
    """Return the folder of a good run."""
    folder = tmp_path / "run"
    folder.mkdir()
    with RunLog(folder / FILE, recorded.config()) as log:
        recorded.write(log, run_messages[:300])
    return folder


@pytest.mark.slow
def test_nothing_is_written_through_a_link(run: Path, tmp_path: Path) -> None:
    data = (run / FILE).read_bytes()
    (run / FILE).write_bytes(data[: len(data) * 3 // 4])  # a repair has something to do
    mine = tmp_path / "mine"
    mine.write_text(MINE)
    written = "report.html", "metrics.csv", "compare-run.html", f"{FILE}.repairing", f"{FILE}.damaged"
    for name in (*written, "summary.json"):
        (run / name).symlink_to(mine)
    commands_asked = ("report", run), ("report", run, run), ("repair", run), ("replay", run)
    came = commands([*commands_asked, ("report", run, run, "--out", run / "report.html")])
    assert [is_well(result) for result in came] == [""] * len(came)
    assert mine.read_text() == MINE
    assert not (run / "report.html").is_symlink()
    assert (run / "report.html").read_text().startswith("<!doctype html>")


@pytest.mark.slow
def test_a_file_that_is_damaged_is_not_kept_through_a_link(run: Path, tmp_path: Path) -> None:
    data = bytearray((run / FILE).read_bytes())
    data[len(data) // 2] ^= 1
    (run / FILE).write_bytes(data)
    mine = tmp_path / "mine"
    mine.write_text(MINE)
    (run / f"{FILE}.damaged").symlink_to(mine)
    (came,) = commands([("repair", run)])
    assert is_well(came) == ""
    assert came.exit_code == REFUSED
    assert mine.read_text() == MINE
    assert (run / FILE).read_bytes() == data
    assert {file.name for file in run.iterdir()} == {FILE, f"{FILE}.damaged"}, "nothing half done is left"


@pytest.fixture
def odd(run: Path, tmp_path: Path) -> Iterator[list[Path]]:
    """Return what somebody may name as a run that is none."""
    names = []

    def made(name: str) -> Path:
        names.append(tmp_path / name)
        return names[-1]

    made("nowhere")
    made("folder").mkdir()
    (made("folder of a folder") / FILE).mkdir(parents=True)
    made("nothing.mcap").touch()
    pipe, folder = made("pipe"), made("folder of a pipe")
    folder.mkdir()
    for fifo in (pipe, folder / FILE):
        os.mkfifo(fifo)
    (folder := made("folder of a device")).mkdir()
    (folder / FILE).symlink_to("/dev/zero")
    names.append(Path("/dev/zero"))
    made("dangling").symlink_to(tmp_path / "nothing there")
    (folder := made("folder of a dangling link")).mkdir()
    (folder / FILE).symlink_to(tmp_path / "nothing there")
    (folder := made("folder of a link")).mkdir()
    (folder / FILE).symlink_to(run / FILE)
    made("around").symlink_to(tmp_path / "around")
    (folder := made("folder of nothing")).mkdir()
    (folder / FILE).touch()
    (folder := made("a\x1b[2J\nname")).mkdir()
    names.append(tmp_path / ("x" * 300))
    names.append(run / FILE / FILE)
    names.append(Path(os.fsdecode(bytes(tmp_path) + b"/\xff")))
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(made("socket")))
        yield names


def are_refused(refused: list[tuple[object, ...]]) -> None:
    came = zip(refused, commands(refused), strict=True)
    wrong = [f"{line}: {why}" for line, result in came if (why := is_well(result, may_succeed=False))]
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
def test_what_is_no_recording_is_refused_in_a_line(odd: list[Path], run: Path) -> None:
    commands_asked = [
        (*command, *names)
        for name in odd
        for command, names in ((["report"], [name]), (["replay"], [name]), (["repair"], [name]),
                               (["report"], [run, name]), (["report"], [name, run]))
    ]  # fmt: skip
    are_refused(commands_asked)


@pytest.mark.slow
def test_what_no_page_can_stand_in_is_refused_in_a_line(run: Path, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    outs = ["/dev/null", tmp_path / "pipe", tmp_path, tmp_path / "link", run / FILE / "x", tmp_path / ("x" * 300), ""]
    commands_asked = [("report", run, run, "--out", out) for out in outs]
    for folder in ("report.html", "metrics.csv"):
        commands_asked.append(("report", copy := tmp_path / f"run of {folder}"))
        (copy / folder).mkdir(parents=True)
        (copy / FILE).write_bytes((run / FILE).read_bytes())
    are_refused(commands_asked)
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pipe", "zero", "large", "nested"])
def test_a_summary_that_is_none_is_left_out(run: Path, name: str) -> None:
    file = run / "summary.json"
    match name:
        case "pipe":
            os.mkfifo(file)
        case "zero":
            file.symlink_to("/dev/zero")
        case "large":
            file.write_text('{"outcome": "' + "x" * 100_000_000)
        case "nested":
            file.write_text('{"outcome": ' + hostile.nested(100_000) + "}")
    (came,) = commands([("report", run)])
    assert is_well(came) == ""
    assert "x" * 1000 not in (run / "report.html").read_text()


@pytest.mark.slow
def test_a_folder_whose_name_is_no_text_has_a_report(run: Path) -> None:
    strange = Path(os.fsdecode(bytes(run.parent) + b"/\xff\n$x$"))
    run.rename(strange)
    came = commands([("report", strange), ("report", strange, strange), ("replay", strange), ("repair", strange)])
    assert [is_well(result) for result in came] == [""] * 4
    assert all(result.exit_code != REFUSED for result in came)
