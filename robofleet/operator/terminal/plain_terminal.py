"""What a terminal can show: ASCII where its locale is C or its encoding has no other signs; and no library's warnings.

A locale that is not set at all says nothing of the terminal: then Python's own choice stands, UTF-8.
"""

import codecs
import logging
import os
import sys
import warnings
from io import TextIOWrapper

_HANDLER = "robofleet.plain"
_C = ("C", "POSIX")
_COERCED = ("", *_C, "C.UTF-8", "C.utf8", "UTF-8")  # by Python itself, where LANG=C
_INSTEAD = str.maketrans(
    {"≤": "<=", "≥": ">=", "…": "...", "–": "-", "—": "-", "×": "x", "µ": "u", "°": " deg", "→": "->", "✓": "yes"}
)


def speak_its_language() -> None:
    """Let stdout and stderr say what the terminal can show: rich draws ASCII boxes then; nothing raises."""
    codecs.register_error(_HANDLER, _instead)
    encoding = "ascii" if _is_c_locale() else None
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(encoding=encoding or stream.encoding, errors=_HANDLER)


def as_shown(text: str, encoding: str) -> str:
    """Return a text as a stream of this encoding will show it: a table measures it before it is written."""
    codecs.register_error(_HANDLER, _instead)
    return text.encode(encoding, _HANDLER).decode(encoding)


def silence_libraries() -> None:
    """Let no library's warning stand between our own lines, but where Python is asked for them (``-W``)."""
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
    logging.getLogger("matplotlib").setLevel(logging.ERROR)  # it tells of its font cache


def _is_c_locale() -> bool:
    """Return whether the user's locale is C: LC_ALL counts before LC_CTYPE, and LANG last."""
    everything, types, rest = (os.environ.get(name, "") for name in ("LC_ALL", "LC_CTYPE", "LANG"))
    if everything:
        return everything in _C
    return types in _C or (rest in _C and types in _COERCED)


def _instead(error: UnicodeError) -> tuple[str | bytes, int]:
    """Return what stands for signs that an encoding does not have; a name that is no text is escaped."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    signs = error.object[error.start : error.end].translate(_INSTEAD)
    return signs.encode("ascii", "backslashreplace").decode(), error.end
