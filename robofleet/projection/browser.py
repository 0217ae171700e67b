"""A display that is a page: any browser on the projector's computer opens it, full-screen.

The page tells its real size in pixels, shows each picture one to one, and says when it was drawn. A page that reloads
or comes later gets the newest picture.
"""

import asyncio
import json
import socket
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import cv2
import uvicorn
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from robofleet.config.projectors import ProjectorSettings
from robofleet.core.arrays import Image
from robofleet.core.clock import Clock
from robofleet.projection.display import DisplayError
from robofleet.projection.kiosk import kiosk

_PAGE = Path(__file__).with_name("page.html")
_DRAWN_WITHIN_S = 5.0
_LARGEST_MESSAGE = 256  # of a page [bytes]
_END_WITHIN_S = 5.0


class BrowserDisplay:
    """Serves one page that shows pictures."""

    def __init__(self, projector: ProjectorSettings, clock: Clock, *, wait_s: float) -> None:
        """Serve; wait for a page at the first picture for ``wait_s``. DisplayError where the port is not free."""
        self._projector, self._clock, self._wait_s = projector, clock, wait_s
        self._changed = threading.Condition()
        self._png, self._number, self._drawn, self._drawn_ns = b"", 0, 0, 0
        self._size: tuple[int, int] | None = None  # of the page that is there [px]
        self._pages: set[WebSocket] = set()
        self._opened = ExitStack()  # a kiosk's browser
        try:
            listening = socket.create_server((projector.host, projector.port))
        except OSError as error:
            where = f"{projector.host}:{projector.port}"
            raise DisplayError(
                f"projector {projector.name}: {where} cannot be served: {error.strerror}: mend its `host` or `port`"
            ) from error
        host = f"[{projector.host}]" if ":" in projector.host else projector.host
        self.address = f"http://{host}:{projector.port}/"
        routes = [
            Route("/", self._index),
            Route("/picture/{number:int}", self._picture),
            WebSocketRoute("/live", self._live),
        ]
        hosts = Middleware(TrustedHostMiddleware, allowed_hosts=[projector.host, "localhost", "127.0.0.1"])
        self._server = uvicorn.Server(uvicorn.Config(
            Starlette(routes=routes, middleware=[hosts]), ws="websockets-sansio", lifespan="off", log_config=None,
            access_log=False, server_header=False, ws_max_size=_LARGEST_MESSAGE, ws_ping_interval=2.0,
            ws_ping_timeout=4.0, timeout_graceful_shutdown=1,
        ))  # fmt: skip
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread = threading.Thread(target=self._serve, args=(listening,), name="display", daemon=True)
        self._thread.start()

    def kiosk(self) -> None:
        """Open the page full-screen on this computer; DisplayError without a Chromium or a screen."""
        self._opened.enter_context(kiosk(self.address, (self._projector.width, self._projector.height)))

    def show(self, picture: Image) -> int:
        """Show a picture; returns when the page had drawn it."""
        png = bytes(cv2.imencode(".png", picture, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1])
        with self._changed:
            if not self._changed.wait_for(lambda: self._size is not None, self._wait_s):
                raise self._away(f"no browser has opened {self.address}: open it full-screen, or name --kiosk")
            size = self._projector.width, self._projector.height
            if self._size != size:
                seen, meant = (f"{width} x {height}" for width, height in (self._size or size, size))
                raise self._away(
                    f"its browser shows {seen} px, not {meant}: make it full-screen, without zoom, or mend "
                    "`width` and `height`"
                )
            self._png, self._number = png, self._number + 1
            number = self._number
            if self._loop is not None:
                asyncio.run_coroutine_threadsafe(self._tell(), self._loop)
            if not self._changed.wait_for(lambda: self._drawn >= number, _DRAWN_WITHIN_S):
                raise self._away("its browser draws no pictures: bring its page to the front, and reload it")
            return self._drawn_ns

    def close(self) -> None:
        """End the page's server, and a kiosk's browser."""
        self._server.should_exit = True
        self._thread.join(_END_WITHIN_S)
        self._opened.close()

    def _away(self, why: str) -> DisplayError:
        return DisplayError(f"projector {self._projector.name}: {why}")

    def _serve(self, listening: socket.socket) -> None:
        async def serve() -> None:
            self._loop = asyncio.get_running_loop()
            await self._server.serve([listening])

        with listening:
            asyncio.run(serve())

    async def _index(self, _request: Request) -> Response:
        return FileResponse(_PAGE, headers={"Cache-Control": "no-store"})

    async def _picture(self, _request: Request) -> Response:
        with self._changed:
            return Response(self._png, media_type="image/png", headers={"Cache-Control": "no-store"})

    async def _tell(self) -> None:
        for page in [*self._pages]:
            await page.send_text(json.dumps({"picture": self._number}))

    async def _live(self, page: WebSocket) -> None:
        """Take what a page says: its size, and which picture it has drawn."""
        await page.accept()
        self._pages.add(page)
        try:
            while True:
                await self._hear(page, json.loads(await page.receive_text()))
        except (WebSocketDisconnect, ValueError):
            pass
        finally:
            self._pages.discard(page)
            with self._changed:
                self._size = self._size if self._pages else None
                self._changed.notify_all()

    async def _hear(self, page: WebSocket, message: Any) -> None:
        now_ns = self._clock.now_ns()
        match message:
            case {"size": [int(width), int(height)]}:
                with self._changed:
                    self._size = width, height
                    self._changed.notify_all()
                if self._number:
                    await page.send_text(json.dumps({"picture": self._number}))
            case {"drawn": int(number)} if number > self._drawn:
                with self._changed:
                    self._drawn, self._drawn_ns = number, now_ns
                    self._changed.notify_all()
            case _:
                pass
