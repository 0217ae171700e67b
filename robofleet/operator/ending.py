"""What ``robofleet run`` says and leaves in the end: why it ended, the table, the files, and the exit code."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console, RenderableType
from rich.text import Text

from robofleet.config import groups
from robofleet.config.files.yamlfile import printable
from robofleet.config.tree import Config
from robofleet.core.files import write_text
from robofleet.core.valid_json import dumps
from robofleet.recording.log import FILE
from robofleet.recording.reading import RecordingError
from robofleet.recording.run import Recording, Run
from robofleet.reports import junit
from robofleet.reports.bounds import complaints
from robofleet.reports.metrics import summary
from robofleet.reports.sampled import look
from robofleet.reports.tables import summary_table


class Result(NamedTuple):
    """What a run left."""

    summary: dict[str, Any]
    columns: Run  # of its file


def columns_of(config: Config, folder: Path) -> Run:
    """Return what is in the run's file, whatever became of the recorder; nothing, if it never came to write."""
    try:
        return look(folder, groups.own(config).__contains__)
    except RecordingError as error:
        if (folder / FILE).exists() or not folder.exists():  # a run that never began has a folder and no file
            print(error, file=sys.stderr)
        return Run(Recording(config))


def result_of(columns: Run, **ended: Any) -> Result:
    """Return the result of a run; ``ended``: how it ended, as ``metrics.summary`` takes it."""
    return Result(summary(columns.recording, run=columns, **ended), columns)


def say(what: RenderableType, *, stderr: bool = False) -> None:
    """Print something: in a terminal lines break at words, in a file or a pipe a sentence is one line."""
    console = Console(stderr=stderr, highlight=False)
    console.print(Text(what) if isinstance(what, str) else what, soft_wrap=not console.is_terminal)


@contextmanager
def _waiting(words: str, *, quiet: bool) -> Iterator[None]:
    """Say on stderr what is waited for; a terminal shows it until it is done."""
    console = Console(stderr=True)
    if quiet:
        yield
    elif console.is_terminal:
        with console.status(words):
            yield
    else:
        print(words, file=sys.stderr)
        yield


class Ending:
    """The end of a run whose summary is made; results that cannot be kept are in ``lost``, a line each."""

    def __init__(self, config: Config, folder: Path, result: Result) -> None:
        self._config, self._folder = config, folder
        self._summary, self._columns = result
        self.lost: list[str] = []

    def tell(self, *, as_json: bool, quiet: bool = True) -> None:
        """Say why the run ended, then what it measured; write summary and report. ``quiet``: not what it waits for."""
        summary, completed = self._summary, self._summary["outcome"] == "completed"
        if not completed:
            say(f"{summary['outcome']}: {summary['cause']}", stderr=True)
        if dropped := summary["recording"]["dropped"]:
            many = f"{dropped:,} message{'s' * (dropped > 1)} of the run"
            self._lose(self._folder / "run.mcap", f"it lacks {many}: make room, and run it again")
        kept = self.write_summary("it is printed instead")
        if as_json or not kept:
            print(dumps(summary))
        elif completed or summary["ticks"]:
            say(summary_table(summary, self._config))
        with _waiting("The report is being made ...", quiet=quiet or as_json):
            page = self.write_report()
        for file in () if as_json else (self._folder / "summary.json" if kept else None, page):
            if file is not None:
                print(printable(str(file)))
        for line in complaints(summary):
            say(line, stderr=True)

    def write_junit(self, file: Path) -> None:
        try:
            junit.write(self._summary, self.lost, file)
        except OSError as error:
            self._lose(file, f"cannot be written: {error.strerror}: make room")

    def bad(self, *, strict: bool) -> bool:
        """Return whether the exit code is 1."""
        missed = strict and not all(bound["pass"] for bound in self._summary["bounds"])
        return self._summary["outcome"] != "completed" or bool(self.lost) or missed

    def _lose(self, file: Path, why: str) -> None:
        self.lost.append(printable(f"results are lost: {file}: {why}"))
        print(self.lost[-1], file=sys.stderr)

    def write_summary(self, instead: str) -> bool:
        """Return whether it could be written; ``instead``: where it is, if not."""
        file = self._folder / "summary.json"
        try:
            write_text(file, dumps(self._summary, indent=1) + "\n")
        except OSError as error:
            self._lose(file, f"cannot be written: {error.strerror}: {instead}")
            return False
        return True

    def write_report(self) -> Path | None:
        """Write the run's report; where that fails, the run and its summary are there all the same."""
        if not self._summary["recording"]["messages"]:  # the operator ended it before it began
            return None
        try:
            from robofleet.reports import after  # noqa: PLC0415 - matplotlib takes a second to load

            made = after.report(self._folder, imports=groups.own(self._config).__contains__, columns=self._columns)
        except OSError as error:
            self._lose(self._folder / "report.html", f"cannot be written: {error.strerror}: make room")
            return None
        except RecordingError as error:
            if self._summary["ticks"]:
                self._lose(self._folder / "report.html", f"there is none: {error}")
            else:
                print("there is no report: the run ended before anything was recorded", file=sys.stderr)
            return None
        if made.trouble is not None:
            self._lose(self._folder / "run.mcap", f"it {made.trouble}: `robofleet repair` mends it")
        return made.page
