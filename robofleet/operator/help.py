"""What ``--help`` prints: what a command does, how it is called, its arguments, its options, examples.

The layout is the same with every version of Typer. A docstring is a command's text: its first paragraph is also its
line in the list of commands, a paragraph that begins with ``$`` is an example.
"""

import inspect
import re
import shutil
from collections.abc import Iterable
from typing import Any

from rich.console import Console, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

_WIDEST = 100  # longer lines are hard to read
_INDENT = (0, 0, 0, 2)
_NO_BREAK = "\u2800"  # a blank that is no space
_HEADING, _NAME, _EXAMPLE = "bold", "cyan", "green"


def of_command(command: Any, ctx: Any) -> str:
    return _drawn(command, *_about(command, ctx), *_parameters(command, ctx))


def of_group(group: Any, ctx: Any) -> str:
    """Return the help of a group of commands: those with a heading (``rich_help_panel``) are listed under it."""
    return _drawn(group, *_about(group, ctx), *_list(group))


def _drawn(command: Any, *parts: RenderableType) -> str:
    examples = [text for text in _paragraphs(command) if text.startswith("$")]
    console = Console(highlight=False, width=min(_WIDEST, shutil.get_terminal_size().columns))
    with console.capture() as captured:
        for part in parts:
            console.print(part)
        if examples:
            console.print(Text("\nExamples", _HEADING))
        for example in examples:
            console.print(Text(f"  {example}", _EXAMPLE), soft_wrap=True)  # so it can be copied
        if command.epilog:
            console.print(Text("\n" + _in_lines(command.epilog)))
    text = captured.get().replace(_NO_BREAK, " ")
    return "\n".join(line.rstrip() for line in text.splitlines()) + "\n"


def _paragraphs(command: Any) -> list[str]:
    return [_in_lines(text) for text in inspect.cleandoc(command.help or "").split("\n\n")]


def _in_lines(text: str) -> str:
    """Return a text without its line ends; what is quoted in it, for example a command, is not broken."""
    return re.sub("`.*?`", lambda quoted: quoted[0].replace(" ", _NO_BREAK), " ".join(text.split()))


def _about(command: Any, ctx: Any) -> Iterable[RenderableType]:
    first, *others = (text for text in _paragraphs(command) if not text.startswith("$"))
    yield Text(first)
    yield Text.assemble("\n", ("Usage: ", _HEADING), " ".join([ctx.command_path, *_usage(command, ctx)]))
    for text in others:
        yield Text(f"\n{text}")


def _usage(command: Any, ctx: Any) -> Iterable[str]:
    arguments = [param for param in _shown(command, ctx) if param.param_type_name == "argument"]
    options = [param for param in _shown(command, ctx) if param.param_type_name == "option" and param.required]
    for name, param in [(_name(param), param) for param in (*arguments, *options)]:
        yield name if param.required or name.startswith("[") else f"[{name}]"
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
        return metavar
    return ", ".join(param.opts) + ("" if param.is_flag else f" {metavar}")


def _meaning(param: Any) -> str:
    default = param.default if param.show_default and not isinstance(param.default, bool) else ""
    if default == "" or not isinstance(default, str | int | float):
        return str(param.help or "")
    return f"{param.help} Default: {format(default, '' if isinstance(default, str) else 'g')}."


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
    yield "" if any(headings) else Text("\nCommands", _HEADING)
    yield Padding(_grid(rows), 0 if any(headings) else _INDENT)
    if any(headings) and not all(headings):
        names = ", ".join(command.name for command in commands if command.rich_help_panel is None)
        yield Text.assemble(("More: ", _HEADING), names)


def _grid(rows: Iterable[tuple[Text, ...]]) -> RenderableType:
    grid = Table.grid(padding=(0, 2, 0, 0))
    for row in rows:
        grid.add_row(*row)
    return grid
