"""The public interface: whoever changes it writes a line for users, and its docstrings say all that users must know.

``public_interface.txt`` is the interface from which the newest section of CHANGELOG.md counts. A release writes it:

    python -m tests.test_public_interface
"""

import ast
import difflib
import inspect
import re
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import pydantic
import pytest

import robofleet
from robofleet import testing

ROOT = Path(__file__).parents[1]
COUNTED_FROM = Path(__file__).with_name("public_interface.txt")
PUBLIC = {name: getattr(robofleet, name) for name in robofleet.__all__ if name != "__version__"}
PUBLIC |= {f"testing.{name}": getattr(testing, name) for name in testing.__all__}
DOCUMENTED = [name for name, value in PUBLIC.items() if inspect.isclass(value) or inspect.isfunction(value)]
Function = ast.FunctionDef | ast.AsyncFunctionDef


def source(name: str) -> Any:
    """Return the definition of a public class or function."""
    return ast.parse(textwrap.dedent(inspect.getsource(PUBLIC[name]))).body[0]


def members(definition: Any) -> Iterator[Any]:
    """Yield what users see of a class: its fields, values, methods and classes, but no checks of a contract."""
    for member in definition.body:
        name = getattr(member, "name", None) or ast.unparse(getattr(member, "target", member)).partition(" ")[0]
        if not isinstance(member, ast.Expr | ast.Pass) and (name == "__init__" or not name.startswith(("_", "test_"))):
            yield member


def heading(definition: Any) -> str:
    """Return a definition's decorators and its first line."""
    if not isinstance(definition, Function | ast.ClassDef):
        return ast.unparse(definition)
    bare = type(definition)(**{**vars(definition), "body": [ast.Pass()]})
    return ast.unparse(bare).removesuffix("pass").strip().removesuffix(":")


def block(name: str) -> str:
    """Return a public name with all that a program may depend on."""
    value = PUBLIC[name]
    if not inspect.isclass(value) and not inspect.isfunction(value):
        return f"{name} = {value}"
    definition = source(name)
    inside = list(members(definition)) if inspect.isclass(value) else []
    return "\n".join([heading(definition), *(textwrap.indent(heading(member), "    ") for member in inside)])


def blocks() -> dict[str, str]:
    """Return the public interface: the block of each name."""
    return {name: block(name) for name in PUBLIC}


def read(text: str) -> dict[str, str]:
    """Return the blocks of a file."""
    parts = re.split(r"^# ([\w.]+)\n", text, flags=re.MULTILINE)[1:]
    return {name: part.strip("\n") for name, part in zip(parts[::2], parts[1::2], strict=True)}


def written(interface: dict[str, str]) -> str:
    """Return the text of a file."""
    return "\n".join(f"# {name}\n{part}\n" for name, part in interface.items())


def unnamed(before: dict[str, str], after: dict[str, str], changelog: str) -> list[str]:
    """Return the changed names that have no line in the section ``Unreleased``. Of a new module its name will do."""
    section = changelog.partition("\n## Unreleased\n")[2].partition("\n## ")[0]
    named = set(re.findall(r"\w+", " ".join(re.findall(r"`([^`]+)`", section))))
    known_modules = {name.rpartition(".")[0] for name in before}
    changed = [name for name in before | after if before.get(name) != after.get(name)]
    parts = {name: {name.rpartition(".")[2], name.rpartition(".")[0]} - known_modules for name in changed}
    return sorted(name for name in changed if not parts[name] & named)


def test_a_change_of_the_public_interface_has_a_line_in_the_changelog() -> None:
    before, after = read(COUNTED_FROM.read_text()), blocks()
    missing = unnamed(before, after, (ROOT / "CHANGELOG.md").read_text())
    lines = (
        line
        for name in missing
        for line in difflib.ndiff(before.get(name, "").splitlines(), after.get(name, "").splitlines())
        if line[0] in "+-?"
    )
    assert not missing, (
        f"the public interface has changed: {', '.join(missing)}. Write a line that says what users must do, with the "
        "name in backquotes, into the section Unreleased of CHANGELOG.md.\n" + "\n".join(lines)
    )


