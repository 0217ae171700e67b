"""The command line: ``robofleet``, and ``python -m robofleet``, which takes no library from the current folder.

Python's own modules it may: Python looks there before anything here runs. ``python -P -m robofleet`` forbids it.
"""

import os
import sys

if __name__ == "__main__" and not sys.flags.safe_path:
    del sys.path[0]  # the current folder, which Python puts before all others

from robofleet.operator import direct


def main() -> None:
    """Run a command; one whose output cannot be written ends with exit code 1 and a line."""
    _open_standard_streams()
    try:
        try:
            _run()
        finally:
            sys.stdout.flush()
    except OSError as error:
        try:
            print(flush=True)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python says it again when it ends
            if not isinstance(error, BrokenPipeError):
                print(f"robofleet: the output cannot be written: {error.strerror}", file=sys.stderr)
            raise SystemExit(1) from error
        raise


def _open_standard_streams() -> None:
    """Open those that are closed: a run's first files and sockets would take their numbers."""
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(descriptor, True)
        name, mode = (("stdin", "r"), ("stdout", "w"), ("stderr", "w"))[descriptor]
        setattr(sys, name, os.fdopen(descriptor, mode))
    os.close(descriptor)


def _run() -> None:
    """Run a command. An operator's plain one, ``robofleet stop`` before all, loads no more than it needs."""
    if (code := direct.run(sys.argv[1:])) is not None:
        raise SystemExit(code)
    from robofleet import cli  # noqa: PLC0415

    cli.main()


if __name__ == "__main__":
    main()
