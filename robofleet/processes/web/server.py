"""The server of the operator's page: one port, its guard, and what a page may say."""

import asyncio
import json
import socket
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket, WebSocketDisconnect

from robofleet.clock import Clock
from robofleet.comms.bus import Bus
from robofleet.config.tree import Config
from robofleet.files import read_plain
from robofleet.processes.web.controls import ASKED, ESTOP, Controls
from robofleet.processes.web.ending import Ending
from robofleet.processes.web.feed import Feed, Page
from robofleet.processes.web.guard import OPEN, Guard, authorities, new_token
from robofleet.processes.web.places import Complaints, Connection, Places
from robofleet.processes.web.ticket import Ticket
from robofleet.processes.web.verdict import REPORT

LOOPBACK = "127.0.0.1"
_PAGE = Path(__file__).parent / "page"
_LARGEST_REPORT = 1 << 26  # [bytes]
_OF_REPORT = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'; base-uri 'none'"
_LARGEST_MESSAGE = 1024  # of a page [bytes]
_LARGEST_HEAD = 16384  # of a request [bytes]
_PAGES = 16
_QUEUE, _AT_ONCE = 1024, 32  # connections that wait to be let in; those that are let in before anybody is answered
_PING_S, _PONG_WITHIN_S = 5.0, 10.0  # then a page that sleeps is forgotten; it comes back by itself
_POLL_S = 0.05
_LEAVE_WITHIN_S = 0.5  # of the end
_LEAVING_S = 0.005
_POLICY_VIOLATION, _TRY_LATER, _GOING_AWAY = 1008, 1013, 1001


class Served(NamedTuple):
    """What a server shows."""

    config: Config
    folder: Path  # of the run
    bus: Bus
    clock: Clock
    name: str  # how browsers call this host
    over: Callable[[], bool]  # whether the run is
    by_hand: bool = False  # somebody waits for this server beside its run
    said: Callable[[], str] = str  # what the launcher does while nobody else speaks
    stays: Callable[[], object] = str  # called when the run is over and somebody looks


class Addresses(NamedTuple):
    """Where the page is."""

    page: str  # with its token: nobody else may see it
    once: str  # for the command line of a browser, which others may see: it opens the page once


async def serve(
    served: Served, listening: socket.socket, ready: Callable[[Addresses], None], cut: Callable[[], bool]
) -> Ending:
    """Serve until ``cut`` says so, or until the run is over and nobody looks; returns how the run ended."""
    config, folder, bus, clock = served.config, served.folder, served.bus, served.clock
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # else an event behind a tick waits for 40 ms
    address, port = listening.getsockname()[:2]
    names = {served.name, address} | ({"localhost"} if address == LOOPBACK else set())
    token, ticket = new_token(), Ticket()
    feed = Feed(config, folder, bus, clock, served.said)
    controls = Controls(bus, clock, config.units)
    complaints = Complaints(clock)
    guard = Guard(application(feed, controls), authorities(names, port), port, token, ticket, complaints)
    server = uvicorn.Server(_settings(guard, Places(complaints)))
    ending = Ending(folder, clock, served.over, patient=served.by_hand)
    feeding, serving = asyncio.create_task(feed.run()), asyncio.create_task(server.serve([listening]))
    try:
        while not server.started:
            await asyncio.sleep(_POLL_S)
        listening.listen(_QUEUE)
        root = f"http://{f'[{served.name}]' if ':' in served.name else served.name}:{port}"
        ready(Addresses(f"{root}/?token={token}", f"{root}{OPEN}?ticket={ticket.secret}"))
        while not (cut() or ending.done or feeding.done() or serving.done()):
            await asyncio.sleep(_POLL_S)
            if ending.look(feed.hearing.state, config.ids, watched=bool(feed.pages)):
                feed.end(ending.frame)
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
        feeding.cancel()
        controls.close()


def application(feed: Feed, controls: Controls) -> Starlette:
    """Return what is behind the guard."""

    async def index(_request: Request) -> Response:
        return FileResponse(_PAGE / "index.html")

    async def report(_request: Request) -> Response:
        try:
            page = await asyncio.to_thread(read_plain, feed.folder / REPORT, _LARGEST_REPORT)
        except OSError:
            return Response("This run has no report yet.", 404, media_type="text/plain")
        return Response(page, media_type="text/html", headers={"Content-Security-Policy": _OF_REPORT})

    async def stop(_request: Request) -> Response:
        return JSONResponse(await controls.do(ESTOP))

    async def live(link: WebSocket) -> None:
        if len(feed.pages) >= _PAGES:
            await link.close(_TRY_LATER)
        else:
            await link.accept()
            await _follow(link, feed, controls)

    return Starlette(
        routes=[
            Route("/", index),
            Route("/report", report),
            Route("/estop", stop, methods=["POST"]),
            WebSocketRoute("/live", live),
            Mount("/", StaticFiles(directory=_PAGE)),
        ]
    )


async def _follow(link: WebSocket, feed: Feed, controls: Controls) -> None:
    """Serve one page until it is closed, says what makes no sense, or the run ends."""
    page = Page(feed)
    feed.pages.add(page)
    telling = asyncio.create_task(page.follow(link.send_text))
    obeying = asyncio.create_task(_obey(link, page, controls))
    try:
        await asyncio.wait({telling, obeying}, return_when=asyncio.FIRST_COMPLETED)
        if obeying.done() and not obeying.result():
            await link.close(_POLICY_VIOLATION)
        elif telling.done():
            telling.result()
            await link.close(_GOING_AWAY)
    except WebSocketDisconnect:
        pass
    finally:
        feed.pages.discard(page)
        for task in (telling, obeying):
            task.cancel()
        await asyncio.gather(telling, obeying, return_exceptions=True)


async def _obey(link: WebSocket, page: Page, controls: Controls) -> bool:
    """Do what a page says, as it says it; returns whether it made sense until it was closed."""
    while (message := await link.receive())["type"] != "websocket.disconnect":
        try:
            said = json.loads(message.get("text") or "")
        except (ValueError, RecursionError):
            return False
        match said:
            case {"do": str(what)} if what == ESTOP or what in ASKED:
                controls.begin(what, page.tell)
            case {"ack": int(seq)}:
                page.drawn(seq)
            case {"picture": bool(wanted)}:
                page.wants_picture = wanted
                page.wake()
            case _:
                return False
    return True


def _settings(app: Any, places: Places) -> uvicorn.Config:
    connection: Any = partial(Connection, places)
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
