"""Do the tests see what changes in the firmware's gate and protocol? Mutants of the C sources, and their coverage.

    python -m tools.measure.robots.firmware_mutants             # changes one thing at a time: what no test notices
    python -m tools.measure.robots.firmware_mutants --coverage  # lines and branches that the tests run, by gcov

A mutant is one operator, number or condition that is another one, or one statement that is missing. Some mutants do
what the original does: ``EQUIVALENT`` names them with the reason.
"""

import argparse
import multiprocessing
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from robofleet.simulation import firmware_library

TESTS = ("tests/safety/test_gate_in_c.py", "tests/drivers/test_rfp_frames.py", "tests/simulation/test_rfp_firmware.py")
MUTATED = ("gate.c", "rfp.c", "gate.h", "rfp.h")
COVERED = ("gate.c", "rfp.c", "memory.c", "robot.c")
EQUIVALENT = {  # what a line has become: why it does the same
    "return value <= 0 ? -value : value;": "0 is -0",
    "return value < 1 ? -value : value;": "0 is -0",
    "return a >= b ? a : b;": "of two that are equal",
    "return way <= 0 ? -(int32_t)reach : (int32_t)reach;": "the furthest way is not 0",
    "return way < 1 ? -(int32_t)reach : (int32_t)reach;": "the furthest way is not 0",
    "if (furthest >= reach) {": "a part of reach / furthest = 1 is the whole way",
    "g->moved_by = g->command_nonce <= g->enabled_nonce ? g->command_nonce : g->enabled_nonce;": "as above",
    "const uint32_t passed = now >= g->at ? now - g->at : 0u;": "no time is 0",
    "return limits->max_ramp * (passed <= longest ? passed : longest);": "of two that are equal",
    "static ROM uint32_t crcs[257] = {": "the last one is not read",
    "enum lease_action { LEASE_ACQUIRE = 2, LEASE_TAKE_OVER = 2, LEASE_RELEASE = 3 };": "nothing asks for it",
    "return 1u;": "uncobs: a frame of one byte is as struck as one of none",
}
_PATIENCE_S = 120
_SWAPS = {
    "<": ("<=",), "<=": ("<",), ">": (">=",), ">=": (">",), "==": ("!=",), "!=": ("==",), "&&": ("||",),
    "||": ("&&",), "++": ("--",), "+": ("-",), "-": ("+",), "*": ("/",), "/": ("*",), "<<": (">>",), ">>": ("<<",),
    "&": ("|",), "|": ("&",), "^": ("|",), "true": ("false",), "false": ("true",), "+=": ("-=",), "^=": ("|=",),
    "!": ("",), "~": ("",), "?": ("&& 0 ?",),
}  # fmt: skip
_TOKEN = re.compile(
    r"(?P<skip>/\*.*?\*/|'(?:\\.|[^'])*'|\"[^\"]*\"|->|0x\w{8}u|^#include.*?$|^#(?:ifndef|endif|define \w+$).*?$)"
    r"|(?P<number>\b(?:0x[0-9A-Fa-f]+|\d+)u?\b)|(?P<word>\btrue\b|\bfalse\b)"
    r"|(?P<operator><<|>>|<=|>=|==|!=|&&|\|\||\+\+|\+=|\^=|-=|[-<>+*/&|^!~?])",
    re.DOTALL | re.MULTILINE,
)
_STATEMENT = re.compile(r"^ +(?:[\w>.\[\]-]+ (?:=|\+=|\^=) [^;{]+|[\w>.-]+\+\+|close_by\([^;]+\));", re.MULTILINE)
_POINTER = re.compile(r"(?:struct \w+|uint8_t|char|int32_t) \*$")


class Mutant(NamedTuple):
    """One change: characters ``start`` to ``end`` of a file become ``text``."""

    file: str
    start: int
    end: int
    text: str

    def of(self, source: str) -> str:
        return source[: self.start] + self.text + source[self.end :]

    def line(self, source: str) -> tuple[int, str, str]:
        """Return the number of its line, the line as it was, and as it is."""
        number, column = source.count("\n", 0, self.start), source.rfind("\n", 0, self.start) + 1
        was = source[column : source.find("\n", self.end)]
        return number + 1, was.strip(), Mutant("", self.start - column, self.end - column, self.text).of(was).strip()


def mutants(file: str, source: str) -> Iterator[Mutant]:
    for found in _TOKEN.finditer(source):
        token, (start, end) = found[0], found.span()
        if found["number"]:
            number = int(token.rstrip("u"), 0)
            yield Mutant(file, start, end, f"{number + 1}{'u' if token.endswith('u') else ''}")
        elif not found["skip"] and not (token == "*" and _is_pointer(source, start)):
            for other in _SWAPS.get(token, ()):
                yield Mutant(file, start, end, other)
    for statement in _STATEMENT.finditer(source) if file.endswith(".c") else ():
        indent = len(statement[0]) - len(statement[0].lstrip())
        yield Mutant(file, statement.start() + indent, statement.end(), ";")


