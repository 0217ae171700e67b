"""Sentences for a terminal: lines end between words, and a quoted command stays whole."""

import re
import shutil
import textwrap
from typing import TextIO

_NO_BREAK = "\xa0"  # textwrap breaks at ASCII blanks alone


def wrapped(text: str, stream: TextIO) -> str:
    """Return a text as a stream shows it best: a terminal gets lines of its width, everything else what it was."""
    if not stream.isatty():
        return text
    width = shutil.get_terminal_size().columns
    whole = re.sub("`.*?`", lambda quoted: quoted[0].replace(" ", _NO_BREAK), text)
    lines = (textwrap.fill(line, width, break_long_words=False, break_on_hyphens=False) for line in whole.split("\n"))
    return "\n".join(lines).replace(_NO_BREAK, " ")
