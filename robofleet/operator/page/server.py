"""The server of the operator's page: one port, its guard, and what a page may say."""

import asyncio
import ipaddress
import json
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, get_args
from weakref import WeakSet

import segno
import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from robofleet.bus.bus import Bus
from robofleet.bus.permissions import OPERATOR
from robofleet.config.projectors import Shown
from robofleet.config.tree import Config
from robofleet.core.clock import Clock
from robofleet.core.files import read_plain
from robofleet.core.refusal import RefusedError
from robofleet.operator.asking import ESTOP
from robofleet.operator.hand import Hands, Stick
from robofleet.operator.page import projectors
from robofleet.operator.page.access import ROLES, Access, CookieAccess, TokenAccess, permits
from robofleet.operator.page.certificate import PageKeys
from robofleet.operator.page.connection_limiter import Complaints, Connection, ConnectionLimiter
from robofleet.operator.page.controls import REQUESTS, Controls
from robofleet.operator.page.ending import Ending
from robofleet.operator.page.feed import Feed, Page
from robofleet.operator.page.frames import answer, own_hands
from robofleet.operator.page.guard import Guard, authorities
from robofleet.operator.page.page_address import LOOPBACK, Addresses
from robofleet.operator.page.refused import TEMPLATES
from robofleet.operator.page.tls_handshake import TlsHandshake
from robofleet.operator.page.verdict import REPORT

_SHOWN = frozenset(get_args(Shown))
_PAGE = Path(__file__).parent / "static"
_LARGEST_REPORT = 1 << 26  # [bytes]
_OF_REPORT = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; base-uri 'none'"
_LARGEST_MESSAGE = 1024  # of a page [bytes]
_LARGEST_HEAD = 16384  # of a request [bytes]
_PAGES, _OF_OPERATORS = 16, 4  # at once; those that viewers leave free
_QUEUE, _AT_ONCE = 1024, 32  # connections that wait to be let in; those that are let in before anybody is answered
_PING_S, _PONG_WITHIN_S = 5.0, 10.0  # then a page that sleeps is forgotten; it comes back by itself
_POLL_S = 0.05
_LEAVE_WITHIN_S = 0.5  # of the end
_LEAVING_S = 0.005
_POLICY_VIOLATION, _TRY_LATER, _GOING_AWAY = 1008, 1013, 1001
_FORBIDDEN = 403
_NOT_FOR_VIEWERS = "refused (403): a viewer may hold the run and press the emergency stop; ask an operator"


@dataclass(frozen=True, kw_only=True)
class Served:
    """What a server shows."""

    config: Config
    folder: Path  # of the run
    bus: Bus
    clock: Clock
    name: str  # how browsers call this host
    over: Callable[[], bool]  # whether the run is
    keys: PageKeys | None = None  # None: this computer only
    by_hand: bool = False  # somebody waits for this server beside its run
    line: Callable[[], str] = str  # what the launcher does while nobody else speaks, and how the run ends
    launcher_lives: Callable[[], bool] = bool  # which makes the report after the end
    stays: Callable[[], object] = str  # called when the run is over and somebody looks


