"""What a browser shows that is let in no further: what happened and what to do, and nothing that a stranger could use.

It looks like the page: the page's own colours stand in it, as it may fetch nothing.
"""

import base64
import hashlib
from pathlib import Path

from markupsafe import Markup
from starlette.templating import Jinja2Templates

_FOLDER = Path(__file__).parent
TEMPLATES = Jinja2Templates(_FOLDER / "templates")
_STYLES = _FOLDER / "static" / "page.css", _FOLDER / "templates" / "refused.css"
_NEW_PAGE = "The terminal opens another page of a run that is on: <code>robofleet web</code>"
TOKEN = (
    "This address is not complete, or it is an old one",
    "Each start of the page has an address of its own. Its end, <code>?token=...</code>, is missing here or is of "
    "another start.",
    "Open the address that the newest run or <code>robofleet web</code> has printed, all of it; or scan its QR code.",
    _NEW_PAGE,
)
ONCE = (
    "This address has opened its page already",
    "The address by which a run opens a browser works once, for the user who started the run.",
    "Open the address that the terminal shows.",
    _NEW_PAGE,
)
USED = (
    "This address has opened its page already",
    "Each address opens the page in one browser only: the one that came first. If that was not you, somebody else has "
    "used it: tell the operator.",
    "Ask for an address of your own: an operator's page makes one, under <em>Another phone or computer</em>.",
    "So does the terminal: <code>robofleet web --host ADDRESS</code>",
)
LOGIN = (
    "This browser is not logged in",
    "Each browser opens the page by an address of its own, once; it stays in until the page ends. It must accept "
    "cookies.",
    "Ask for an address of your own: an operator's page makes one, under <em>Another phone or computer</em>.",
    "So does the terminal: <code>robofleet web --host ADDRESS</code>",
)
HOST = (
    "This page is known by another name",
    "The page answers only to the address that its run has printed, so that no other site can pass itself off as it.",
    "Open the address that the terminal shows, as it stands there.",
    "To open the page to a phone or another computer, start it with this machine's address: "
    "<code>robofleet run CONFIG --web-host ADDRESS</code> or <code>robofleet web --host ADDRESS</code>",
)
Words = tuple[str, str, str, str]


class RefusedPage:
    """A whole page of words, made once: to refuse costs no more than to write it."""

    def __init__(self, words: Words) -> None:
        title, *texts = words
        style = "".join(sheet.read_text() for sheet in _STYLES)
        digest = base64.b64encode(hashlib.sha256(style.encode()).digest()).decode()
        self.policy = (
            f"default-src 'none'; img-src data:; style-src 'sha256-{digest}'; frame-ancestors 'none'; base-uri 'none'"
        )
        what, cure, more = map(Markup, texts)
        template = TEMPLATES.get_template("refused.html")
        self.body = template.render(title=title, style=Markup(style), what=what, cure=cure, more=more).encode()
