"""Writes the list of every key into configs/keys, a file a part; ``--check`` only says whether it is up to date.

python tools/config_reference.py
"""

import json
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any

from packages import needing

with needing():
    import typer

    from robofleet.config import groups
    from robofleet.config.schema import NAME_OR_FILE, TABLE_FILE, behaviours, schema
    from robofleet.config.troubles import Timed
    from robofleet.core.patterns import ENDPOINT_PATTERN, NAME_PATTERN

KEYS = Path(__file__).resolve().parents[1] / "configs" / "keys"
COMMAND = "python tools/config_reference.py"
MARK = f"<!-- Written by `{COMMAND}`: change robofleet/config or robofleet/behaviours, not this. -->\n"
_BEHAVIOURS = """# Settings of the behaviours

These keys stand in `groups[].settings`, and `groups[].behaviour` says whose they are. A behaviour of your own has the
keys of its class `Settings`.
"""
_GUIDE = """# Every key of a configuration

- The end of a key's name is its unit: `spacing_m` is in metres.
- World frame: the origin is the arena's centre on the floor, x points along the long side, y to the left, z up.
  Headings are counter-clockwise.
- `robots[]` stands for any item of the list `robots`.
- "its own" in the column "default": the keys in this part have defaults of their own.
- Times of faults, and of the simulated camera's troubles, count from the start of the run.
- `--set KEY=VALUE` changes any key for one run. Items of a list have numbers from 0: `--set robots.0.tag=7`.
"""

Node = dict[str, Any]
_FAULTS = "faults[]"
_TWIN = "cameras[]."  # each part of it is described as a part of `camera`
_BELOW = "see below"
_OWN_PAGE = {"camera.simulated": "simulated_camera"}  # parts of a part that have a page of their own

_UNITS = {
    "m": "m", "mm": "mm", "px": "px", "s": "s", "ms": "ms", "hz": "Hz", "rad": "rad", "deg": "°", "gray": "grey levels",
    "m_s": "m/s", "m_s2": "m/s²", "rad_s": "rad/s", "rad_s2": "rad/s²", "per_s": "1/s", "s_per_rad": "s/rad",
}  # fmt: skip
_UNIT = re.compile(rf"(?:^|_)({'|'.join(sorted(_UNITS, key=len, reverse=True))})$")
_PATTERNS = {
    NAME_OR_FILE: "name of a file",
    TABLE_FILE: "name of a CSV file",
    NAME_PATTERN: "name",
    ENDPOINT_PATTERN: "`private`, `unixsock-stream//PATH`, `tcp/HOST:PORT`",
}


def main(
    check: Annotated[bool, typer.Option("--check", help="Write nothing; exit code 1 if it is out of date.")] = False,
) -> None:
    """Write the list of every key into configs/keys."""
    pages = reference()
    before = {file.name: file.read_text() for file in KEYS.glob("*.md")}
    if check and before != pages:
        print(f"{KEYS} is out of date: run {COMMAND}", file=sys.stderr)
        raise typer.Exit(1)
    if check:
        return
    KEYS.mkdir(exist_ok=True)
    for name in before.keys() - pages.keys():
        (KEYS / name).unlink()
    for name, text in pages.items():
        (KEYS / name).write_text(text)


def reference() -> dict[str, str]:
    """Return a page for every part of the configuration, by its file's name, with a table for each model in it."""
    tree = schema()
    models: dict[str, Node] = tree["$defs"]
    where: dict[str, list[str]] = {}  # a part that stands in several places is described once
    for path, name in _parts(tree, models, ""):
        where.setdefault(name, []).append(path)
    sections: dict[str, list[str]] = {}
    for name, paths in where.items():
        if paths == [_FAULTS]:
            continue
        level = "#" if re.fullmatch(r"\w+(\[\])?", paths[0]) or paths[0] in _OWN_PAGE else "##"
        shown = [path for path in paths if not path.startswith(_TWIN)] or paths
        title = ", ".join(f"`{path}`" for path in shown)
        sections.setdefault(_part(paths[0]), []).append(
            _section(f"{level} {title}", models[name], models[name]["properties"])
        )
    sections["behaviours"] = [_BEHAVIOURS, *_behaviour_sections()]
    sections["faults"] = [*_fault_sections([models[name] for name, paths in where.items() if paths == [_FAULTS]])]
    page = {_part(path): _part(paths[0]) for paths in where.values() for path in paths[::-1]}
    parts = "\n".join(
        line.replace(_BELOW, f"[its page]({page.get(part := line.split('`')[1], part)}.md)") if _BELOW in line else line
        for line in _section("## The parts", tree, tree["properties"]).splitlines()
    )
    pages = {f"{part}.md": "\n".join([MARK, *texts]) for part, texts in sections.items()}
    for part, own in _OWN_PAGE.items():
        parent, _, key = part.rpartition(".")
        row = f"| `{key}` |  | "
        pages[f"{_part(parent)}.md"] = pages[f"{_part(parent)}.md"].replace(row + _BELOW, f"{row}[its page]({own}.md)")
    return {"README.md": "\n".join([_GUIDE, MARK, parts, ""])} | pages


