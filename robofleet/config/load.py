"""Reads a configuration: the file, the files that it names, ``--faults`` and ``--set``. All errors at once.

A bare name in one of ``FOLDERS``' keys, ``robots[].vehicle`` for example, is a file of that folder beside the
configuration, else of the shipped ``configs/``; a name that ends in .yaml is a path from the configuration's folder; a
mapping stands for itself. A reference's ``csv`` is a path from the configuration's folder that ends in .csv; its rows
take the name's place.
"""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Self, TypeVar

import yaml
from pydantic import BaseModel, JsonValue, ValidationError
from pydantic_core import ErrorDetails

from robofleet.config import groups
from robofleet.config.completed import file_path, numbered, placed, with_moving_obstacles
from robofleet.config.faults import (
    Complaint,
    counted,
    cross_checks,
    did_you_mean,
    elsewhere,
    meant,
    meant_among,
    place_of,
    plain_words,
)
from robofleet.config.files.csvfile import read_table
from robofleet.config.files.names import SHIPPED, missing, nearest
from robofleet.config.files.yamlfile import NUMBER_LIKE, Mistake, Node, Position, Source, keys_of, parse_yaml, read_yaml
from robofleet.config.groups import named
from robofleet.config.tree import Config
from robofleet.core.errors import BadInputError
from robofleet.core.plugins import PluginError, reach

FOLDERS: dict[tuple[str, ...], str] = {
    ("robots", "*", "vehicle"): "robots",
    ("robots", "*", "calibration"): "robots",
    ("groups", "*", "settings", "path"): "paths",
    ("groups", "*", "settings", "references", "*", "path"): "paths",
    ("groups", "*", "settings", "task", "path"): "paths",
    ("camera", "model"): "cameras",
    ("cameras", "*", "model"): "cameras",
    ("projectors", "*", "calibration"): "projectors",
}
# CSV files, and their headers
TABLES: dict[tuple[str, ...], tuple[str, ...]] = {
    ("groups", "*", "settings", "references", "*", "csv"): ("t_s", "x_m", "y_m")
}

Loc = tuple[str | int, ...]
Files = dict[Path, tuple[Node | None, list[Mistake]]]  # each file that was read: its tree, and its faults
Loaded = TypeVar("Loaded")


class ConfigError(BadInputError):
    """Raised where a configuration cannot be used: one line for each fault, in the order of the files.

    Attributes:
        faults: The lines.
    """

    def __init__(self, faults: Iterable[str]) -> None:
        """Keep the lines.

        Args:
            faults: One line each.
        """
        self.faults = tuple(faults)
        super().__init__("\n".join(self.faults))


def load_config(file: Path, overrides: Sequence[str] = (), faults_file: Path | None = None) -> Config:
    """Read and validate a configuration.

    Args:
        file: The YAML file.
        overrides: ``KEY=VALUE`` with dotted keys, as behind ``--set``.
        faults_file: A file of faults on purpose, as behind ``--faults``.

    Returns:
        The whole configuration, frozen, with every file that it names.

    Raises:
        ConfigError: Everything that is wrong, one line for each fault.
    """
    return ConfigFile(file, overrides, faults_file).config


def resolved_yaml(config: Config) -> str:
    """Return the whole tree inline; ``load_config`` reads it back to an equal one."""
    return yaml.dump(config.model_dump(mode="json"), Dumper=_Dumper, sort_keys=False, width=110)


def spelled(value: object) -> str:
    """Return a value as it is written behind ``--set KEY=``: one line of YAML that is read back to an equal one."""
    line = yaml.dump(value, Dumper=_Dumper, default_flow_style=True, width=10**9, allow_unicode=True)
    return line.removesuffix("\n").removesuffix("\n...")


class Typed(str):
    """An override that is made of something else: faults in it name ``typed``."""

    typed: str

    def __new__(cls, override: str, typed: str) -> Self:
        made = super().__new__(cls, override)
        made.typed = typed
        return made


