"""An address as a QR code in a terminal, for a phone's camera: black on white, whatever the terminal's colours are."""

from rich.console import Console
from rich.text import Text

_BLACK, _WHITE = "#000000", "#ffffff"
_MARGIN, _NARROW_MARGIN = 4, 2  # modules of white; a scanner needs some
_HALVES = {(False, False): " ", (True, False): "▀", (False, True): "▄", (True, True): "█"}


def qr_code(address: str, console: Console) -> Text | None:
    """Return the code; None where the terminal has no colours or no room: the address alone must do there.

    A character is two modules, one above the other; where there are only ASCII's, a module is two spaces.
    """
    import segno  # noqa: PLC0415

    if not console.is_terminal or console.color_system is None:
        return None
    plain = not _can_write("▀▄█", console.encoding)
    modules = [
        [bool(module) for module in row]
        for row in segno.make(address, error="l", micro=False).matrix_iter(border=_NARROW_MARGIN if plain else _MARGIN)
    ]
    lines = _spaces(modules) if plain else _half_blocks(modules)
    fits = lines[0].cell_len <= console.width and len(lines) < console.height
    return Text("\n").join(lines) if fits else None


def _half_blocks(modules: list[list[bool]]) -> list[Text]:
    above, below = modules[::2], [*modules[1::2], *[[False] * len(modules[0])] * (len(modules) % 2)]
    style = f"{_BLACK} on {_WHITE}"
    return [
        Text("".join(_HALVES[pair] for pair in zip(*rows, strict=True)), style)
        for rows in zip(above, below, strict=True)
    ]


def _spaces(modules: list[list[bool]]) -> list[Text]:
    return [Text().join(Text("  ", f"on {_BLACK if dark else _WHITE}") for dark in row) for row in modules]


def _can_write(characters: str, encoding: str) -> bool:
    try:
        characters.encode(encoding)
    except (UnicodeEncodeError, LookupError):
        return False
    return True