@pytest.mark.parametrize(
    ("changelog", "missing"),
    [
        ("# Changelog\n\n## Unreleased\n\n- `Frame` has a field.\n\n## 1.0\n", []),
        ("# Changelog\n\n## Unreleased\n\n- `robofleet.Frame(image)` has a field.\n", []),
        ("# Changelog\n\n## Unreleased\n\n- Frame has a field.\n\n## 1.0\n\n- `Frame` is new.\n", ["Frame"]),
        ("# Changelog\n\n## 1.0\n\n- `Frame` has a field.\n", ["Frame"]),
    ],
)
def test_a_changed_name_must_stand_in_the_unreleased_section(changelog: str, missing: list[str]) -> None:
    before = {"Frame": "class Frame", "Line": "class Line"}
    assert unnamed(before, {**before, "Frame": "class Frame\n    image: int"}, changelog) == missing
    assert unnamed(before, {"Line": "class Line"}, changelog) == missing
    assert unnamed({"Line": "class Line"}, before, changelog) == missing


def test_a_new_module_is_named_as_a_whole() -> None:
    changelog, name = "# Changelog\n\n## Unreleased\n\n- `robofleet.testing` is new.\n", "testing.Clock"
    assert unnamed({"Line": "class Line"}, {"Line": "class Line", name: "class Clock"}, changelog) == []
    assert unnamed({name: "class Clock"}, {name: "class Clock(Wall)"}, changelog) == [name]


def test_the_file_of_the_interface_is_read_as_it_is_written() -> None:
    assert read(written(blocks())) == blocks()


def documented(text: str, section: str) -> set[str]:
    """Return the names that a section of a docstring explains."""
    found = re.search(rf"^{section}:\n((?:^(?: .*)?\n?)+)", text, re.MULTILINE)
    return set(re.findall(r"^ {4}(\w+): \S", found[1], re.MULTILINE)) if found else set()


def undocumented(function: Function) -> Iterator[str]:
    """Yield what the docstring of a function lacks."""
    text = ast.get_docstring(function) or ""
    arguments = function.args
    every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    names = {each.arg for each in (*every, arguments.vararg, arguments.kwarg) if each} - {"self", "cls"}
    yield from (f"Args: {name}" for name in names - documented(text, "Args"))
    is_property = any("property" in ast.unparse(decorator) for decorator in function.decorator_list)
    returns = not is_property and function.returns is not None and ast.unparse(function.returns) != "None"
    if returns and not re.search(r"^(Returns|Yields):\n {4}\S", text, re.MULTILINE):
        yield "Returns"
    raised = {
        name
        for node in ast.walk(function)
        if isinstance(node, ast.Raise) and node.exc is not None
        if (name := ast.unparse(node.exc).partition("(")[0]).endswith("Error")
    }
    yield from (f"Raises: {name}" for name in raised - documented(text, "Raises"))


@pytest.mark.parametrize("name", DOCUMENTED)
def test_a_public_docstring_says_arguments_results_exceptions_and_fields(name: str) -> None:
    definition, value = source(name), PUBLIC[name]
    functions = [member for member in (definition, *members(definition)) if isinstance(member, Function)]
    missing = [f"{function.name}: {what}" for function in functions for what in undocumented(function)]
    if inspect.isclass(value) and not issubclass(value, Enum | pydantic.BaseModel):
        fields = {ast.unparse(member.target) for member in members(definition) if isinstance(member, ast.AnnAssign)}
        missing += [
            f"Attributes: {field}" for field in fields - documented(ast.get_docstring(definition) or "", "Attributes")
        ]
    assert sorted(missing) == []


def test_every_exception_says_when_it_is_raised_and_has_the_same_root() -> None:
    texts = (file.read_text() for file in (ROOT / "robofleet").rglob("*.py"))
    trees = [ast.parse(text) for text in texts if re.search(r"^ *class \w+Error\b", text, re.MULTILINE)]
    classes = [node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    errors = {each.name: each for each in classes if each.name.endswith("Error") and each.name != "RobofleetError"}
    assert len(errors) > 20
    for name, error in errors.items():
        root: ast.ClassDef | None = error
        while root is not None and (above := ast.unparse(root.bases[0])) != "RobofleetError":
            root = errors.get(above)
        assert root is not None, f"{name} does not descend from RobofleetError"
        assert (ast.get_docstring(error) or "").startswith("Raised "), name


@pytest.mark.parametrize(
    ("names", "loaded"),
    [
        ("__name__", []),
        ("STOP, Driver, DriverContext, DriverError, DriverReading, WheelSpeeds", []),
        ("Behaviour, Decision, Figure, Situation", ["numpy", "pydantic"]),
    ],
)
def test_a_public_name_loads_what_it_needs_and_no_more(names: str, loaded: list[str]) -> None:
    heavy = "[name for name in ('numpy', 'pydantic', 'numba', 'cv2', 'matplotlib', 'mcap') if name in sys.modules]"
    code = f"import sys; from robofleet import {names}; print({heavy})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(loaded)


if __name__ == "__main__":
    COUNTED_FROM.write_text(written(blocks()))
