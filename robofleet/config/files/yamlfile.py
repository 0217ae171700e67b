"""Strict YAML: every value with its line and column. What YAML 1.1 would quietly misread is refused."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import yaml

from robofleet.config.files import names
from robofleet.core.files import read_named

Value = dict[str, "Node"] | list["Node"] | str | int | float | bool | None

_TAG = "tag:yaml.org,2002:"
_SCALARS = {_TAG + kind for kind in ("null", "bool", "int", "float", "str")}
_ALIAS, _EXPLICIT = "!alias", "!explicit "
_LARGEST_DOCUMENT_BYTES = 1 << 20  # of a document: a hundred robots with their calibrations fit twice
_MCAP_MAGIC = b"\x89MCAP"
_DEEPEST_NESTING = 32
_LONGEST_NUMBER = 100  # [characters]; a longer one takes its time, and is none that can be meant
_CLOSE = {True: "write ] at its end, and commas between its items", False: "write } at its end, and commas between"}
_MISPLACED = re.compile("mapping values are not allowed|expected <block end>|expected <document start>")
_GLUED = re.compile(r"\s*(?:- )?([A-Za-z_]\w*:)[^\s:]")  # key:value
NUMBER_LIKE = re.compile(r"[-+]?(?:[0-9][0-9_]*\.?[0-9_]*|\.[0-9][0-9_]*)(?:[eE][-+]?[0-9]+)?|0o[0-7]+")


@dataclass(frozen=True)
class Source:
    """Where a text came from: a file, named as the user named it, or one ``--set`` of ``key``."""

    name: str
    key: str = ""


@dataclass(frozen=True)
class Position:
    """A line and a column (from 1) of a source, and the dotted path that stands there."""

    source: Source
    line: int
    column: int
    path: str


@dataclass(frozen=True)
class Mistake:
    """Something wrong at a place."""

    position: Position
    message: str

    def __str__(self) -> str:
        """Return one line, ``file:line:column: path: message``; a ``--set`` has no line and column."""
        source = self.position.source
        where = source.name if source.key else f"{source.name}:{self.position.line}:{self.position.column}"
        line = ": ".join(part for part in (where, self.position.path, self.message) if part)
        return printable(line)


def printable(text: str) -> str:
    """Return a text as one line that no terminal obeys: what cannot be shown is written out."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


@dataclass(frozen=True)
class Node:
    """A value, where it stands and where its key stands; ``bad`` when a fault was reported here already."""

    value: Value
    position: Position
    key: Position
    bad: bool = False

    def child(self, part: str | int) -> "Node | None":
        """Return what a key or an index leads to, None if nothing."""
        if isinstance(self.value, dict):
            return self.value.get(str(part))
        if isinstance(self.value, list) and isinstance(part, int) and 0 <= part < len(self.value):
            return self.value[part]
        return None

    def mistake(self, keys: Sequence[str | int], message: str, *, at_key: bool = False) -> Mistake | None:
        """Return a mistake at the value that keys lead to, or at the nearest one above; None where one is reported."""
        node, depth = self, 0
        for part in keys:
            if node.bad or (child := node.child(part)) is None:
                break
            node, depth = child, depth + 1
        if node.bad:
            return None
        position = node.key if at_key else node.position
        path = ".".join(filter(None, (position.path, *map(str, keys[depth:]))))
        return Mistake(replace(position, path=path), message)

    def plain(self) -> object:
        """Return the value without its places."""
        if isinstance(self.value, dict):
            return {key: node.plain() for key, node in self.value.items()}
        if isinstance(self.value, list):
            return [node.plain() for node in self.value]
        return self.value


def keys_of(path: str) -> tuple[str | int, ...]:
    """Return the keys and indices of a dotted path."""
    return tuple(int(part) if part.isdigit() else part for part in path.split("."))


def read_yaml(file: Path, source: Source) -> tuple[Node | None, list[Mistake]]:
    """Read a file: its tree (None when there is none) and its faults.

    Raises:
        FileNotFoundError: there is no such file.
    """
    try:
        data = read_named(file, _LARGEST_DOCUMENT_BYTES)
    except FileNotFoundError:
        raise
    except IsADirectoryError:
        return None, [Mistake(Position(source, 1, 1, ""), f"is a folder: {names.in_folder(file)}")]
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        return None, [Mistake(Position(source, 1, 1, ""), f"cannot be read: {reason}")]
    return parse_bytes(data, source)


