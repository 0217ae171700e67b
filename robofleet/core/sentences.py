"""Sentences for a terminal: lines end between words, and a quoted command stays whole."""

import re
import shutil
import textwrap
from collections.abc import Iterable
from typing import TextIO

_MOST_PARTS = 12
_NO_BREAK = "\xa0"  # textwrap breaks at ASCII blanks alone


def wrapped(text: str, stream: TextIO) -> str:
    """Return a text as a stream shows it best: a terminal gets lines of its width, everything else what it was."""
    if not stream.isatty():
        return text
    width = shutil.get_terminal_size().columns
    whole = re.sub("`.*?`", lambda quoted: quoted[0].replace(" ", _NO_BREAK), text)
    lines = (textwrap.fill(line, width, break_long_words=False, break_on_hyphens=False) for line in whole.split("\n"))
    return "\n".join(lines).replace(_NO_BREAK, " ")


def listed(numbers: Iterable[int]) -> str:
    """Return numbers as a person writes them: 1 to 4, 7. Of many parts the first ones are named."""
    runs: list[list[int]] = []
    for number in sorted(set(numbers)):
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    words = [f"{run[0]} to {run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs]
    return ", ".join(words[:_MOST_PARTS]) + (", ..." if len(words) > _MOST_PARTS else "")
