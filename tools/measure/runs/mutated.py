"""Everything that robofleet reads as settings, with mistakes in it: deleted, doubled, of another type, absurd.

    python -m tools.measure.runs.mutated --files 2000 [--seed N]

Each shipped configuration, path, robot, camera, sweep, file of faults and of an experiment, a survey, a robot's own
file, the keys and a bundle are changed at a random place and loaded as ``check`` does, without opening a driver. Only a
refusal in the project's own words may come of it, and none may take long. It prints how many were refused and accepted,
and what else came.
"""

import json
import os
import re
import shutil
import signal
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import Mock

import numpy as np
import yaml

from robofleet.bus import credentials
from robofleet.bus.credentials import KeysError
from robofleet.calibration.extrinsics.survey import load_survey
from robofleet.calibration.store import CalibrationError
from robofleet.config.files.parameters import load_parameters, load_placed
from robofleet.config.files.robot_file import load_robot_file
from robofleet.config.load import ConfigError, ConfigFile
from robofleet.core.clock import S, processor_ns
from robofleet.core.refusal import RefusedError
from robofleet.experiments import paper
from robofleet.hosts import bundle
from robofleet.hosts.authority import Authority
from robofleet.runs.check import refusals
from robofleet.studies.sweep.load import _complaints, load
from robofleet.studies.sweep.plan import Sweep
from tools.measure.program import program

CONFIGS = Path(__file__).parents[3] / "configs"
REFUSALS = ConfigError, RefusedError, CalibrationError, KeysError
_LONG_S = 60  # of the processor, for a loading: the first one may compile kernels
_FEW_RUNS = 50
_ARENA, _NAME = "lab", "r1"
_SURVEY = """floor_tags:
  - {tag: 10, x_m: -1.4, y_m: -0.8, side_m: 0.1, heading_deg: 0}
  - {tag: 11, x_m: 1.4, y_m: -0.8, side_m: 0.1, heading_deg: 0}
points:
  - {name: a, x_m: 1.4, y_m: 0.8, u_px: 100.0, v_px: 200.0}
  - {name: b, x_m: -1.4, y_m: 0.8, u_px: 1000.0, v_px: 200.0}
"""
_SWEEP = """config: ../go-to.yaml
set: {run.duration_s: 6, tracker.source: truth}
grid:
  controller.alpha: [15, 30]
random:
  count: 2
  keys:
    controller.horizon_s: {uniform: [0.4, 0.8]}
    camera.rate_hz: {choice: [20, 30]}
seeds: {first: 1, count: 2}
faults: [null, ../faults/lossy.yaml]
"""
_ROBOT = """arena: lab
unit: r1
router: [tls/192.168.1.5:7447]
allows: {drivers: [gternal], ports: [/dev/ttyUSB0], max_wheel_speed_rad_s: 10}
"""
_ABSURD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 3, 65536, 2**31, 2**63, 2**64, -(2**63) - 1, 10**400, 0.5, -0.5, 1e-300, 1e-9, 1e9,
    1e300, float("nan"), float("inf"), float("-inf"), "", " ", "x", "../../etc/passwd", "/dev/zero", "/dev/tty", "none",
    "1e3", "r1", "\u202e", "\U0001f4a5", "\ud800", "a\nb", "\x00", "x" * 10_000, "a:b", "nowhere:Nothing",
    "tests:Nothing", [], {}, [[]], [None], {"": 1}, {"x": {}}, ["r1"] * 50, [1.0, 2.0], [1e300] * 3, {1: 2},
    {"a" * 5000: 1},
)  # fmt: skip
_TEXTS = (
    "!!python/object/apply:os.system [x]", "&a x", "*a", "<<: {a: 1}", "1:20", "0x10", "010", "1e3", "~", "? x",
    "- - - -", "[" * 200, "{a: " * 60, "\t", "\ufeff", "\u2028", "%YAML 9.9", "--- x\n---\ny", "'", '"', "|", ">",
    "#", ": :", "\x07", "é" * 50, "9" * 5000, "2024-01-01",
)  # fmt: skip


class Kind(NamedTuple):
    file: Path
    load: Callable[[], object]


