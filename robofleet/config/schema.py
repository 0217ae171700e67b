"""The configuration's JSON schema: with it an editor completes keys, shows what they mean, and marks mistakes."""

from collections.abc import Sequence
from typing import Any

from pydantic.json_schema import GenerateJsonSchema

from robofleet.config import groups
from robofleet.config.load import FOLDERS, TABLES
from robofleet.config.tree import Config
from robofleet.core.plugins import PluginError, known

NAME_OR_FILE = r"^[\w-]+$|\.yaml$"
TABLE_FILE = r"\.csv$"
SETTINGS = "groups", "*", "settings"
_BY_REFERENCE = "#/$defs/{model}"

Node = dict[str, Any]


class _Untitled(GenerateJsonSchema):
    """Without titles: pydantic's are the keys again, in other letters."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def schema() -> Node:
    """Return the schema of a configuration as it is written: a file may stand in its place by its name.

    Where a group's behaviour is one that is installed, its ``settings`` are that behaviour's; else they are anything.
    """
    tree = Config.model_json_schema(schema_generator=_Untitled)
    _let_files_stand(tree, tree, ())
    group = _at(tree, tree, SETTINGS[:2])
    assert group is not None
    group["allOf"] = [_where(name, own) for name, own in behaviours(tree["$defs"]).items()]
    return {"$schema": GenerateJsonSchema.schema_dialect, "title": "robofleet's configuration"} | tree


def behaviours(models: Node) -> dict[str, Node]:
    """Return the schema of each installed behaviour's settings, by its name; ``models`` gets the parts in them."""
    found = {}
    for name in known(groups.GROUP):
        try:
            settings = groups.load_kind(name).Settings
        except PluginError:  # somebody's package that does not load: it is refused where it is named
            continue
        own = settings.model_json_schema(schema_generator=_Untitled, ref_template=_BY_REFERENCE)
        parts: Node = own.pop("$defs", {})
        _let_files_stand(own, {"$defs": parts}, SETTINGS)
        for part, node in parts.items():
            assert models.setdefault(part, node) == node, f"two parts are called {part}: rename that of {name}"
        found[name] = own
    return found


def _where(behaviour: str, settings: Node) -> Node:
    """Return what makes a group's settings those of its behaviour."""
    own: Node = {"properties": {"settings": settings}}
    if settings.get("required"):
        own["required"] = ["settings"]
    return {"if": {"properties": {"behaviour": {"const": behaviour}}, "required": ["behaviour"]}, "then": own}


def _let_files_stand(root: Node, models: Node, above: Sequence[str]) -> None:
    """Let the name of a file stand for what it holds, in a model whose own keys stand below ``above``."""
    for pattern, places in ((NAME_OR_FILE, FOLDERS), (TABLE_FILE, TABLES)):
        for schema_part in places:
            *parents, key = schema_part
            inside = schema_part[: len(above)] == tuple(above) and (above or schema_part[: len(SETTINGS)] != SETTINGS)
            model = _at(models, root, parents[len(above) :]) if inside else None
            if model is None or key not in model.get("properties", {}):
                continue
            given = model["properties"][key]
            inline = given.get("anyOf") or [
                {word: given.pop(word) for word in ("$ref", "items", "type") if word in given}
            ]
            named = {"type": "string", "pattern": pattern}
            if named not in inline:  # several behaviours share a part
                given["anyOf"] = [named, *inline]


def _at(models: Node, node: Node, path: Sequence[str]) -> Node | None:
    """Return the model that a path of keys leads to; ``*`` is any item of a list or of a mapping."""
    for part in path:
        if part == "*":
            named = node.get("patternProperties") or {}
            found = node.get("items") or node.get("additionalProperties") or next(iter(named.values()), None)
        else:
            found = node.get("properties", {}).get(part)
        if not isinstance(found, dict):
            return None
        node = models["$defs"][found["$ref"].rpartition("/")[2]] if "$ref" in found else found
    return node
