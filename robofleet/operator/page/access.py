"""Who may do what at the page's server.

On this computer a token stands in the address, and who has it is an operator. Beyond it an address carries a one-time
token, for which a browser gets a cookie as long as this process lives. The terminal has addresses for an operator
and for a viewer, and an operator's page makes more of them.
"""

import secrets
from collections import deque
from urllib.parse import quote

from starlette.requests import HTTPConnection
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.types import Scope

from robofleet.bus.permissions import OPERATOR, VIEWER
from robofleet.bus.requests import SAFE
from robofleet.operator.page.certificate import PageKeys
from robofleet.operator.page.one_time_token import OneTimeToken, Taker
from robofleet.operator.page.page_address import Addresses
from robofleet.operator.page.refused import LOGIN, ONCE, TEMPLATES, TOKEN, USED

ROLES = OPERATOR, VIEWER
OPEN = "/open"  # takes a one-time token
_MOST_INVITED = 16  # addresses that no browser has opened yet; the oldest ends
_SEE_OTHER = 303
_POLICY = "default-src 'none'; img-src data:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"


def permits(role: str, what: str) -> bool:
    """Return whether a role may ask for something: a viewer for what makes nothing move."""
    return role == OPERATOR or (role == VIEWER and what.encode() in SAFE)


class TokenAccess:
    """On this computer: who has the token is the operator."""

    scheme = "http"
    stranger, used = TOKEN, ONCE  # what a stranger reads, and who opens an address whose token is taken

    def __init__(self, root: str, port: int) -> None:
        self._root, self._port = root, port
        self._token = new_secret()
        self._once = deque([OneTimeToken()], _MOST_INVITED)

    def addresses(self) -> Addresses:
        """Return the address with the token, and the one for a browser's command line."""
        return Addresses(f"{self._root}/?token={self._token}", _opening(self._root, self._once[0]))

    def another(self) -> str:
        """Return one more address for a browser's command line."""
        self._once.append(OneTimeToken())
        return _opening(self._root, self._once[-1])

    def role(self, scope: Scope) -> str | None:
        """Return the operator's role for the token, of a POST in its header, else in its address; None: a stranger."""
        connection = HTTPConnection(scope)
        posted = scope["type"] == "http" and scope["method"] == "POST"
        tokens = connection.headers.getlist("x-token") if posted else connection.query_params.getlist("token")
        fits = len(tokens) == 1 and secrets.compare_digest(tokens[0].encode(), self._token.encode())
        return OPERATOR if fits else None

    def open(self, scope: Scope, shown: str) -> Response | None:
        """Return the answer to who shows a one-time token: on to the page; None where it is not good."""
        if not any(token.take(shown, scope.get("client"), self._port) for token in self._once):
            return None
        return RedirectResponse(f"{_landing(scope)}token={self._token}", _SEE_OTHER)


class CookieAccess:
    """Beyond this computer: a one-time token gives a cookie, and the cookie is a role."""

    scheme = "https"
    stranger, used = LOGIN, USED  # as above

    def __init__(self, root: str, port: int, keys: PageKeys) -> None:
        self._root, self._port, self._keys = root, port, keys
        self._name = f"__Host-robofleet-{port}"  # cookies know no ports: two runs' pages must not share one
        self._printed = [
            OneTimeToken(OPERATOR, Taker.ANYBODY),
            OneTimeToken(VIEWER, Taker.ANYBODY),
            OneTimeToken(OPERATOR, Taker.USER_HERE),
        ]
        self._invited: deque[OneTimeToken] = deque(maxlen=_MOST_INVITED)
        self._sessions: dict[str, str] = {}  # roles by their cookies

    def addresses(self) -> Addresses:
        """Return an operator's address, the one for a browser's command line, and a viewer's."""
        operator, viewer, once = (_opening(self._root, token) for token in self._printed)
        return Addresses(operator, once, viewer, self._keys.fingerprint)

    def invite(self, role: str) -> str:
        """Return a new address, which opens the page in one browser in this role."""
        self._invited.append(OneTimeToken(role, Taker.ANYBODY))
        return _opening(self._root, self._invited[-1])

    def role(self, scope: Scope) -> str | None:
        return self._sessions.get(HTTPConnection(scope).cookies.get(self._name, ""))

    def open(self, scope: Scope, shown: str) -> Response | None:
        """Give a browser its cookie; one that has its cookie may open its address again."""
        # Not a redirection: a browser that came from another site would send no cookie of ours along.
        entering = TEMPLATES.get_template("entering.html").render(page=_landing(scope))
        page = HTMLResponse(entering, 200, {"Content-Security-Policy": _POLICY})
        for token in (*self._printed, *self._invited):
            if token.take(shown, scope.get("client"), self._port):
                session = new_secret()
                self._sessions[session] = token.role
                page.set_cookie(self._name, session, secure=True, httponly=True, samesite="strict")
                return page
        return page if self.role(scope) is not None else None


Access = TokenAccess | CookieAccess


def new_secret() -> str:
    """Draw 128 bits."""
    return secrets.token_hex(16)


def _landing(scope: Scope) -> str:
    """Return the page that a one-time token opens: the operator's, or a projector's."""
    name = HTTPConnection(scope).query_params.get("projector")
    return "/?" if name is None else f"/projector?name={quote(name)}&"


def _opening(root: str, token: OneTimeToken) -> str:
    return f"{root}{OPEN}?once={token.secret}"