class Change(NamedTuple):
    """An override that is written in another file: faults in it name its place there."""

    key: str
    value: Node


class ConfigFile:
    """A configuration that remembers where everything in it was written."""

    config: Config

    def __init__(
        self,
        file: Path,
        overrides: Sequence[str | Change] = (),
        faults_file: Path | None = None,
        files: Files | None = None,
    ) -> None:
        """Read and validate; ConfigError with everything that is wrong.

        ``files``: what was read for another one; a file in it is not read again.
        """
        self._folder = file.parent
        self._faults: list[Mistake] = []
        self._files: Files = {} if files is None else files
        self._sources: list[Source] = []
        self._settings: dict[str, type[BaseModel]] = {}  # of each group's behaviour, by the path where they stand
        root = self._opened(file)
        if root is not None and faults_file is not None:
            root = self._with_faults(root, faults_file)
        for override in overrides:
            root = self._overridden(root, override)
        if root is None:
            raise self._error()
        self._root = self._resolved(root, ())
        self._validate()

    def refuse(self, complaints: Iterable[Complaint]) -> None:
        """Raise a ConfigError that shows the place of every complaint, if there is one."""
        for path, message in complaints:
            self._complain(keys_of(file_path(self.config, path)), message)
        if self._faults:
            raise self._error()

    def _validate(self) -> None:
        kept = self._judged_settings()
        several = self._root.child("cameras")
        if several is not None and self._root.child("camera") is not None:
            self._complain(("cameras",), "camera is written, too: write one of the two", at_key=True)
        elif several is not None and several.plain() == []:
            self._complain(("cameras",), "it has none: name one or more cameras, or write camera in its place")
        try:
            self.config = Config.model_validate(self._root.plain())
        except ValidationError as invalid:
            for error in _each_once(invalid, Config):
                loc = place_of(error)
                if several is not None and loc[:1] == ("camera",):
                    continue  # it is the first of several, where the same is wrong
                unknown = error["type"] == "extra_forbidden"
                message = (self._moved(loc) or self._elsewhere(loc)) if unknown else None
                self._complain(loc, message or plain_words(error), at_key=unknown)
            raise self._error() from None
        self.config = numbered(with_moving_obstacles(self.config))
        self.refuse([*cross_checks(self.config), *self._unreachable()])
        pairs = zip(named(self.config).groups, kept, strict=True)
        made = tuple(group.model_copy(update={"settings": settings}) for group, settings in pairs)
        self.config = self.config.model_copy(update={"groups": made})
        try:
            self.config = placed(self.config)
        except ValueError as impossible:
            self.refuse([("groups", f"cannot be made: {impossible}")])

    def _unreachable(self) -> Iterator[Complaint]:
        """Let classes be found whose modules stand beside the configuration; yields what stands in the way."""
        robots, config = list(enumerate(self.config.robots)), self.config
        named = [
            *((f"robots.{i}.driver", robot.driver) for i, robot in robots),
            *((f"robots.{i}.twin", robot.twin) for i, robot in robots if robot.twin is not None),
            *((f"{path}.source", camera.source) for path, camera in config.camera_keys),
            ("tracker.source", config.tracker.source),
            ("plant.model", config.plant.model),
        ]
        for path, name in named:
            try:
                reach(self._folder, name)
            except PluginError as hidden:
                yield path, str(hidden)

    def _judged_settings(self) -> list[dict[str, JsonValue] | None]:
        """Let each behaviour judge its own settings; returns what it made of them, with its defaults."""
        tree = self._root.plain()
        written = tree.get("groups") if isinstance(tree, dict) else None
        entries = written if isinstance(written, list) else []
        return [self._of_group(i, entry) if isinstance(entry, dict) else None for i, entry in enumerate(entries)]

    def _of_group(self, i: int, group: dict[str, Any]) -> dict[str, JsonValue] | None:
        """Return a group's settings as its behaviour has them; None after a fault, or where the tree has one there."""
        where: Loc = ("groups", i)
        behaviour, given = group.get("behaviour"), group.get("settings", {})
        if not isinstance(behaviour, str) or not isinstance(given, dict):
            return None
        try:
            reach(self._folder, behaviour)
            self._settings[f"groups.{i}.settings."] = settings = groups.load_kind(behaviour).Settings
            return settings.model_validate(given, context={"folder": self._folder}).model_dump(mode="json")
        except PluginError as unknown:
            self._complain((*where, "behaviour"), str(unknown))
        except ValidationError as invalid:
            for error in _each_once(invalid, settings):
                if error["type"] == "missing" and error["loc"][0] in group:
                    continue  # a key of an old file is told of where it stands
                loc = (*where, "settings", *error["loc"])
                self._complain(loc, plain_words(error, settings), at_key=error["type"] == "extra_forbidden")
        return None

    def _moved(self, loc: Loc) -> str | None:
        """Return where a behaviour's own key belongs that stands in its group directly, as it did in old files."""
        behaviour = self._at((*loc[:2], "behaviour"))
        if loc[:1] != ("groups",) or len(loc) != 3 or behaviour is None or not isinstance(behaviour.value, str):
            return None
        try:
            reach(self._folder, behaviour.value)
            known = groups.load_kind(behaviour.value).Settings.model_fields
        except PluginError:
            return None
        if loc[2] not in known:
            return None
        where = ".".join(map(str, (*loc[:2], "settings", loc[2])))
        return f"is a setting of the behaviour {behaviour.value}: write it under `settings:` ({where})"

    def _elsewhere(self, loc: Loc) -> str | None:
        """Return where an unknown key stands in the tree; None where a key beside it is meant, or none is near."""
        name, node = str(loc[-1]), self._at(loc)
        paths = elsewhere(name, {"": Config, **self._settings}, lambda path: self._at(keys_of(path)) is not None)
        without_parents = len(loc) == 1 and any(path.endswith(f".{name}") for path in paths)
        if not paths or node is None or (meant(loc) != loc and not without_parents):
            return None
        option, rest = node.position.source.name, ""
        if option.startswith("--set "):
            rest = option.removeprefix("--set ").removeprefix(".".join(map(str, loc)))
        return f"there is no such key: did you mean {' or '.join(path + rest for path in paths)}?"

    def _at(self, loc: Sequence[str | int]) -> Node | None:
        node: Node | None = self._root
        for part in loc:
            node = None if node is None else node.child(part)
        return node

    def _complain(self, loc: Loc, message: str, *, at_key: bool = False) -> None:
        """Add a fault at the value or the nearest one above it, unless one was reported there already."""
        if (mistake := self._root.mistake(loc, message, at_key=at_key)) is not None:
            self._faults.append(mistake)

    def _error(self) -> ConfigError:
        def position(fault: Mistake) -> tuple[int, int, int]:
            return self._sources.index(fault.position.source), fault.position.line, fault.position.column

        return ConfigError(dict.fromkeys(str(fault) for fault in sorted(self._faults, key=position)))

    # Reading

    def _opened(self, file: Path) -> Node | None:
        """Return the tree of a file that has to be there."""
        try:
            return self._read(file)
        except FileNotFoundError:
            self._faults.append(Mistake(Position(Source(str(file)), 1, 1, ""), missing(file)))
            return None

    def _read(self, file: Path) -> Node | None:
        """Return the tree of a file, read once; None after a fault that leaves none."""
        source = Source(str(file))
        again = source in self._sources
        if not again:
            self._sources.append(source)
        if file not in self._files:
            self._files[file] = read_yaml(file, source)
        node, faults = self._files[file]
        if not again:
            self._faults += faults
        return node

    def _with_faults(self, root: Node, file: Path) -> Node:
        node = self._opened(file)
        if node is not None and isinstance(node.value, dict):
            if not meant_among(node.value, "faults"):
                message = "has no key `faults`: it says what goes wrong, as configs/faults/lossy.yaml does"
                self._faults.append(Mistake(node.position, message))
                return root
            for key, other in node.value.items():
                if key != "faults":
                    self._faults.append(Mistake(other.key, f"unknown key: {did_you_mean(key, ['faults'])}"))
            node = node.value.get("faults", replace(node, value=None))
        return root if node is None else self._placed(root, ["faults"], (), node)

    def _overridden(self, root: Node | None, override: str | Change) -> Node | None:
        if isinstance(override, Change):
            if override.value.position.source not in self._sources:
                self._sources.append(override.value.position.source)
            new = _moved_to(override.key, override.value)
            return root if root is None else self._placed(root, override.key.split("."), (), new)
        key, equals, value = override.partition("=")
        name = override.typed if isinstance(override, Typed) else f"--set {override}"
        source = Source(name, key or override)
        self._sources.append(source)
        parts = key.split(".")
        if not equals or "" in parts:
            message = "write KEY=VALUE with a dotted key, for example robots.0.tag=7"
            self._faults.append(Mistake(Position(source, 1, 1, ""), message))
            return root
        node, faults = parse_yaml(value, source)
        self._faults += faults
        return root if root is None or node is None else self._placed(root, parts, (), node)

    def _placed(self, node: Node, parts: list[str], path: Loc, new: Node) -> Node:
        """Return the tree with ``new`` where ``parts`` lead to."""
        if not parts:
            return new
        node = self._named(node, path)
        if node.bad:
            return node
        part, *rest = parts
        where = ".".join(map(str, path)) or "the configuration"
        if isinstance(node.value, list):
            if not (part.isdecimal() and int(part) < len(node.value)):
                message = f"{where} has {counted(len(node.value), 'item')}, counted from 0: there is no '{part}'"
                message += _by_id(node.value, parts, where)
                self._faults.append(Mistake(new.position, message))
                return node
            i = int(part)
            child = self._placed(node.value[i], rest, (*path, i), new)
            return replace(node, value=[*node.value[:i], child, *node.value[i + 1 :]])
        if not isinstance(node.value, dict):
            self._faults.append(Mistake(new.position, f"{where} is {node.value!r}: it has no '{part}'"))
            return node
        created = replace(new.position, path=".".join(map(str, (*path, part))))
        child = node.value.get(part, Node({}, created, created))
        return replace(node, value={**node.value, part: self._placed(child, rest, (*path, part), new)})

    # Files that the configuration names

    def _resolved(self, node: Node, path: Loc) -> Node:
        """Return the tree with every named file in its place."""
        node = self._named(node, path)
        if isinstance(node.value, dict):
            return replace(node, value={k: self._resolved(v, (*path, k)) for k, v in node.value.items()})
        if isinstance(node.value, list):
            return replace(node, value=[self._resolved(v, (*path, i)) for i, v in enumerate(node.value)])
        return node

    def _named(self, node: Node, path: Loc) -> Node:
        """Return what the file holds if the value at ``path`` is the name of one, else the node itself."""
        if not isinstance(node.value, str):
            return node
        if (columns := _entry_at(path, TABLES)) is not None:
            return self._table(node, columns)
        folder = _entry_at(path, FOLDERS)
        if folder is None:
            return node
        for file in self._candidates(node.value, folder):
            try:
                tree = self._read(file)
            except FileNotFoundError:
                continue
            return replace(node, bad=True) if tree is None else replace(tree, key=node.key)
        self._faults.append(Mistake(node.position, self._not_found(node.value, folder)))
        return replace(node, bad=True)

    def _table(self, node: Node, columns: tuple[str, ...]) -> Node:
        """Return the rows of the CSV file that a node names."""
        name = str(node.value)
        if not name.endswith(".csv"):
            self._faults.append(
                Mistake(node.position, f"{name!r} is no path that ends in .csv: write {Path(name).stem}.csv")
            )
            return replace(node, bad=True)
        file = self._folder / name
        source = Source(str(file))
        self._sources.append(source)
        try:
            rows, faults = read_table(file, source, node.position.path, columns)
        except FileNotFoundError:
            rows, faults = None, [Mistake(node.position, f"there is no file {file}: mend its name")]
        self._faults += faults
        return replace(node, bad=True) if rows is None else replace(rows, key=node.key)

    def _candidates(self, name: str, folder: str) -> list[Path]:
        if name.endswith(".yaml"):
            return [self._folder / name]
        if not re.fullmatch(r"[\w-]+", name):
            return []
        return [parent / folder / f"{name}.yaml" for parent in (self._folder, SHIPPED)]

    def _not_found(self, name: str, folder: str) -> str:
        candidates = self._candidates(name, folder)
        if not candidates:
            stem = Path(name).stem
            return f"{name!r} is neither a name nor a path that ends in .yaml: write {stem}, or {name}.yaml"
        if len(candidates) == 1:
            near = nearest(candidates[0])
            return f"there is no file {candidates[0]}: " + (f"did you mean {near}?" if near else "mend its name")
        known = {file.stem for parent in (self._folder, SHIPPED) for file in (parent / folder).glob("*.yaml")}
        return f"there is no file {candidates[0]}, nor one in {SHIPPED}: {did_you_mean(name, known)}"