class Figures(NamedTuple):
    refused: Counter[str]  # by the file's folder
    accepted: Counter[str]
    others: dict[str, str]  # other errors: where each was raised, and one change by which
    longest_s: float


class TooLongError(Exception):
    """A loading took too long."""


def kinds(folder: Path) -> Iterator[Kind]:
    """Yield all kinds of files, in a folder that is filled with them."""
    configs = folder / "configs"
    shutil.copytree(CONFIGS, configs, ignore=shutil.ignore_patterns("*.md", "__pycache__"))

    def config(file: Path, faults: Path | None = None) -> Callable[[], object]:
        def load() -> None:
            source = ConfigFile(file, [], faults)
            source.refuse(complaint for how in (True, False) for complaint in refusals(source.config, lockstep=how))

        return load

    users = {"robots": "platoon", "cameras": "two-cameras", "paths": "platoon"}
    for file in sorted(configs.glob("*.yaml")):
        yield Kind(file, config(file))
    for part, user in users.items():
        for file in sorted((configs / part).glob("*.yaml")):
            text = (configs / f"{user}.yaml").read_text()
            if part == "robots":
                text = re.sub(r"vehicle: \w+", f"vehicle: {file.stem}", text)
            elif part == "paths":
                text = re.sub(r"path: \w+", f"path: {file.stem}", text)
            elif file.stem == "overhead":
                text = (configs / "platoon.yaml").read_text()
            using = configs / f"using-{part}-{file.stem}.yaml"
            using.write_text(text)
            yield Kind(file, config(using))
    for file in sorted((configs / "faults").glob("*.yaml")):
        yield Kind(file, config(configs / "platoon.yaml", file))
    (configs / "sweeps" / "few.yaml").write_text(_SWEEP)
    for file in sorted((configs / "sweeps").glob("*.yaml")):
        yield Kind(file, partial(_load_sweep, file))
    for file in sorted((configs / "paper").glob("*.yaml")):
        with suppress(KeyError, AttributeError):
            kind = getattr(paper._module(file.stem), paper.EXPERIMENTS[file.stem][1])
            yield Kind(file, lambda file=file, kind=kind: load_parameters(kind, file))  # type: ignore[misc]
    survey, robot, packed = folder / "survey.yaml", folder / "robot.yaml", folder / "r1.json"
    survey.write_text(_SURVEY)
    yield Kind(survey, lambda: load_survey(survey))
    robot.write_text(_ROBOT)
    yield Kind(robot, lambda: load_robot_file(robot))
    keys = credentials.keys_folder(_ARENA)
    authority = Authority.create(_ARENA, keys)
    own = authority.issue(_NAME, "unit")
    bundle.write(packed, bundle.bundled(own, credentials.passport(_ARENA, _NAME), ("tls/192.168.1.5:7447",)))
    yield Kind(packed, lambda: bundle.read(packed))
    yield Kind(keys / f"{_NAME}.json", lambda: credentials.credentials(_ARENA, _NAME))
    yield Kind(keys / credentials.REGISTER, lambda: Authority(_ARENA, keys).entries())
    joined = keys / credentials.JOINED
    operator = {"arena": _ARENA, "name": _NAME, "kind": "operator", "router": ["tls/192.168.1.5:7447"]}
    joined.write_text(json.dumps(operator))
    yield Kind(joined, credentials.joined)


def _load_sweep(file: Path) -> None:
    """Load a sweep as it is run, but one of many runs, of which only the file itself is read."""
    sweep, root = load_placed(Sweep, file)
    if wrong := [*_complaints(sweep, root)]:
        raise ConfigError(map(str, wrong))
    if sweep.total <= _FEW_RUNS:
        load(file, lambda _: nullcontext(Mock()))