def _part(path: str) -> str:
    """Return the name of the page on which a part stands."""
    for part, page in _OWN_PAGE.items():
        if path == part or path.startswith((f"{part}.", f"{part}[")):
            return page
    return path.partition(".")[0].removesuffix("[]")


def _behaviour_sections() -> Iterator[str]:
    """Yield the keys of each behaviour, then the parts that they hold."""
    models: dict[str, Node] = {}
    where: dict[str, list[str]] = {}
    for name, own in behaviours(models).items():
        meaning = (groups.load_kind(name).__doc__ or "").partition("\n\n")[0]
        if own["properties"]:
            yield _section(f"## `{name}`", own | {"description": meaning}, own["properties"])
        else:
            yield f"## `{name}`\n\n{_prose(meaning)} It has no keys.\n"
        for path, part in _parts(own, models, ""):
            where.setdefault(part, []).append(f"`{name}`: `{path}`")
    for part, paths in where.items():
        yield _section(f"## {', '.join(paths)}", models[part], models[part]["properties"])


def _fault_sections(kinds: list[Node]) -> Iterator[str]:
    """Yield what every kind of fault has, then what each has besides."""
    shared = [
        key for key, node in kinds[0]["properties"].items() if all(node == k["properties"].get(key) for k in kinds)
    ]
    every = {"description": Timed.__doc__}
    yield _section(f"# `{_FAULTS}`", every, {key: kinds[0]["properties"][key] for key in shared})
    for kind in kinds:
        names = _range(kind["properties"]["kind"])
        own = {key: node for key, node in kind["properties"].items() if key not in shared}
        yield _section(f"## `{_FAULTS}`: {names}", kind, own)


def _parts(model: Node, models: dict[str, Node], path: str) -> Iterator[tuple[str, str]]:
    """Yield where every model stands, and its name, depth first."""
    for key, node in model["properties"].items():
        for suffix, name in _models(node):
            here = f"{path}.{key}{suffix}".removeprefix(".")
            if "properties" in models[name]:  # any value has none
                yield here, name
                yield from _parts(models[name], models, here)


def _models(node: Node) -> Iterator[tuple[str, str]]:
    """Yield the names of the models that a key may hold; ``[]``: in a list."""
    if "$ref" in node:
        yield "", _name(node["$ref"])
    for option in node.get("anyOf", []) + node.get("oneOf", []):
        yield from _models(option)
    for option in [node.get("additionalProperties"), *node.get("patternProperties", {}).values()]:
        if isinstance(option, dict):
            yield from ((f".*{suffix}", name) for suffix, name in _models(option))
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
        return " or ".join(_range(option) for option in node["anyOf"])
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
    least, most, items = node.get("minItems"), node.get("maxItems"), _range(node["items"])
    count = f" of {least}" if least and least == most else f" of {least} or more" if least else ""
    return f"list{count}, {items}" if items == _BELOW else f"list{count}: {items}"


_RANGES: dict[str, Callable[[Node], str]] = {
    "null": lambda _node: "null",
    "boolean": lambda _node: "`true`, `false`",
    "integer": lambda node: f"whole, {_number(node)}".removesuffix(" number"),
    "number": _number,
    "string": lambda node: _PATTERNS.get(node.get("pattern", ""), "text"),
    "array": _list,
    "object": lambda node: f"mapping, {_BELOW}" if "$ref" in str(node.get("patternProperties")) else "mapping",
}

if __name__ == "__main__":
    typer.run(main)
