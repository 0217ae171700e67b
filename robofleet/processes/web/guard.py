"""Who may speak to the operator's page: it drives robots, and any web site that the operator has open may try.

A wrong Host is a site that points its own name here (DNS rebinding); a wrong Origin is a site whose script reaches
for this port; and whoever has not the token was not given the page's address. They are told nothing but "403".
"""

import secrets
from typing import Any

from starlette.datastructures import Headers, MutableHeaders, QueryParams
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from robofleet.processes.web.places import Complaints

_LARGEST_BODY = 1024  # [bytes]
_WITHOUT_TOKEN = (".js", ".css")  # they hold no secret, and a browser asks for them without
_HTTP = 80  # the port that browsers leave out
_TOO_LARGE, _FORBIDDEN = 413, 403


def new_token() -> str:
    """Draw a token of 128 bits."""
    return secrets.token_hex(16)


def authorities(names: set[str], port: int) -> frozenset[str]:
    """Return what a browser may call this server, as it stands in its Host header."""
    bracketed = {f"[{name}]" if ":" in name else name.lower() for name in names}
    return frozenset({f"{name}:{port}" for name in bracketed} | (bracketed if port == _HTTP else set()))


class Guard:
    """Lets through what comes from the page of this server; counts and logs the rest."""

    def __init__(self, app: ASGIApp, hosts: frozenset[str], token: str, complaints: Complaints) -> None:
        self._app, self._hosts, self._token, self._complaints = app, hosts, token, complaints

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, or one WebSocket."""
        headers = Headers(scope=scope)
        why = self._wrong(scope, headers)
        if why is not None:
            self._log(scope, why)
            await _refuse(scope, receive, send, _FORBIDDEN)
        elif _body_size(headers) > _LARGEST_BODY:
            self._log(scope, "a body that is too large")
            await _refuse(scope, receive, send, _TOO_LARGE)
        else:
            await self._app(scope, receive, _with_headers(send, headers["host"]))

    def _wrong(self, scope: Scope, headers: Headers) -> str | None:
        """Return what is wrong with a request, None if nothing is."""
        hosts = headers.getlist("host")
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return f"Host {hosts}"
        acts = scope["type"] == "websocket" or scope["method"] not in ("GET", "HEAD")
        if acts and [origin.lower() for origin in headers.getlist("origin")] != [f"http://{hosts[0].lower()}"]:
            return f"Origin {headers.getlist('origin')}"
        if acts or not scope["path"].endswith(_WITHOUT_TOKEN):
            posted = scope["type"] == "http" and scope["method"] == "POST"
            tokens = headers.getlist("x-token") if posted else QueryParams(scope["query_string"]).getlist("token")
            if len(tokens) != 1 or not secrets.compare_digest(tokens[0].encode(), self._token.encode()):
                return "token"
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


def _with_headers(send: Send, host: str) -> Send:
    policy = (
        f"default-src 'self'; img-src 'self' data:; connect-src 'self' ws://{host}; "  # Safari: 'self' has no ws
        "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    )

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers: Any = MutableHeaders(scope=message)
            headers["Content-Security-Policy"] = policy
            headers["X-Content-Type-Options"] = "nosniff"
            headers["Referrer-Policy"] = "no-referrer"
            headers["Cache-Control"] = "no-store"
            headers["Cross-Origin-Opener-Policy"] = "same-origin"
            headers["Cross-Origin-Resource-Policy"] = "same-origin"
        await send(message)

    return sending