def changed(  # noqa: PLR0912 - a branch for each kind of mistake
    text: str, rng: np.random.Generator, *, is_json: bool
) -> tuple[bytes, str]:
    """Return a file's text with a mistake, and what the mistake is."""

    def pick(values: Any) -> Any:
        return values[int(rng.integers(len(values)))]

    if rng.random() < 0.6:
        tree = json.loads(text) if is_json else yaml.safe_load(text)
        places = [*_places(tree, ())]
        for _ in range(int(rng.integers(1, 3))):
            where, value = pick(places), pick(_ABSURD)
            with suppress(AttributeError, KeyError, IndexError, TypeError):  # it was changed already
                holder: Any = tree
                for part in where[:-1]:
                    holder = holder[part]
                what = int(rng.integers(4))
                if what == 0:
                    del holder[where[-1]]
                elif what == 1 and isinstance(holder, list):
                    holder.extend([holder[where[-1]]] * int(pick((1, 50))))
                elif what == 1:
                    holder[f"{where[-1]}{pick(('s', ' ', '_m', '.x'))}"] = holder.pop(where[-1])
                else:
                    holder[where[-1]] = value
        unicode = not is_json and bool(rng.integers(2))
        done = json.dumps(tree) if is_json else yaml.safe_dump(tree, sort_keys=False, allow_unicode=unicode)
        return done.encode(errors="surrogatepass"), f"at {where}: {value!r:.60}"
    lines, at = text.splitlines(), int(rng.integers(max(1, len(text.splitlines()))))
    what = int(rng.integers(6))
    if what == 0:
        del lines[at]
    elif what == 1:
        lines.insert(at, lines[at])
    elif what == 2:
        column = int(rng.integers(len(lines[at]) + 1))
        lines[at] = lines[at][:column] + pick(_TEXTS) + lines[at][column:]
    elif what == 3:
        lines[at] = re.sub(r"[-\d.]+", lambda found: pick((found[0], pick(_TEXTS), "1e999", "-0", "9" * 40)), lines[at])
    elif what == 4:
        lines = lines[:at]
    else:
        return "\n".join(lines).encode()[: 40 * at] + rng.bytes(8), f"bytes at {40 * at}"
    return "\n".join(lines).encode(errors="surrogatepass"), f"text {what} at line {at + 1}"


def _places(tree: Any, path: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for part, value in items:
        yield (*path, part)
        yield from _places(value, (*path, part))


@contextmanager
def _at_most(seconds: int) -> Iterator[None]:
    def ring(*_: object) -> None:
        raise TooLongError

    before = signal.signal(signal.SIGPROF, ring)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


def attack(folder: Path, files: int, seed: int) -> Figures:
    """Load so many changed files, of all kinds in turn."""
    rng, every = np.random.default_rng(seed), [*kinds(folder)]
    texts = [kind.file.read_text() for kind in every]
    figures, longest_s = Figures(Counter(), Counter(), {}, 0.0), 0.0
    for k in range(files):
        kind, text = every[k % len(every)], texts[k % len(every)]
        data, change = changed(text, rng, is_json=kind.file.suffix == ".json")
        kind.file.write_bytes(data)
        part, began_ns = f"{kind.file.parent.name}/{kind.file.name}", processor_ns()
        try:
            with _at_most(_LONG_S):
                kind.load()
            figures.accepted[part] += 1
        except REFUSALS as error:
            figures.refused[part] += 1
            assert str(error).isprintable() or "\n" in str(error), (part, change, str(error))
        except Exception as error:  # noqa: BLE001 - that is what is looked for
            last = traceback.extract_tb(error.__traceback__)
            own = [frame for frame in last if "/robofleet/" in frame.filename][-1]
            where = f"{type(error).__name__} in {Path(own.filename).name}:{own.lineno} ({own.name})"
            figures.others.setdefault(where, f"{part}, {change}: {error!s:.200}")
        finally:
            kind.file.write_text(text)
        longest_s = max(longest_s, (processor_ns() - began_ns) / S)
    return figures._replace(longest_s=longest_s)


def main() -> None:
    arguments = program(__doc__, files=2000, seed=1).parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CONFIG_HOME"] = folder
        figures = attack(Path(folder), arguments.files, arguments.seed)
    refused, accepted = figures.refused.total(), figures.accepted.total()
    others = f"{len(figures.others)} other errors; longest {figures.longest_s:.1f} s"
    print(f"{refused} refused, {accepted} accepted, {others}")
    for where, change in figures.others.items():
        print(f"    {where}: {change}")


if __name__ == "__main__":
    main()
