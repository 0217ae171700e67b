"""The command line of the programs that measure."""

import argparse
from typing import Any


def program(doc: str | None, **options: Any) -> argparse.ArgumentParser:
    """Make a parser. An option is its default, whose type it takes (False: a flag), or a default and its meaning."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, option in options.items():
        default, meaning = option if isinstance(option, tuple) else (option, None)
        kind: dict[str, Any] = {"action": "store_true"} if default is False else {"type": type(default)}
        parser.add_argument(f"--{name.replace('_', '-')}", default=default, help=meaning, **kind)
    return parser
