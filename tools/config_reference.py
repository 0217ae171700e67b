"""Writes the list of every key into configs/README.md, from the models; ``--check`` only says whether it is up to date.

python tools/config_reference.py
"""

import json
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

import typer

from robofleet.config.patterns import ENDPOINT_PATTERN, NAME_PATTERN
from robofleet.config.schema import NAME_OR_FILE, schema
from robofleet.config.troubles import Timed

README = Path(__file__).resolve().parents[1] / "configs" / "README.md"
COMMAND = "python tools/config_reference.py"
MARK = f"<!-- From here on written by `{COMMAND}`: change robofleet/config, not this. -->\n"

Node = dict[str, Any]
_FAULTS = "faults[]"
_BELOW = "see below"

_UNITS = {
    "m": "m", "mm": "mm", "px": "px", "s": "s", "ms": "ms", "hz": "Hz", "rad": "rad", "deg": "°", "gray": "grey levels",
    "m_s": "m/s", "rad_s": "rad/s", "rad_s2": "rad/s²", "per_s": "1/s", "s_per_rad": "s/rad",
}  # fmt: skip
_UNIT = re.compile(rf"(?:^|_)({'|'.join(sorted(_UNITS, key=len, reverse=True))})$")
_PATTERNS = {
    NAME_OR_FILE: "name of a file",
    NAME_PATTERN: "name",
    ENDPOINT_PATTERN: "`private`, `unixsock-stream//PATH`, `tcp/HOST:PORT`",
}


def main(
    check: Annotated[bool, typer.Option("--check", help="Write nothing; exit code 1 if it is out of date.")] = False,
) -> None:
    """Write the list of every key into configs/README.md."""
    before = README.read_text()
    after = before.partition(MARK)[0] + MARK + reference()
    if check and before != after:
        print(f"{README} is out of date: run {COMMAND}", file=sys.stderr)
        raise typer.Exit(1)
    README.write_text(after)


def reference() -> str:
    """Return a section for every part of the configuration, with a table of its keys."""
    tree = schema()
    models: dict[str, Node] = tree["$defs"]
    where: dict[str, list[str]] = {}  # a part that stands in several places is described once
    for path, name in _parts(tree, models, ""):
        where.setdefault(name, []).append(path)
    sections = [_section("### The parts", tree, tree["properties"])]
    for name, paths in where.items():
        if paths == [_FAULTS]:
            continue
        level = "###" if re.fullmatch(r"\w+(\[\])?", paths[0]) else "####"
        title = ", ".join(f"`{path}`" for path in paths)
        sections.append(_section(f"{level} {title}", models[name], models[name]["properties"]))
    sections += _fault_sections([models[name] for name, paths in where.items() if paths == [_FAULTS]])
    return "\n".join(sections)


def _fault_sections(kinds: list[Node]) -> Iterator[str]:
    """Yield what every kind of fault has, then what each has besides."""
    shared = [
        key for key, node in kinds[0]["properties"].items() if all(node == k["properties"].get(key) for k in kinds)
    ]
    every = {"description": Timed.__doc__}
    yield _section(f"### `{_FAULTS}`", every, {key: kinds[0]["properties"][key] for key in shared})
    for kind in kinds:
        names = _range(kind["properties"]["kind"])
        own = {key: node for key, node in kind["properties"].items() if key not in shared}
        yield _section(f"#### `{_FAULTS}`: {names}", kind, own)


def _parts(model: Node, models: dict[str, Node], path: str) -> Iterator[tuple[str, str]]:
    """Yield where every model stands, and its name, depth first."""
    for key, node in model["properties"].items():
        for suffix, name in _models(node):
            here = f"{path}.{key}{suffix}".removeprefix(".")
            yield here, name
            yield from _parts(models[name], models, here)


def _models(node: Node) -> Iterator[tuple[str, str]]:
    """Yield the names of the models that a key may hold; ``[]``: in a list."""
    if "$ref" in node:
        yield "", _name(node["$ref"])
    for one in node.get("anyOf", []) + node.get("oneOf", []):
        yield from _models(one)
    if "items" in node:
        yield from ((f"[]{suffix}", name) for suffix, name in _models(node["items"]))


def _name(ref: str) -> str:
    return ref.rpartition("/")[2]


def _section(title: str, model: Node, keys: Node) -> str:
    rows = ["| key | unit | range | default | meaning |", "|---|---|---|---|---|"]
    for key, node in keys.items():
        unit = _UNIT.search(key)
        cells = (
            f"`{key}`",
            _UNITS[unit[1]] if unit else "",
            _range(node),
            _default(node, key in model.get("required", ())),
        )
        rows.append(f"| {' | '.join(cells)} | {_prose(node.get('description', ''))} |")
    return "\n".join([title, "", _prose(model["description"]), "", *rows, ""])


def _prose(text: str) -> str:
    return " ".join(text.replace("``", "`").split())


def _default(node: Node, required: bool) -> str:
    if required:
        return "**required**"
    default = node["default"]
    return "its own" if isinstance(default, dict) and default else f"`{json.dumps(default)}`"


def _range(node: Node) -> str:
    """Return what a key may hold, in a few words."""
    if "anyOf" in node:
        return " or ".join(_range(one) for one in node["anyOf"])
    if "$ref" in node or "oneOf" in node:
        return _BELOW
    if "enum" in node or "const" in node:
        return ", ".join(f"`{value}`" for value in node.get("enum", [node.get("const")]))
    return _RANGES[node["type"]](node)


def _number(node: Node) -> str:
    low, high = node.get("minimum"), node.get("maximum")
    above, below = node.get("exclusiveMinimum"), node.get("exclusiveMaximum")
    if low is not None and high is not None:
        return f"{_short(low)} to {_short(high)}"
    limits = ("> ", above), ("≥ ", low), ("< ", below), ("≤ ", high)
    return ", ".join(f"{sign}{_short(limit)}" for sign, limit in limits if limit is not None) or "any number"


def _short(limit: float) -> str:
    """Return a limit as it is written in a few characters."""
    return f"{limit:g}" if limit == float(f"{limit:g}") else str(limit)


def _list(node: Node) -> str:
    if "prefixItems" in node:
        first = _range(node["prefixItems"][0])
        return f"{node['minItems']} values: {first}"
    least, most, of = node.get("minItems"), node.get("maxItems"), _range(node["items"])
    count = f" of {least}" if least and least == most else f" of {least} or more" if least else ""
    return f"list{count}, {of}" if of == _BELOW else f"list{count}: {of}"


_RANGES: dict[str, Callable[[Node], str]] = {
    "null": lambda _node: "null",
    "boolean": lambda _node: "`true`, `false`",
    "integer": lambda node: f"whole, {_number(node)}".removesuffix(" number"),
    "number": _number,
    "string": lambda node: _PATTERNS.get(node.get("pattern", ""), "text"),
    "array": _list,
    "object": lambda _node: "mapping",
}

if __name__ == "__main__":
    typer.run(main)