def parse_bytes(data: bytes, source: Source) -> tuple[Node | None, list[Mistake]]:
    """Parse what a file holds: its tree (None when there is none) and its faults."""
    if data.startswith(_MCAP_MAGIC):
        message = f"is a recording, not a configuration: `robofleet report {source.name}` reads it"
        return None, [Mistake(Position(source, 1, 1, source.key), message)]
    if len(data) > _LARGEST_DOCUMENT_BYTES:
        return None, [Mistake(Position(source, 1, 1, source.key), f"is longer than {_LARGEST_DOCUMENT_BYTES} bytes")]
    try:
        return parse_yaml(data.decode("utf-8-sig"), source)
    except UnicodeDecodeError as error:
        position = _place_of(source, data[: error.start].decode("utf-8-sig"))
        return None, [Mistake(position, "is not UTF-8 text: save the file as UTF-8")]


def parse_yaml(text: str, source: Source) -> tuple[Node | None, list[Mistake]]:
    """Parse one document: its tree (None when there is none) and its faults."""
    node, faults = _parsed(text, source)
    return node, [*faults]


@lru_cache(maxsize=64)  # vehicles and paths are named by many configurations, and nobody changes a tree
def _parsed(text: str, source: Source) -> tuple[Node | None, tuple[Mistake, ...]]:
    try:
        root = _Loader(text).get_single_node()
    except yaml.MarkedYAMLError as error:
        return None, (_syntax_fault(error, source, text),)
    except yaml.reader.ReaderError as error:
        message = f"the character {error.character!r} may not stand in YAML"
        return None, (Mistake(_place_of(source, text[: error.position]), message),)
    except RecursionError:
        return None, (Mistake(Position(source, 1, 1, source.key), "is nested too deeply"),)
    except (ValueError, OverflowError) as error:  # an escape beyond Unicode
        return None, (Mistake(Position(source, 1, 1, source.key), f"is not YAML: {error}"),)
    if root is None:
        return None, (
            Mistake(Position(source, 1, 1, source.key), "is empty: copy configs/platoon.yaml, and change it"),
        )
    walk = _Walk(source)
    node = walk.node(root, source.key, None)
    return node, tuple(walk.faults)


def _place_of(source: Source, before: str) -> Position:
    lines = before.split("\n")
    return Position(source, len(lines), len(lines[-1]) + 1, source.key)


def _syntax_fault(error: yaml.MarkedYAMLError, source: Source, text: str) -> Mistake:
    """Return PyYAML's complaint in plain words, where the mistake is: often above the place where it was noticed."""
    problem, mark = error.problem or "", error.problem_mark or error.context_mark
    opened = error.context_mark or mark
    message = "is not YAML: " + ", ".join(part for part in (error.context, problem) if part)
    if problem == "but found another document":
        message = "a second document starts here: a file holds one"
    elif r"'\t'" in problem:
        message = "a tab stands here: indent with spaces"
    elif problem.startswith("found character") and "cannot start" in problem:
        message = f"YAML keeps this character for itself: quote the text, {problem.split()[2]} included"
    elif "could not find expected ':'" in problem:
        mark, message = opened, "this key has no colon: write `key: value`"
    elif problem.startswith(("expected ',' or", "did not find expected ',' or")):
        mark, message = (
            opened,
            f"this {'list' if ']' in problem else 'mapping'} is not closed: {_CLOSE[']' in problem]}",
        )
    elif "unexpected end of stream" in problem and "quoted" in (error.context or ""):
        mark, message = opened, "this quotation mark has no second one: close it"
    elif _MISPLACED.search(problem):
        message = "is in the wrong place: indent the keys of one mapping alike"
        before = [i for i, line in enumerate(text.split("\n")[: mark.line if mark else 0]) if line.strip()]
        if before and (glued := _GLUED.match(text.split("\n")[before[-1]])):
            message = "no space follows the colon: write `key: value`"
            return Mistake(Position(source, before[-1] + 1, glued.start(1) + 1, source.key), message)
        if "mapping values" in problem:
            message += ", and quote a text that holds a colon"
    line, column = (mark.line + 1, mark.column + 1) if mark else (1, 1)
    return Mistake(Position(source, line, column, source.key), message)


class _Loader(yaml.SafeLoader):
    """Marks aliases (they can explode) and explicit tags for the walk to refuse, and follows neither.

    RecursionError where the document is nested too deeply.
    """

    _depth = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        self._depth += 1
        if self._depth > _DEEPEST_NESTING:
            raise RecursionError
        node = self._composed(parent, index)
        self._depth -= 1
        return node

    def _composed(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent):
            self.get_event()  # type: ignore[no-untyped-call]
            return yaml.ScalarNode(_ALIAS, f"*{event.anchor}", event.start_mark, event.end_mark)  # type: ignore[arg-type]
        tag = getattr(event, "tag", None)
        node = super().compose_node(parent, index)
        if tag is not None and node is not None:
            node.tag = _EXPLICIT + tag
        return node


