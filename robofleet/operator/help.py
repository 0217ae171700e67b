"""What ``--help`` prints: what a command does, how it is called, its arguments, its options, examples.

The layout is the same with every version of Typer. A docstring is a command's text: its first paragraph is also its
line in the list of commands, a paragraph that begins with ``$`` is an example.
"""

import inspect
import shutil
from collections.abc import Iterable
from typing import Any

from rich.console import Console, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text
from typer.core import TyperCommand, TyperGroup

_WIDEST = 100  # longer lines are hard to read
_INDENT = (0, 0, 0, 2)
_HEADING, _NAME, _EXAMPLE = "bold", "cyan", "green"


class Command(TyperCommand):
    """A command."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Lay its help out."""
        formatter.write(_drawn(*_about(self, ctx), *_parameters(self, ctx), *_examples(self)))


class Commands(TyperGroup):
    """A group of commands. Those with a heading (``rich_help_panel``) are listed under it."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Lay its help out."""
        formatter.write(_drawn(*_about(self, ctx), *_list(self), *_examples(self)))


def _drawn(*parts: RenderableType) -> str:
    console = Console(highlight=False, width=min(_WIDEST, shutil.get_terminal_size().columns))
    with console.capture() as captured:
        for part in parts:
            console.print(part)
    return "\n".join(line.rstrip() for line in captured.get().splitlines()) + "\n"


def _paragraphs(command: Any) -> list[str]:
    return [" ".join(text.split()) for text in inspect.cleandoc(command.help or "").split("\n\n")]


def _about(command: Any, ctx: Any) -> Iterable[RenderableType]:
    first, *others = (text for text in _paragraphs(command) if not text.startswith("$"))
    yield Text(first)
    yield Text.assemble("\n", ("Usage: ", _HEADING), " ".join([ctx.command_path, *_usage(command, ctx)]))
    for text in others:
        yield Text(f"\n{text}")


def _usage(command: Any, ctx: Any) -> Iterable[str]:
    arguments = [param for param in _shown(command, ctx) if param.param_type_name == "argument"]
    yield from (_name(param) if param.required else f"[{_name(param)}]" for param in arguments)
    if hasattr(command, "commands"):
        yield "COMMAND"
    yield "[OPTIONS]"


def _parameters(command: Any, ctx: Any) -> Iterable[RenderableType]:
    shown = _shown(command, ctx)
    for heading, kind in (("Arguments", "argument"), ("Options", "option")):
        rows = [(Text(_name(param), _NAME), Text(_meaning(param))) for param in shown if param.param_type_name == kind]
        if rows:
            yield Text(f"\n{heading}", _HEADING)
            yield Padding(_grid(rows), _INDENT)


def _shown(command: Any, ctx: Any) -> list[Any]:
    return [param for param in command.get_params(ctx) if not getattr(param, "hidden", False)]


def _name(param: Any) -> str:
    metavar = str(param.metavar or param.name.upper())
    if param.param_type_name == "argument":
        return metavar.strip("[]")
    return ", ".join(param.opts) + ("" if param.is_flag else f" {metavar}")


def _meaning(param: Any) -> str:
    default = param.default if isinstance(param.default, (str, int, float)) and param.default is not False else ""
    notes = [f"Default: {default}." if default != "" and param.show_default else ""]
    notes += ["Required." if param.required and param.param_type_name == "option" else ""]
    return " ".join(filter(None, [param.help or "", *notes]))


def _list(group: Any) -> Iterable[RenderableType]:
    commands = [command for command in group.commands.values() if not command.hidden]
    headings = [command.rich_help_panel for command in commands]
    rows: list[tuple[Text, ...]] = []
    for command, heading, previous in zip(commands, headings, [None, *headings], strict=False):
        cells = Text(command.name, _NAME), Text(_paragraphs(command)[0].rstrip("."))
        if heading is not None:
            rows.append((Text("" if heading == previous else heading, _HEADING), *cells))
        elif not any(headings):
            rows.append(cells)
    yield ""
    yield _grid(rows)
    if any(headings) and not all(headings):
        names = ", ".join(command.name for command in commands if command.rich_help_panel is None)
        yield Text.assemble(("More: ", _HEADING), names)


def _examples(command: Any) -> Iterable[RenderableType]:
    examples = [text for text in _paragraphs(command) if text.startswith("$")]
    if examples:
        yield Text("\nExamples", _HEADING)
        yield from (Padding(Text(example, _EXAMPLE), _INDENT) for example in examples)
    if command.epilog:
        yield Text("\n" + " ".join(command.epilog.split()))


def _grid(rows: Iterable[tuple[Text, ...]]) -> RenderableType:
    grid = Table.grid(padding=(0, 2, 0, 0))
    for row in rows:
        grid.add_row(*row)
    return grid