def _is_pointer(source: str, at: int) -> bool:
    before = source[:at].rstrip(" ")
    return bool(_POINTER.search(source[max(0, at - 30) : at + 1])) or before.endswith(("(", ",", "=", "return", "\n"))


def survives(mutant: Mutant) -> bool:
    """Return whether no test notices a mutant. One that does not compile, or never ends, is noticed."""
    with tempfile.TemporaryDirectory() as folder:
        sources = Path(folder) / "firmware"
        shutil.copytree(firmware_library.SOURCES, sources)
        changed = sources / mutant.file
        changed.write_text(mutant.of(changed.read_text()))
        return all(_in_a_child(check, sources, folder) for check in (_looked_at, _tested))


def _in_a_child(check: Callable[[], int], sources: Path, cache: str) -> bool:
    """Return whether a check of these sources finds nothing; a mutant may crash, or never end."""
    child = os.fork()
    if child:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(_PATIENCE_S)
    quiet = os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    os.environ["XDG_CACHE_HOME"] = cache
    firmware_library.SOURCES = sources
    firmware_library.FLAGS = (*firmware_library.FLAGS, "-Wno-error", "-O0")
    try:
        os._exit(check())
    finally:
        os._exit(1)


def _looked_at() -> int:
    """Most mutants are noticed within the first steps: no need to collect tests."""
    from tests.drivers import test_rfp_frames as frames
    from tests.safety import test_gate_in_c as gates

    library = firmware_library.firmware_library({}, firmware_library.SOURCES)
    frames.test_every_length_is_the_headers(library)
    frames.test_the_firmware_sends_the_same_frames(library)
    frames.test_frames_that_are_missing_are_counted(library)
    gates.walk(library, 2000, seed=1)
    return 0


def _tested() -> int:
    import pytest

    quiet = ("-W", "ignore::pytest.PytestAssertRewriteWarning")
    return int(pytest.main([*TESTS, "-x", "-n0", "-p", "no:cacheprovider", *quiet]))


def mutate(workers: int, only: str) -> int:
    """Print the survivors; return how many there are that are not known to be equivalent."""
    import tests.drivers.test_rfp_frames
    import tests.safety.test_gate_in_c  # noqa: F401 - each child has them then

    sources = {file: (firmware_library.SOURCES / file).read_text() for file in MUTATED}
    found = [mutant for file in MUTATED if only in file for mutant in mutants(file, sources[file])]
    alive = same = 0
    with multiprocessing.get_context("fork").Pool(workers) as pool:
        for mutant, lives in zip(found, pool.imap(survives, found), strict=True):
            number, was, now = mutant.line(sources[mutant.file])
            if not lives:
                continue
            if now in EQUIVALENT or "RFP_BODY_BYTES" in now:  # a buffer's size, which no frame fills
                same += 1
            else:
                alive += 1
                print(f"{mutant.file}:{number}: {was}\n{' ' * len(f'{mutant.file}:{number}')}> {now}", flush=True)
    counted = len(found) - same
    print(f"{len(found)} mutants, {same} do the same; {counted - alive} of {counted} killed: {1 - alive / counted:.1%}")
    return alive


def coverage() -> dict[str, tuple[float, float]]:
    """Return the shares of lines and of branches that the tests run, by file [%].

    One library is compiled with counters, for the tests that name its sources: the counters of two would overwrite
    each other.
    """
    with tempfile.TemporaryDirectory() as folder:
        code = (
            "import sys, pytest; from robofleet.simulation import firmware_library as f; "
            "made, covered = f.firmware_library, f.firmware_library({}, f.SOURCES, '-O0', '--coverage'); "
            "f.firmware_library = lambda built_in, *sources: covered if sources else made(built_in); "
            f"sys.exit(pytest.main([*{TESTS!r}, '-q', '-n0', '-p', 'no:cacheprovider']))"
        )
        where = Path(folder) / "gcda"
        own = {"XDG_CACHE_HOME": folder, "GCOV_PREFIX": str(where), "GCOV_PREFIX_STRIP": "99"}
        subprocess.run([sys.executable, "-c", code], env=os.environ | own, check=True, stdout=subprocess.DEVNULL)
        for notes in [*Path(folder).rglob("*.gcno")]:
            shutil.copy(notes, where)
        done = subprocess.run(
            ["gcov", "-b", "-n", *map(str, sorted(where.glob("*.gcda")))],
            cwd=where, capture_output=True, text=True, check=True,
        )  # fmt: skip
    shares = {}
    for file in COVERED:
        figures = rf"File '[^']*/{file}'\nLines executed:([\d.]+)%.*\n.*\nTaken at least once:([\d.]+)%"
        (found,) = re.findall(figures, done.stdout)
        shares[file] = float(found[0]), float(found[1])
    return shares


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--coverage", action="store_true", help="print what the tests run, instead of mutants")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", default="", help="a file: gate.c")
    options = parser.parse_args()
    if options.coverage:
        for file, (lines, branches) in coverage().items():
            print(f"{file}: {lines:.1f} % of the lines, {branches:.1f} % of the branches")
    else:
        sys.exit(mutate(options.workers, options.only) > 0)


if __name__ == "__main__":
    main()
