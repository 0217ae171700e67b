"""Who may speak to the operator's page: it drives robots, and any web site that the operator has open may try.

A wrong Host is a site that points its own name here (DNS rebinding); a wrong Origin is a site whose script reaches
for this port; and whoever has neither token nor cookie was not given the page's address. A person who opens such an
address reads what to do; whatever asks for more than to see is told nothing but "403".
"""

from typing import Any, NamedTuple

from starlette.datastructures import Headers, MutableHeaders, QueryParams
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from robofleet.operator.page.access import OPEN, Access
from robofleet.operator.page.connection_limiter import Complaints
from robofleet.operator.page.refused import HOST, RefusedPage, Words

_LARGEST_BODY = 1024  # [bytes]
_WITHOUT_TOKEN = (".js", ".css")  # they hold no secret, and a browser asks for them without
_PORTS = {"http": 80, "https": 443}  # that browsers leave out
_TOO_LARGE, _FORBIDDEN = 413, 403


def authorities(names: set[str], port: int, scheme: str) -> frozenset[str]:
    """Return what a browser may call this server, as it stands in its Host header."""
    bracketed = {f"[{name}]" if ":" in name else name.lower() for name in names}
    return frozenset({f"{name}:{port}" for name in bracketed} | (bracketed if port == _PORTS[scheme] else set()))


class _Wrong(NamedTuple):
    """What is wrong with a request: for the log, and for a person who opened an address; None: it was no person."""

    what: str
    words: Words | None


class Guard:
    """Lets through what comes from the page of this server, with its role; counts and logs the rest."""

    def __init__(self, app: ASGIApp, hosts: frozenset[str], access: Access, complaints: Complaints) -> None:
        self._app, self._hosts, self._access, self._complaints = app, hosts, access, complaints
        self._refusals = {words: RefusedPage(words) for words in (HOST, access.stranger, access.used)}
        self._socket = "wss" if access.scheme == "https" else "ws"

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = Headers(scope=scope)
        answer = self._app
        wrong = self._wrong(scope, headers)
        if wrong is None and scope["type"] == "http" and scope["method"] == "GET" and scope["path"] == OPEN:
            shown = QueryParams(scope["query_string"]).get("once", "")
            entering = self._access.open(scope, shown)
            wrong = _Wrong("one-time token", self._access.used) if entering is None else None
            answer = entering or answer
        if wrong is not None:
            self._log(scope, wrong.what)
            if wrong.words is None:
                await _refuse(scope, receive, send, _FORBIDDEN)
            else:
                await _explain(self._refusals[wrong.words], scope, receive, send)
        elif _body_size(headers) > _LARGEST_BODY:
            self._log(scope, "a body that is too large")
            await _refuse(scope, receive, send, _TOO_LARGE)
        else:
            await answer(scope, receive, _with_headers(send, f"{self._socket}://{headers['host']}"))

    def _wrong(self, scope: Scope, headers: Headers) -> _Wrong | None:
        """Return what is wrong with a request, None if nothing is; what is asked has a role then."""
        hosts = headers.getlist("host")
        opens = scope["type"] == "http" and scope["method"] == "GET"
        acts = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return _Wrong(f"Host {hosts}", HOST if opens else None)
        own = f"{self._access.scheme}://{hosts[0].lower()}"
        if acts and [origin.lower() for origin in headers.getlist("origin")] != [own]:
            return _Wrong(f"Origin {headers.getlist('origin')}", None)
        if opens and scope["path"] == OPEN:
            return None  # its one-time token is looked at
        if acts or not scope["path"].endswith(_WITHOUT_TOKEN):
            scope["role"] = self._access.role(scope)
            if scope["role"] is None:
                return _Wrong("token", self._access.stranger if opens else None)
        return None

    def _log(self, scope: Scope, why: str) -> None:
        client = (scope.get("client") or ("?",))[0]
        self._complaints.add(f"{scope['type']} {scope['path']!r:.80} of {client}: wrong {why:.200}")


def _body_size(headers: Headers) -> int:
    """Return the size that a request announces; one that does not say how large it is, is too large."""
    length = headers.get("content-length", "0")
    return int(length) if "transfer-encoding" not in headers and length.isdecimal() else _LARGEST_BODY + 1


async def _refuse(scope: Scope, receive: Receive, send: Send, status: int) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close"})
    else:
        await Response(status_code=status, headers={"Connection": "close"})(scope, receive, send)


async def _explain(refusal: RefusedPage, scope: Scope, receive: Receive, send: Send) -> None:
    answer = Response(refusal.body, _FORBIDDEN, {"Connection": "close"}, "text/html")
    await answer(scope, receive, _with_headers(send, policy=refusal.policy))


def _with_headers(send: Send, live: str = "", *, policy: str = "") -> Send:
    """Add what every answer says; ``policy``: where the answer has brought none of its own.

    ``live``: scheme and host of the page's socket.
    """
    policy = policy or (
        f"default-src 'self'; img-src 'self' data:; connect-src 'self' {live}; "  # Safari: 'self' has no ws
        "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    )

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers: Any = MutableHeaders(scope=message)
            headers.setdefault("Content-Security-Policy", policy)
            headers["X-Content-Type-Options"] = "nosniff"
            headers["Referrer-Policy"] = "no-referrer"
            headers["Cache-Control"] = "no-store"
            headers["Cross-Origin-Opener-Policy"] = "same-origin"
            headers["Cross-Origin-Resource-Policy"] = "same-origin"
        await send(message)

    return sending