def _each_once(invalid: ValidationError, root: type[BaseModel]) -> Iterator[ErrorDetails]:
    """Yield pydantic's errors on a tree of kind ``root``, without those that another one brings about."""
    errors = invalid.errors(include_url=False)
    locs = [place_of(error) for error in errors]
    misspelt = {meant(error["loc"], root) for error in errors if error["type"] == "extra_forbidden"}
    for error, loc in zip(errors, locs, strict=True):
        # Pydantic leaves invalid items out of its count.
        if error["type"] == "too_short" and any(loc == other[: len(loc)] for other in locs if other != loc):
            continue
        if error["type"] == "missing" and loc in misspelt:
            continue  # one typo is one fault
        yield error


def _entry_at(path: Loc, kinds: Mapping[tuple[str, ...], Loaded]) -> Loaded | None:
    """Return what a table of paths says of this one; ``*`` in it is any part."""
    for pattern, kept in kinds.items():
        if len(pattern) == len(path) and all(wild in ("*", part) for wild, part in zip(pattern, path, strict=True)):
            return kept
    return None


def _moved_to(path: str, node: Node) -> Node:
    """Return a tree that stands elsewhere as the value of ``path``: its places keep their lines and columns."""
    value = node.value
    if isinstance(value, dict):
        value = {part: _moved_to(f"{path}.{part}", child) for part, child in value.items()}
    elif isinstance(value, list):
        value = [_moved_to(f"{path}.{i}", child) for i, child in enumerate(value)]
    return replace(node, value=value, position=replace(node.position, path=path), key=replace(node.key, path=path))


def _by_id(items: list[Node], parts: list[str], where: str) -> str:
    """Return the key of the robot that was named by its id."""
    for i, item in enumerate(items):
        if (named := item.child("id")) is not None and named.value == parts[0]:
            return f": write {'.'.join([where, str(i), *parts[1:]])}"
    return ""


class _Dumper(getattr(yaml, "CSafeDumper", yaml.SafeDumper)):  # type: ignore[misc]  # a source build may lack libyaml
    """Writes what ``yamlfile`` reads: no aliases, and quotes around text that looks like a number."""

    def ignore_aliases(self, data: object) -> bool:
        return True

    def represent_text(self, data: str) -> yaml.ScalarNode:
        style = "'" if NUMBER_LIKE.fullmatch(data) else None
        node: yaml.ScalarNode = self.represent_scalar("tag:yaml.org,2002:str", data, style=style)
        return node


_Dumper.add_representer(str, _Dumper.represent_text)