async def serve(
    served: Served, listening: socket.socket, ready: Callable[[Addresses], None], cut: Callable[[], bool]
) -> Ending:
    """Serve until ``cut`` says so, or until the run is over and nobody looks; returns how the run ended."""
    config, folder, bus, clock, keys = served.config, served.folder, served.bus, served.clock, served.keys
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # else an event behind a tick waits for 40 ms
    address, port = listening.getsockname()[:2]
    if keys is None and not ipaddress.ip_address(address).is_loopback:
        raise RefusedError(f"{served.name} is {address}, which others reach: name {LOOPBACK}, or {address} itself")
    names = {served.name, address} | ({"localhost"} if address == LOOPBACK else set())
    scheme = "http" if keys is None else "https"
    root = f"{scheme}://{f'[{served.name}]' if ':' in served.name else served.name}:{port}"
    access = TokenAccess(root, port) if keys is None else CookieAccess(root, port, keys)
    feed = Feed(config, folder, bus, clock, served.line)
    controls = Controls(bus, clock, config.units)
    complaints = Complaints(clock)
    guard = Guard(application(feed, controls, access), authorities(names, port, scheme), access, complaints)
    limiter = ConnectionLimiter(complaints)
    secured = WeakSet[asyncio.Transport]()
    protocol = partial(TlsHandshake, keys.context, limiter, secured) if keys else partial(Connection, limiter)
    server = uvicorn.Server(_settings(guard, protocol))
    ending = Ending(served)
    feeding, serving = asyncio.create_task(feed.run()), asyncio.create_task(server.serve([listening]))
    try:
        while not server.started:
            await asyncio.sleep(_POLL_S)
        listening.listen(_QUEUE)
        ready(access.addresses())
        while not (cut() or ending.done or feeding.done() or serving.done()):
            await asyncio.sleep(_POLL_S)
            if ending.look(feed.hearing.state, config.ids, watched=bool(feed.pages)):
                feed.end(ending.frame)
                controls.reset_ended = ending.reset
                if not ending.done:
                    served.stays()
        if feeding.done():
            feeding.result()  # raises: a page that shows nothing must not look as if it did
        return ending
    finally:
        for page in feed.pages:
            page.leave()
        with suppress(TimeoutError):
            async with asyncio.timeout(_LEAVE_WITHIN_S):
                while feed.pages:  # a server that exits cuts off what is on its way to them
                    await asyncio.sleep(_LEAVING_S)
                server.should_exit = True
                await asyncio.shield(serving)
        server.should_exit = True
        for transport in [*secured]:
            transport.abort()  # without waiting for the other end's good-bye
        feeding.cancel()
        controls.close()


