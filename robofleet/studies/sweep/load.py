"""From a sweep's file to its runs, every one's configuration checked before any is run."""

import os
import shlex
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from hashlib import blake2b
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from robofleet.config.faults import counted
from robofleet.config.files.parameters import load_placed
from robofleet.config.files.yamlfile import Mistake, Node, printable
from robofleet.config.load import Change, ConfigError, spelled
from robofleet.config.tree import Config
from robofleet.envs.evaluation import learned
from robofleet.runs.check import Study as CheckedStudy
from robofleet.runs.check import load_checked
from robofleet.studies.progress import Bar
from robofleet.studies.sweep.plan import Mode, Setting, Sweep, settings

_SEED = "run.seed"

Keys = Sequence[str | int]

Progress = Callable[[int], AbstractContextManager[Bar]]  # shows how many of so many settings were checked


class Planned(NamedTuple):
    """One run."""

    number: int  # from 1
    values: dict[str, Any]  # of the keys that vary
    faults: str | None  # the file's name, as the user wrote it
    seed: int
    config: Config
    replay: str  # the command that runs it again
    mode: Mode


class Study(NamedTuple):
    """A sweep that can be run."""

    name: str
    file: Path
    config: Path
    keys: tuple[str, ...]
    spans: dict[str, bool]  # the keys that were drawn from a continuum, and whether their logarithms were
    runs: tuple[Planned, ...]
    digest: str  # of everything that decides its results but the machine


def load(file: Path, progress: Progress) -> Study:
    """Read a sweep and check each of its runs; ConfigError with everything that is wrong, where it stands."""
    sweep, root = load_placed(Sweep, file)
    if wrong := [*filter(None, _complaints(sweep, root))]:
        raise ConfigError(map(str, wrong))
    config = _beside(file, sweep.config)
    shared = CheckedStudy({}, {})
    changes = [Change(key, _written(root, ("set", key), value)) for key, value in sweep.set.items()]
    plans: list[Planned] = []
    first: dict[tuple[str, ...], tuple[str, str]] = {}  # what is wrong with runs, by its place: a line and a run
    times: Counter[tuple[str, ...]] = Counter()
    count = sweep.total // len(sweep.every_seed)
    for done, setting in enumerate(_each(sweep, progress(count))):
        own = [Change(key, _written(root, path, setting.values[key])) for key, path in setting.paths.items()]
        mode = "lockstep" if setting.case is None else sweep.cases[setting.case].mode
        name = sweep.faults[setting.faults]
        faults = None if name is None else _beside(file, name)
        try:
            tree = load_checked(config, [*changes, *own], faults, lockstep=mode != "real_time", study=shared)
        except ConfigError as error:
            values = ", ".join(f"{key}={spelled(value)}" for key, value in setting.columns.items())
            for line in error.faults:
                position = tuple(line.split(": ")[:2])
                first.setdefault(position, (line, f"run {1 + done * len(sweep.every_seed)}: {values}"))
                times[position] += 1
            continue
        if mode == "environment" and not learned(tree):
            first.setdefault((str(setting.case),), (_no_policy(root, str(setting.case)), ""))
            times[(str(setting.case),)] = count
            continue
        words = _words(config, {**sweep.set, **setting.values}, faults, mode)
        for seed in sweep.every_seed:
            seeded = tree if seed is None else _seeded(tree, seed)
            replay = f"{words} --seed {seeded.run.seed}"
            plans.append(Planned(len(plans) + 1, setting.columns, name, seeded.run.seed, seeded, replay, mode))
    if first:
        raise ConfigError(_lines(first, times, count))
    random = sweep.random.keys.items() if sweep.random else ()
    spans = {key: distribution.log_uniform is not None for key, distribution in random if distribution.span is not None}
    return Study(file.stem, file, config, sweep.keys, spans, tuple(plans), _digest(plans))


