"""The configuration's JSON schema: with it an editor completes keys, shows what they mean, and marks mistakes."""

from typing import Any

from pydantic.json_schema import GenerateJsonSchema

from robofleet.config.load import FOLDERS
from robofleet.config.tree import Config

NAME_OR_FILE = r"^[\w-]+$|\.yaml$"


class _Untitled(GenerateJsonSchema):
    """Without titles: pydantic's are the keys again, in other letters."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def schema() -> dict[str, Any]:
    """Return the schema of a configuration as it is written: a file may stand in its place by its name."""
    tree = Config.model_json_schema(schema_generator=_Untitled)
    for *parents, key in FOLDERS:
        properties = _at(tree, parents)["properties"]
        given = properties[key]
        inline = given.get("anyOf") or [{"$ref": given.pop("$ref")}]
        given["anyOf"] = [{"type": "string", "pattern": NAME_OR_FILE}, *inline]
    return {"$schema": GenerateJsonSchema.schema_dialect, "title": "robofleet's configuration"} | tree


def _at(tree: dict[str, Any], path: list[str]) -> dict[str, Any]:
    """Return the model that a path of keys leads to; ``*`` is any item of a list."""
    node = tree
    for part in path:
        node = node["items"] if part == "*" else node["properties"][part]
        if "$ref" in node:
            node = tree["$defs"][node["$ref"].rpartition("/")[2]]
    return node
