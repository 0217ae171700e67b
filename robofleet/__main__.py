"""The command line: ``robofleet``, and ``python -m robofleet``, which takes no library from the current folder.

Python's own modules it may: Python looks there before anything here runs. ``python -P -m robofleet`` forbids it.
"""

import sys

if __name__ == "__main__" and not sys.flags.safe_path:
    del sys.path[0]  # the current folder, which Python puts before all others

from robofleet.operator import direct


def main() -> None:
    """Run a command. An operator's plain one, ``robofleet stop`` before all, loads no more than it needs."""
    if (code := direct.run(sys.argv[1:])) is not None:
        raise SystemExit(code)
    from robofleet import cli  # noqa: PLC0415

    cli.main()


if __name__ == "__main__":
    main()
