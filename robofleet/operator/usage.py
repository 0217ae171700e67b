"""How commands are used: their help, and one line for a command that was typed wrongly, which says how to mend it."""

import difflib
import re
import sys
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from robofleet.core.sentences import wrapped

# Typer keeps its own copy of click, in a place that differs between versions: this name leads to it in all of them.
UsageError: Any = typer.BadParameter.__mro__[1]

_EXAMPLE = re.compile(r"^\s*\$ (robofleet .+)$", re.MULTILINE)


class Command(TyperCommand):
    """A command."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Lay its help out."""
        from robofleet.operator import help as layout  # noqa: PLC0415 - a driver's process loads no rich

        formatter.write(layout.of_command(self, ctx))


class Commands(TyperGroup):
    """A group of commands."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Lay its help out."""
        from robofleet.operator import help as layout  # noqa: PLC0415

        formatter.write(layout.of_group(self, ctx))


def show(error: Any) -> None:
    """Print the line for a usage error; the help, where nothing was typed."""
    if type(error).__name__ == "NoArgsIsHelpError":
        error.show()
        return
    from robofleet.config.files.yamlfile import printable  # noqa: PLC0415 - a command in a hurry needs no YAML

    print(wrapped(printable(_line(error)), sys.stderr), file=sys.stderr)


def _line(error: Any) -> str:  # noqa: PLR0911 - one answer for each kind of mistake
    kind, message, ctx = type(error).__name__, str(error.format_message()), error.ctx
    command = "robofleet" if ctx is None else ctx.command_path
    see = f"see `{command} --help`"
    if kind == "NoSuchOption":
        near = difflib.get_close_matches(error.option_name, _options(ctx), n=1)
        return f"{error.option_name}: there is no such option: {f'did you mean {near[0]}?' if near else see}"
    if kind == "BadOptionUsage":
        return f"{error.option_name}: needs a value: {see}"
    if kind == "MissingParameter":
        name = _place(error.param)
        name = f"{name}: is missing" if name.startswith("-") else f"{command}: {name} is missing"
        return f"{name}: for example: {_example(ctx) or see}"
    if kind == "BadParameter":
        what = re.sub(r"^Input should ", "must ", error.message).partition(", unable")[0].rstrip(".")
        return f"{_place(error.param)}: {what}: {see}"
    if unknown := re.match(r"No such command '(.*?)'", message):
        near = difflib.get_close_matches(unknown[1], list(ctx.command.commands), n=1)
        return f"{command}: there is no command '{unknown[1]}': {f'did you mean {near[0]!r}?' if near else see}"
    if extra := re.match(r"Got unexpected extra arguments?(?:\(s\))? \((.*)\)", message):
        return f"{command}: too many arguments, from '{extra[1]}' on: {see}"
    return f"{command}: {message}: {see}"


def _options(ctx: Any) -> list[str]:
    return [] if ctx is None else [name for param in ctx.command.params for name in param.opts if name.startswith("--")]


def _place(param: Any) -> str:
    """Return an option's name, or an argument's as the help shows it."""
    if param is None:
        return "robofleet"
    longest = str(max(param.opts, key=len, default=param.name))
    return longest if longest.startswith("-") else str(param.metavar or param.name).upper()


def _example(ctx: Any) -> str:
    found = _EXAMPLE.search((ctx.command.help if ctx is not None else None) or "")
    return "" if found is None else found[1]
