"""Every quantity of a configuration is one that a laboratory can have: nothing is without a limit, and none traps."""

import json
import math
from collections.abc import Iterator
from typing import Any

import pytest
from pydantic import ValidationError

from robofleet.config import groups
from robofleet.config.load import ConfigError, load_config
from robofleet.config.schema import behaviours
from robofleet.config.tree import Config
from robofleet.runs.check import load_checked, proofs
from tests.shipped import PLATOON

SCHEMA = Config.model_json_schema()
BEHAVIOURS = behaviours(SCHEMA["$defs"])
Node = dict[str, Any]


def nodes(node: Node, path: str, inside: tuple[str, ...] = ()) -> Iterator[tuple[str, Node]]:
    """Yield everything that a value is described by, with the path to it."""
    if "$ref" in node:
        name = node["$ref"].rpartition("/")[2]
        if name not in inside:
            yield from nodes(SCHEMA["$defs"][name], path, (*inside, name))
        return
    yield path, node
    for part in [*node.get("anyOf", []), *node.get("oneOf", []), *node.get("prefixItems", [])]:
        yield from nodes(part, path, inside)
    for key, below in [
        *node.get("properties", {}).items(),
        ("*", node.get("items")),
        ("*", node.get("additionalProperties")),
        *(("*", below) for below in node.get("patternProperties", {}).values()),
    ]:
        if isinstance(below, dict):
            yield from nodes(below, f"{path}.{key}".removeprefix("."), inside)


def unlimited(node: Node) -> str:
    """Return what is missing in the description of a value."""
    match node.get("type"):
        case "number" | "integer":
            low = node.keys() & {"minimum", "exclusiveMinimum"}
            high = node.keys() & {"maximum", "exclusiveMaximum"}
            return "" if low and high else "a number without limits"
        case "string":
            return "" if node.keys() & {"maxLength", "pattern", "enum", "const"} else "a text without a longest"
        case "array":
            return "" if "maxItems" in node else "a list without a longest"
        case "object":
            return "" if "maxProperties" in node or "additionalProperties" in node else "a mapping without limits"
    return ""


def test_nothing_is_without_a_limit() -> None:
    trees = ("", SCHEMA), *((f"groups.*.settings of {name}", tree) for name, tree in BEHAVIOURS.items())
    every = [found for above, tree in trees for found in nodes(tree, above)]
    found = {f"{path}: {missing}" for path, node in every if (missing := unlimited(node))}
    assert not found, "\n".join(sorted(found))


def leaves(value: Any, path: str = "") -> Iterator[str]:
    """Yield the dotted keys of the numbers of a configuration."""
    if isinstance(value, dict | list):
        for key, below in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(below, f"{path}.{key}".removeprefix("."))
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield path


WHOLE = "tag", "seed", "width", "height", "robots_per_process", "gain", "projector_gray"
OPTIONAL = (
    "camera.simulated.glare=[{at_px: [1.0, 1.0], radius_px: 9.0}]",
    "camera.simulated.covers=[{robot: r1, at_s: 1.0, duration_s: 1.0}]",
    "camera.simulated.knocks=[{at_s: 1.0}]",
    "robots.0.calibration={robot: r1, wheel_radius_m: 0.016, wheel_base_m: 0.1, delay_s: 0.01, motor_lag_s: 0.01}",
    "faults=[{kind: pose_noise, robot: r1, sigma_m: 0.1, at_s: 1.0}, {kind: late, topics: [cmd]}]",
)
TREE = load_config(PLATOON, OPTIONAL).model_dump(mode="json")
KEYS = sorted(leaves(TREE))
EXTREMES = 1e300, -1e300, 1e-300, -1e-300, math.inf, -math.inf, math.nan, 2**63, 10**400


def changed(key: str, number: float) -> Any:
    """Return the tree with another number at a key."""
    tree = json.loads(json.dumps(TREE))
    *parents, last = key.split(".")
    node = tree
    for part in parents:
        node = node[int(part) if isinstance(node, list) else part]
    node[int(last) if isinstance(node, list) else last] = number
    return tree


def is_accepted(key: str, number: float) -> bool:
    try:
        for group in Config.model_validate(changed(key, number)).groups:
            groups.kind(group).Settings.model_validate(group.settings)
    except ValidationError:
        return False
    return True


@pytest.mark.slow
@pytest.mark.parametrize("number", EXTREMES)
def test_no_quantity_is_so_large_or_so_small(number: float) -> None:
    tiny = 0.0 < abs(number) < 1.0  # as good as 0, which is meant where it is allowed
    accepted = [key for key in KEYS if is_accepted(key, number) and not (tiny and is_accepted(key, 0.0))]
    assert not accepted


@pytest.mark.parametrize("number", ["1.0e+300", "-.inf", ".nan", str(10**400)])
@pytest.mark.parametrize(
    "key", ["camera.trigger_lead_s", "robots.0.vehicle.wheel_base_m", "run.seed", "run.duration_s"]
)
def test_an_extreme_value_is_refused_in_a_line(key: str, number: str) -> None:
    with pytest.raises(ConfigError) as refused:
        load_config(PLATOON, [f"{key}={number}"])
    (line,) = refused.value.faults
    assert line.startswith(f"--set {key}=")


def limits(key: str) -> Iterator[float]:
    """Yield the least and the greatest value of a number."""
    node = next((node for path, node in nodes(SCHEMA, "") if path == _general(key) and "minimum" in node), None)
    if node is not None:
        yield from (node["minimum"], node["maximum"])


def _general(key: str) -> str:
    return ".".join("*" if part.isdigit() else part for part in key.split("."))


@pytest.mark.long
@pytest.mark.parametrize("key", KEYS)
@pytest.mark.filterwarnings("error")
def test_what_is_just_possible_is_refused_in_words_or_can_be_checked(key: str) -> None:
    for value in limits(key):
        number = value if key.rpartition(".")[2] in WHOLE else f"{float(value):.20f}".rstrip("0") + "0"
        try:
            tree = load_checked(PLATOON, ["tracker.source=truth", f"{key}={number}"])
        except ConfigError as refused:
            assert refused.faults
        else:
            assert proofs(tree)