def _complaints(sweep: Sweep, root: Node) -> Iterator[Mistake | None]:
    """What is wrong with the file itself."""
    if not sweep.keys:
        message = "names no key to vary: add `grid: {controller.alpha: [30, 45]}`, `random`, or `cases`"
        yield root.mistake((), message)
    for key, distribution in sweep.random.keys.items() if sweep.random else ():
        if (message := distribution.complaint() or "") != "":
            yield root.mistake(("random", "keys", key), message)
    parts: dict[str, tuple[str, ...]] = {}
    own = [("cases", name, "set") for name in sweep.cases]
    for part in (("set",), ("grid",), ("random", "keys"), *own):
        node = _at(root, part)
        if part in own:  # a key may stand in several cases
            parts = {key: at for key, at in parts.items() if at not in own}
        for key in node.value if node is not None and isinstance(node.value, dict) else ():
            if key in parts:
                yield root.mistake((*part, key), f"stands under {'.'.join(parts[key])} already", at_key=True)
            elif key == _SEED:
                yield root.mistake((*part, key), "seeds stand under `seeds`: move it there", at_key=True)
            elif "" in key.split("."):
                yield root.mistake((*part, key), "write a dotted key, for example robots.0.tag", at_key=True)
            parts.setdefault(key, part)
    for i, faults in enumerate(sweep.faults):
        if faults == "none":
            yield root.mistake(("faults", i), "write null for runs without faults")
    if sweep.total > sweep.runs:
        many = " x ".join(f"{number:,} {what}" for what, number in sweep.factors.items() if number > 1)
        message = f"these are {sweep.total:,} runs ({many}): at most {sweep.runs:,} are asked for"
        at = ("runs",) if root.child("runs") else ()
        yield root.mistake(at, f"{message}: leave some out, or write `runs: {sweep.total}`")


def _each(sweep: Sweep, shown: AbstractContextManager[Bar]) -> Iterator[Setting]:
    with shown as bar:
        for setting in settings(sweep):
            yield setting
            bar.add()


def _lines(first: dict[tuple[str, ...], tuple[str, str]], times: Counter[tuple[str, ...]], count: int) -> Iterator[str]:
    """Yield one line for each place; what is wrong with every setting needs no example."""
    for position, (line, example) in first.items():
        share = f" ({example}; so in {counted(times[position], 'setting')} of {count})"
        yield line if times[position] == count else printable(line + share)


def _beside(file: Path, name: str) -> Path:
    return Path(os.path.normpath(file.parent / name))


def _at(root: Node, loc: Keys) -> Node | None:
    node: Node | None = root
    for part in loc:
        node = None if node is None else node.child(part)
    return node


def _written(root: Node, loc: Keys, value: Any) -> Node:
    """Return a value with the places of what stands at ``loc``; a drawn one stands nowhere else."""
    node, named = _at(root, loc), _at(root, loc[:2] if loc[0] == "grid" else loc)
    assert node is not None and named is not None
    return _drawn(node, value) if loc[0] == "random" else replace(node, key=named.key)


def _drawn(at: Node, value: Any) -> Node:
    if isinstance(value, dict):
        value = {key: _drawn(at, child) for key, child in value.items()}
    elif isinstance(value, list):
        value = [_drawn(at, child) for child in value]
    return Node(value, at.position, at.key)


def _seeded(config: Config, seed: int) -> Config:
    return config.model_copy(update={"run": config.run.model_copy(update={"seed": seed})})


def _no_policy(root: Node, case: str) -> str:
    message = "an environment runs the behaviour policy, which no group has: leave the case out"
    return str(root.mistake(("cases", case, "mode"), message))


def _words(config: Path, values: dict[str, Any], faults: Path | None, mode: Mode) -> str:
    words = ["robofleet", "run", str(config), *(() if mode == "real_time" else ("--lockstep",))]
    words += [word for key, value in values.items() for word in ("--set", f"{key}={spelled(value)}")]
    return shlex.join([*words, *(("--faults", str(faults)) if faults is not None else ())])


def _digest(plans: list[Planned]) -> str:
    digest = blake2b(version("robofleet").encode(), digest_size=16)
    for plan in plans:
        digest.update(
            f"{plan.number}\0{plan.values}\0{plan.faults}\0{plan.mode}\0{plan.config.model_dump_json()}\n".encode()
        )
    return digest.hexdigest()
