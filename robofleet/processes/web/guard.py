"""Who may speak to the operator's page: it drives robots, and any web site that the operator has open may try.

A wrong Host is a site that points its own name here (DNS rebinding); a wrong Origin is a site whose script reaches
for this port; and whoever has not the token was not given the page's address. A person who opens such an address reads
what to do; whatever asks for more than to see is told nothing but "403".
"""

import secrets
from typing import Any, NamedTuple

from starlette.datastructures import Headers, MutableHeaders, QueryParams
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from robofleet.processes.web.places import Complaints
from robofleet.processes.web.refused import HOST, TICKET, TOKEN, RefusedPage, Words
from robofleet.processes.web.ticket import Ticket

_LARGEST_BODY = 1024  # [bytes]
_WITHOUT_TOKEN = (".js", ".css")  # they hold no secret, and a browser asks for them without
_HTTP = 80  # the port that browsers leave out
_TOO_LARGE, _FORBIDDEN, _SEE_OTHER = 413, 403, 303
OPEN = "/open"  # takes the ticket; the page comes with its token then


def new_token() -> str:
    """Draw a token of 128 bits."""
    return secrets.token_hex(16)


def authorities(names: set[str], port: int) -> frozenset[str]:
    """Return what a browser may call this server, as it stands in its Host header."""
    bracketed = {f"[{name}]" if ":" in name else name.lower() for name in names}
    return frozenset({f"{name}:{port}" for name in bracketed} | (bracketed if port == _HTTP else set()))


class _Wrong(NamedTuple):
    """What is wrong with a request: for the log, and for a person who opened an address; None: it was no person."""

    what: str
    told: Words | None


class Guard:
    """Lets through what comes from the page of this server; counts and logs the rest."""

    def __init__(
        self, app: ASGIApp, hosts: frozenset[str], port: int, token: str, ticket: Ticket, complaints: Complaints
    ) -> None:
        self._app, self._hosts, self._port, self._token, self._complaints = app, hosts, port, token, complaints
        self._ticket = ticket
        self._refusals = {words: RefusedPage(words) for words in (HOST, TICKET, TOKEN)}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or one WebSocket."""
        headers = Headers(scope=scope)
        wrong = self._wrong(scope, headers)
        if wrong is not None:
            self._log(scope, wrong.what)
            if wrong.told is None:
                await _refuse(scope, receive, send, _FORBIDDEN)
            else:
                await _explain(self._refusals[wrong.told], scope, receive, send)
        elif _body_size(headers) > _LARGEST_BODY:
            self._log(scope, "a body that is too large")
            await _refuse(scope, receive, send, _TOO_LARGE)
        elif scope["path"] == OPEN:
            page = RedirectResponse(f"/?token={self._token}", _SEE_OTHER)
            await page(scope, receive, _with_headers(send, headers["host"]))
        else:
            await self._app(scope, receive, _with_headers(send, headers["host"]))

    def _wrong(self, scope: Scope, headers: Headers) -> _Wrong | None:
        """Return what is wrong with a request, None if nothing is."""
        hosts = headers.getlist("host")
        opens = scope["type"] == "http" and scope["method"] == "GET"
        acts = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return _Wrong(f"Host {hosts}", HOST if opens else None)
        if acts and [origin.lower() for origin in headers.getlist("origin")] != [f"http://{hosts[0].lower()}"]:
            return _Wrong(f"Origin {headers.getlist('origin')}", None)
        query = QueryParams(scope["query_string"])
        if opens and scope["path"] == OPEN:
            taken = self._ticket.take(query.get("ticket", ""), scope.get("client"), self._port)
            return None if taken else _Wrong("ticket", TICKET)
        if acts or not scope["path"].endswith(_WITHOUT_TOKEN):
            posted = scope["type"] == "http" and scope["method"] == "POST"
            tokens = headers.getlist("x-token") if posted else query.getlist("token")
            if len(tokens) != 1 or not secrets.compare_digest(tokens[0].encode(), self._token.encode()):
                return _Wrong("token", TOKEN if opens else None)
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


def _with_headers(send: Send, host: str = "", *, policy: str = "") -> Send:
    """Add what every answer says; ``policy``: where the answer has brought none of its own."""
    policy = policy or (
        f"default-src 'self'; img-src 'self' data:; connect-src 'self' ws://{host}; "  # Safari: 'self' has no ws
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