class _Walk:
    """From PyYAML's nodes to ours, collecting what is refused on the way."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self.faults: list[Mistake] = []

    def node(self, node: yaml.Node, path: str, key: Position | None) -> Node:
        position = self._place(node, path)
        value: Value = None
        message = None
        if node.tag.startswith(_EXPLICIT):
            message = f"tags are not read: remove {node.tag.removeprefix(_EXPLICIT + _TAG)!r}"
        elif isinstance(node, yaml.MappingNode):
            value = self._mapping(node, path)
        elif isinstance(node, yaml.SequenceNode):
            value = [self.node(child, _join(path, str(i)), None) for i, child in enumerate(node.value)]
        else:
            value, message = _scalar(node)
        if message:
            self.faults.append(Mistake(position, message))
        return Node(value, position, key or position, bad=message is not None)

    def _mapping(self, node: yaml.MappingNode, path: str) -> dict[str, Node]:
        children: dict[str, Node] = {}
        for key_node, value_node in node.value:
            key = key_node.value if isinstance(key_node, yaml.ScalarNode) else ""
            position = self._place(key_node, _join(path, key))
            if key_node.tag == _TAG + "merge":
                message = "merge keys are not read: write the keys out"
            elif key_node.tag != _TAG + "str" or not key.isprintable() or not key:
                message = f"a key must be text: quote it, '{key}'" if key else "a key must be text"
            elif key in children:
                message = f"is written twice, first on line {children[key].key.line}: remove one"
            else:
                children[key] = self.node(value_node, position.path, position)
                continue
            self.faults.append(Mistake(position, message))
        return children

    def _place(self, node: yaml.Node, path: str) -> Position:
        return Position(self.source, node.start_mark.line + 1, node.start_mark.column + 1, path)


def _join(path: str, part: str) -> str:
    return ".".join(filter(None, (path, part)))


def _scalar(node: yaml.Node) -> tuple[Value, str | None]:
    """Return a scalar's value, and what is wrong with it (None if nothing)."""
    text, kind = str(node.value), node.tag.removeprefix(_TAG)
    if node.tag not in (_ALIAS, _TAG + "str") and len(text) > _LONGEST_NUMBER:
        return None, "is a number too long to be read"
    if node.tag == _ALIAS:
        return None, f"aliases are not read: write out what {text} stands for"
    if node.tag not in _SCALARS:
        return None, f"YAML takes {text} for a {kind}: quote it, '{text}'"
    try:
        value: Value = yaml.constructor.SafeConstructor().construct_object(node)
        plain = isinstance(node, yaml.ScalarNode) and node.style is None
        return value, _misread(text, kind, value) if plain else None
    except ValueError:  # Python's limit of digits
        return None, "is a number too long to be read"


def _misread(text: str, kind: str, value: Value) -> str | None:
    """Return how YAML 1.1 takes an unquoted scalar for something else than it looks like."""
    mend = ""
    if kind == "bool" and text.lower() not in ("true", "false"):
        mend = f"{str(value).lower()}: write true or false, or quote it, '{text}'"
    elif kind == "int" and re.match(r"[-+]?0[0-7_]", text):
        mend = f"octal, {value}: write {int(text.replace('_', ''))} without the zero, or quote it, '{text}'"
    elif kind in ("int", "float") and ":" in text:
        mend = f"base 60, {value}: write {value}, or quote it, '{text}'"
    elif kind == "str" and len(text) <= _LONGEST_NUMBER and NUMBER_LIKE.fullmatch(text):
        mend = f"text: write {_spelled(text)}, or quote it, '{text}'"
    return f"YAML reads {text} as {mend}" if mend else None


def _spelled(text: str) -> str:
    """Return how YAML 1.1 wants the number to be written."""
    if text.startswith("0o"):
        return str(int(text, 8))
    mantissa, _, exponent = text.lower().replace("_", "").partition("e")
    if not exponent and "." not in mantissa:
        return str(int(mantissa))
    mantissa = re.sub(r"^([-+]?)\.", r"\g<1>0.", mantissa if "." in mantissa else mantissa + ".0")
    sign = "" if not exponent or exponent[0] in "+-" else "+"
    return f"{mantissa}e{sign}{exponent}" if exponent else mantissa
