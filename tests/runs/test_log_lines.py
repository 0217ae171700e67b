"""A line that cannot be written raises nothing, wherever it is said from."""

import io
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from robofleet.core.log_lines import Unfailing, never_raise


class Broken(io.StringIO):
    """A stream that fails as it is told to."""

    def __init__(self, error: Exception) -> None:
        super().__init__()
        self.error = error

    def write(self, _text: str) -> int:
        raise self.error

    def flush(self) -> None:
        raise self.error


FAULTS = [OSError(28, "No space left on device"), BrokenPipeError(32, "Broken pipe"), ValueError("closed"),
          UnicodeEncodeError("ascii", "é", 0, 1, "no"), RuntimeError("reentrant call")]  # fmt: skip


@pytest.mark.parametrize("error", FAULTS, ids=repr)
@pytest.mark.filterwarnings("error::pytest.PytestUnhandledThreadExceptionWarning")
def test_nothing_that_is_said_raises(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", Broken(error))
    monkeypatch.setattr(sys, "stdout", Broken(error))
    never_raise(stdout=True)
    print("a line", file=sys.stderr, flush=True)
    print("a line", flush=True)
    sys.stderr.writelines(["a", "b"])
    thread = threading.Thread(target=print, args=("from a thread",), kwargs={"file": sys.stderr, "flush": True})
    thread.start()
    thread.join()


def test_what_can_be_written_is_and_the_stream_is_itself() -> None:
    stream = io.StringIO()
    stream_log = Unfailing(stream)
    assert print("one", file=stream_log, flush=True) is None  # type: ignore[call-overload]
    stream_log.writelines(["two\n", "three\n"])
    assert stream_log.getvalue() == "one\ntwo\nthree\n"
    assert stream_log.isatty() is False


def test_results_on_stdout_still_fail_where_nobody_can_take_them(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    monkeypatch.setattr(sys, "stdout", Broken(FAULTS[0]))
    never_raise()
    once = sys.stderr
    never_raise()
    assert sys.stderr is once, "it is installed once"
    with pytest.raises(OSError, match="No space"):
        print("a result")


SAYS = """
import sys, threading, warnings, logging
from robofleet.core.log_lines import never_raise
never_raise(stdout=True)
print("a line", file=sys.stderr, flush=True)
print("a line")
warnings.warn("a warning")
logging.getLogger("x").warning("a library's line")
def fails():
    raise ValueError("in a thread")
thread = threading.Thread(target=fails)
thread.start()
thread.join()
sys.exit(7)
"""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_process_whose_log_is_full_ends_by_its_own_word() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([sys.executable, "-c", SAYS], stdout=full, stderr=full, check=False, timeout=60)
    assert done.returncode == 7
