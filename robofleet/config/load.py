"""Reads a configuration: the file, the files that it names, ``--faults`` and ``--set``. All errors at once.

A bare name in ``robots[].vehicle``, ``robots[].calibration``, ``groups[].path`` or ``camera.model`` is a file of
``robots/``, ``paths/`` or ``cameras/`` beside the configuration, else of the shipped ``configs/``; a name that ends in
.yaml is a path from the configuration's folder; a mapping stands for itself.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import yaml
from pydantic import ValidationError

from robofleet.config.faults import Complaint, cross_checks, did_you_mean, meant, place_of, plain_words
from robofleet.config.tree import Config
from robofleet.config.yamlfile import NUMBER_LIKE, Fault, Node, Place, Source, parse_yaml, read_yaml

_SHIPPED = Path(__file__).resolve().parents[2] / "configs"
FOLDERS = {
    ("robots", "*", "vehicle"): "robots",
    ("robots", "*", "calibration"): "robots",
    ("groups", "*", "path"): "paths",
    ("camera", "model"): "cameras",
}

Loc = tuple[str | int, ...]


class ConfigError(Exception):
    """A configuration that cannot be used: one line for each fault, in the order of the files."""

    def __init__(self, faults: Iterable[str]) -> None:
        """Keep the lines."""
        self.faults = tuple(faults)
        super().__init__("\n".join(self.faults))


def load_config(file: Path, overrides: Sequence[str] = (), faults_file: Path | None = None) -> Config:
    """Read and validate a configuration; ``overrides`` are ``KEY=VALUE`` with dotted keys.

    Raises:
        ConfigError: with everything that is wrong.
    """
    return ConfigFile(file, overrides, faults_file).config


def resolved_yaml(config: Config) -> str:
    """Return the whole tree inline; ``load_config`` reads it back to an equal one."""
    return yaml.dump(config.model_dump(mode="json"), Dumper=_Dumper, sort_keys=False, width=110)


class ConfigFile:
    """A configuration that remembers where everything in it was written."""

    config: Config

    def __init__(self, file: Path, overrides: Sequence[str] = (), faults_file: Path | None = None) -> None:
        """Read and validate; ConfigError with everything that is wrong."""
        self._folder = file.parent
        self._faults: list[Fault] = []
        self._files: dict[Path, Node | None] = {}
        self._sources: list[Source] = []
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
            self._complain(tuple(int(p) if p.isdigit() else p for p in path.split(".")), message)
        if self._faults:
            raise self._error()

    def _validate(self) -> None:
        try:
            self.config = Config.model_validate(self._root.plain())
        except ValidationError as invalid:
            errors = invalid.errors(include_url=False)
            locs = [place_of(error) for error in errors]
            misspelt = {meant(error["loc"]) for error in errors if error["type"] == "extra_forbidden"}
            for error, loc in zip(errors, locs, strict=True):
                # Pydantic leaves invalid items out of its count.
                if error["type"] == "too_short" and any(loc == other[: len(loc)] for other in locs if other != loc):
                    continue
                if error["type"] == "missing" and loc in misspelt:
                    continue  # one typo is one fault
                self._complain(loc, plain_words(error), at_key=error["type"] == "extra_forbidden")
            raise self._error() from None
        self.refuse(cross_checks(self.config))

    def _complain(self, loc: Loc, message: str, *, at_key: bool = False) -> None:
        """Add a fault at the value or the nearest one above it, unless one was reported there already."""
        node, depth = self._root, 0
        for part in loc:
            if node.bad or (child := node.child(part)) is None:
                break
            node, depth = child, depth + 1
        if not node.bad:
            place = node.key if at_key else node.place
            path = ".".join(filter(None, (place.path, *map(str, loc[depth:]))))
            self._faults.append(Fault(replace(place, path=path), message))

    def _error(self) -> ConfigError:
        def position(fault: Fault) -> tuple[int, int, int]:
            return self._sources.index(fault.place.source), fault.place.line, fault.place.column

        return ConfigError(dict.fromkeys(str(fault) for fault in sorted(self._faults, key=position)))

    # Reading

    def _opened(self, file: Path) -> Node | None:
        """Return the tree of a file that has to be there."""
        try:
            return self._read(file)
        except FileNotFoundError:
            self._faults.append(Fault(Place(Source(str(file)), 1, 1, ""), "there is no such file"))
            return None

    def _read(self, file: Path) -> Node | None:
        """Return the tree of a file, read once; None after a fault that leaves none."""
        source = Source(str(file))
        if file not in self._files:
            self._sources.append(source)
            self._files[file], faults = read_yaml(file, source)
            self._faults += faults
        return self._files[file]

    def _with_faults(self, root: Node, file: Path) -> Node:
        node = self._opened(file)
        if node is not None and isinstance(node.value, dict):
            for key, other in node.value.items():
                if key != "faults":
                    self._faults.append(Fault(other.key, f"unknown key: {did_you_mean(key, ['faults'])}"))
            node = node.value.get("faults", replace(node, value=None))
        return root if node is None else self._placed(root, ["faults"], (), node)

    def _overridden(self, root: Node | None, override: str) -> Node | None:
        key, equals, value = override.partition("=")
        source = Source(f"--set {override}", key or override)
        self._sources.append(source)
        parts = key.split(".")
        if not equals or "" in parts:
            message = "write KEY=VALUE with a dotted key, for example robots.0.tag=7"
            self._faults.append(Fault(Place(source, 1, 1, ""), message))
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
                message = f"{where} has {len(node.value)} items, counted from 0: there is no '{part}'"
                self._faults.append(Fault(new.place, message))
                return node
            i = int(part)
            child = self._placed(node.value[i], rest, (*path, i), new)
            return replace(node, value=[*node.value[:i], child, *node.value[i + 1 :]])
        if not isinstance(node.value, dict):
            self._faults.append(Fault(new.place, f"{where} is {node.value!r}: it has no '{part}'"))
            return node
        created = replace(new.place, path=".".join(map(str, (*path, part))))
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
        folder = FOLDERS.get(tuple("*" if isinstance(part, int) else part for part in path))
        if folder is None or not isinstance(node.value, str):
            return node
        for file in self._candidates(node.value, folder):
            try:
                tree = self._read(file)
            except FileNotFoundError:
                continue
            return replace(node, bad=True) if tree is None else replace(tree, key=node.key)
        self._faults.append(Fault(node.place, self._not_found(node.value, folder)))
        return replace(node, bad=True)

    def _candidates(self, name: str, folder: str) -> list[Path]:
        if name.endswith(".yaml"):
            return [self._folder / name]
        if not re.fullmatch(r"[\w-]+", name):
            return []
        return [place / folder / f"{name}.yaml" for place in (self._folder, _SHIPPED)]

    def _not_found(self, name: str, folder: str) -> str:
        candidates = self._candidates(name, folder)
        if not candidates:
            return f"{name!r} is neither a name nor a path that ends in .yaml"
        if len(candidates) == 1:
            return f"there is no file {candidates[0]}"
        known = {file.stem for place in (self._folder, _SHIPPED) for file in (place / folder).glob("*.yaml")}
        return f"there is no file {candidates[0]}, nor one in {_SHIPPED}: {did_you_mean(name, known)}"


class _Dumper(yaml.SafeDumper):
    """Writes what ``yamlfile`` reads: no aliases, and quotes around text that looks like a number."""

    def ignore_aliases(self, data: object) -> bool:
        return True

    def represent_text(self, data: str) -> yaml.ScalarNode:
        style = "'" if NUMBER_LIKE.fullmatch(data) else None
        return self.represent_scalar("tag:yaml.org,2002:str", data, style=style)


_Dumper.add_representer(str, _Dumper.represent_text)
