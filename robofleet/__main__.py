"""The command line, as ``robofleet`` and as ``python -m robofleet``."""

import sys

from robofleet.processes import direct


def main() -> None:
    """Run a command. An operator's plain one, ``robofleet stop`` before all, loads no more than it needs."""
    if (code := direct.run(sys.argv[1:])) is not None:
        raise SystemExit(code)
    from robofleet import cli  # noqa: PLC0415

    cli.main()


if __name__ == "__main__":
    main()