def application(feed: Feed, controls: Controls, access: Access) -> Starlette:
    """Return what is behind the guard, which has given each request its role."""

    veils: dict[str, bytes] = {}  # of projectors, by name: each is made once

    async def index(request: Request) -> Response:
        role = request.scope["role"] if isinstance(access, CookieAccess) else None
        return TEMPLATES.TemplateResponse(request, "index.html", {"role": role})

    async def invite(request: Request) -> Response:
        role = request.path_params["role"]
        if not isinstance(access, CookieAccess) or role not in ROLES:
            return Response(status_code=404)
        if not permits(request.scope["role"], "invite"):
            return Response(status_code=_FORBIDDEN)
        address = access.invite(role)
        return JSONResponse({"role": role, "address": address, "code": await asyncio.to_thread(_code, address)})

    async def once(_request: Request) -> Response:
        return JSONResponse(access.another()) if isinstance(access, TokenAccess) else Response(status_code=404)

    async def report(_request: Request) -> Response:
        try:
            page = await asyncio.to_thread(read_plain, feed.folder / REPORT, _LARGEST_REPORT)
        except OSError:
            return Response("This run has no report yet.", 404, media_type="text/plain")
        return Response(page, media_type="text/html", headers={"Content-Security-Policy": _OF_REPORT})

    async def projector(request: Request) -> Response:
        return TEMPLATES.TemplateResponse(request, "projector.html")

    async def background(_request: Request) -> Response:
        try:
            image, kind = await asyncio.to_thread(projectors.background, feed.config)
        except RefusedError as error:
            return Response(str(error), 404, media_type="text/plain")
        return Response(image, media_type=kind)

    async def veil(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in feed.projectors:
            return Response(status_code=404)
        if name not in veils:
            veils[name] = await asyncio.to_thread(projectors.veil, feed.config, name)
        return Response(veils[name], media_type="image/png")

    async def stop(_request: Request) -> Response:
        return JSONResponse(await controls.do(ESTOP))

    async def live(link: WebSocket) -> None:
        role = link.scope["role"]
        if len(feed.pages) >= (_PAGES if role == OPERATOR else _PAGES - _OF_OPERATORS):
            await link.close(_TRY_LATER)
        else:
            await link.accept()
            await _follow(link, feed, controls, role)

    return Starlette(
        routes=[
            Route("/", index),
            Route("/index.html", index),
            Route("/invite/{role}", invite, methods=["POST"]),
            Route("/once", once, methods=["POST"]),
            Route("/report", report),
            Route("/projector", projector),
            Route("/projector/background", background),
            Route("/projector/veil/{name}", veil),
            Route("/estop", stop, methods=["POST"]),
            WebSocketRoute("/live", live),
            Mount("/", StaticFiles(directory=_PAGE)),
        ]
    )


def _code(address: str) -> str:
    """Return an address as a QR code: the address of an SVG image."""
    code: str = segno.make(address, error="l", micro=False).svg_data_uri(border=4, light="#fff")
    return code


async def _follow(link: WebSocket, feed: Feed, controls: Controls, role: str) -> None:
    """Serve one page until it is closed, says what makes no sense, or the run ends."""
    page, hands = Page(feed), Hands(feed.bus, feed.config, feed.now_ns) if role == OPERATOR else None
    if hands is not None and hands.epochs:
        page.tell(own_hands(hands.epochs))
    feed.pages.add(page)
    sender = asyncio.create_task(page.follow(link.send_text))
    obeying = asyncio.create_task(_obey(link, feed, page, controls, role, hands))
    try:
        await asyncio.wait({sender, obeying}, return_when=asyncio.FIRST_COMPLETED)
        if obeying.done() and not obeying.result():
            await link.close(_POLICY_VIOLATION)
        elif sender.done():
            sender.result()
            await link.close(_GOING_AWAY)
    except WebSocketDisconnect:
        pass
    finally:
        feed.pages.discard(page)
        if page.projects:
            feed.now_shows()
        if hands is not None:
            hands.let_go()
        for task in (sender, obeying):
            task.cancel()
        await asyncio.gather(sender, obeying, return_exceptions=True)


async def _obey(link: WebSocket, feed: Feed, page: Page, controls: Controls, role: str, hands: Hands | None) -> bool:
    """Do what a page says, as it says it; returns whether it made sense until it was closed."""
    while (message := await link.receive())["type"] != "websocket.disconnect":
        try:
            request = json.loads(message.get("text") or "")
        except (ValueError, RecursionError):
            return False
        match request:
            case {"do": str(what)} if what == ESTOP or what in REQUESTS:
                if permits(role, what):
                    controls.begin(what, page.tell)
                else:
                    page.tell(answer(what, False, _NOT_FOR_VIEWERS))
            case {"drive": str(group), "stick": [int() | float() as forward, int() | float() as turn, bool(held)],
                  "tick": int(tick)} if hands is not None:  # fmt: skip
                out = request.get("out")  # the robot that is driven out of a held run
                if not (out is None or isinstance(out, str)) or not hands.drive(
                    group, Stick(forward, turn, held), tick, out
                ):
                    return False
            case {"show": list(show)} if set(map(str, show)) <= _SHOWN:
                if permits(role, "show"):
                    feed.now_shows(show)
                else:
                    page.tell(answer("show", False, _NOT_FOR_VIEWERS))
            case _ if not page.hear(request):
                return False
    return True


def _settings(app: Any, connection: Any) -> uvicorn.Config:
    return uvicorn.Config(
        app,
        http=connection,
        ws="websockets-sansio",
        lifespan="off",
        log_config=None,
        log_level="error",  # what is refused is counted and said here
        access_log=False,
        server_header=False,
        date_header=False,
        proxy_headers=False,
        ws_max_size=_LARGEST_MESSAGE,
        ws_ping_interval=_PING_S,
        ws_ping_timeout=_PONG_WITHIN_S,
        ws_per_message_deflate=False,  # it costs more time than a local network takes
        h11_max_incomplete_event_size=_LARGEST_HEAD,
        timeout_keep_alive=5,
        backlog=_AT_ONCE,
    )
