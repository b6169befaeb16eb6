"""Page of a live capture: its people in 3D, latency and cameras, from a server on loopback in a thread."""

import asyncio
import json
import socket
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Self

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import FileResponse, PlainTextResponse
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from api.web.http.middleware import SAFE_HEADERS, ForeignPageGuard
from api.web.live.backlog import Backlog
from api.web.page import PortalFiles
from pipeline.core.data.cameras import Camera
from pipeline.core.errors import InputError, Problem
from pipeline.core.joints import JointSet
from pipeline.core.problems.finding_codes import PARAMETER_RANGE
from pipeline.motion.skeleton.model import SKELETON
from pipeline.run.live.cameras.listeners import StatusFigures, ready_document
from pipeline.run.live.cameras.run import LiveListener
from pipeline.run.live.cameras.totals import LiveTotals
from pipeline.run.live.packing import pack_instant
from pipeline.run.live.records import LiveInstant

_HOST = "127.0.0.1"
_PAGE = Path(__file__).parents[2] / "portal" / "live" / "preview.html"
# Messages that wait for a browser that is slow.
_MAX_MESSAGES, _MAX_BYTES = 16, 2**22
_GRACE_S = 1
# Connections of browsers, and bytes of what one sends, which is nothing.
_MAX_CONNECTIONS, _MAX_RECEIVED_BYTES = 64, 1024


class PreviewPage(LiveListener):
    """Page of a live capture, to be used in a ``with`` block.

    ``port``: port on loopback; 0 for a free one. Raises ``InputError`` if the port can't be used.
    """

    def __init__(self, port: int) -> None:
        try:
            self._listening = socket.create_server((_HOST, port))
        except (OSError, OverflowError) as error:
            message = f"Port {port} can't be used: {getattr(error, 'strerror', None) or 'there is none'}."
            raise InputError(
                [Problem(PARAMETER_RANGE, message, field="preview", hint="Use 0 for a free port.")]
            ) from error
        self.url = f"http://{_HOST}:{self._listening.getsockname()[1]}/"
        routes = [
            Route("/", _page),
            Mount("/portal", PortalFiles()),
            WebSocketRoute("/live", self._send_all),
        ]
        app = _OwnPages(Starlette(routes=routes))
        config = uvicorn.Config(
            app,
            lifespan="off",
            ws="websockets-sansio",
            ws_per_message_deflate=False,
            ws_max_size=_MAX_RECEIVED_BYTES,
            limit_concurrency=_MAX_CONNECTIONS,
            log_config=None,
            access_log=False,
            timeout_graceful_shutdown=_GRACE_S,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, args=[[self._listening]], daemon=True)
        self._loop: asyncio.AbstractEventLoop | None = None
        self._browsers: set[Backlog] = set()
        self._ready: bytes | None = None
        self._num_joints = self._sequence = 0
        self._figures = StatusFigures()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._tell(None)
        self._server.should_exit = True
        self._thread.join()
        self._listening.close()

    def begin(self, cameras: Sequence[Camera], joints: JointSet, frame_rate_hz: float) -> None:
        """Tell browsers the names."""
        self._num_joints = len(joints.names)
        self._ready = _encoded(ready_document(cameras, joints, frame_rate_hz))
        self._tell(self._ready)

    def show(self, instant: LiveInstant, latency_s: float) -> None:
        """Send people to browsers."""
        self._figures.add(latency_s)
        self._sequence += 1
        if self._browsers:
            self._tell(pack_instant(instant, self._num_joints, len(SKELETON), self._sequence))

    def tick(self, totals: LiveTotals) -> None:
        """Send figures of the last second to browsers."""
        self._tell(_encoded(self._figures.message(totals)))

    def _tell(self, message: bytes | None) -> None:
        """Send a message to all browsers; ``None``: the capture is over."""
        if self._loop is not None and self._browsers:
            self._loop.call_soon_threadsafe(self._put, message)

    def _put(self, message: bytes | None) -> None:
        for browser in self._browsers:
            if message is None:
                browser.close()
            else:
                browser.put(message, 0.0)

    async def _send_all(self, websocket: WebSocket) -> None:
        """Send everything to a browser, until it or the capture is gone."""
        await websocket.accept()
        backlog = Backlog(_MAX_MESSAGES, _MAX_BYTES, lambda _: None)
        self._loop = asyncio.get_running_loop()
        self._browsers.add(backlog)
        watching = asyncio.create_task(_until_gone(websocket, backlog))
        try:
            if self._ready is not None:
                await websocket.send_text(self._ready.decode())
            async for message in backlog.taken():
                if message.content.startswith(b"{"):
                    await websocket.send_text(message.content.decode())
                else:
                    await websocket.send_bytes(message.content)
            await websocket.close()
        except (WebSocketDisconnect, RuntimeError):
            pass
        finally:
            self._browsers.discard(backlog)
            watching.cancel()


class _OwnPages:
    """Refusal of pages of other origins, which a browser would let connect."""

    def __init__(self, app: ASGIApp) -> None:
        self._app, self._guard = app, ForeignPageGuard(app, ["localhost", _HOST], [])

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if (refusal := self._guard.refusal(Headers(scope=scope))) is None:
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await WebSocket(scope, receive, send).close()
        else:
            await PlainTextResponse(refusal.detail, 403)(scope, receive, send)


async def _until_gone(websocket: WebSocket, backlog: Backlog) -> None:
    """Close the backlog of a browser when it is gone; what it sends is ignored."""
    while (await websocket.receive())["type"] != "websocket.disconnect":
        pass
    backlog.close()


def _page(request: Request) -> FileResponse:
    return FileResponse(_PAGE, headers=SAFE_HEADERS)


def _encoded(document: dict[str, Any]) -> bytes:
    return json.dumps(document, ensure_ascii=False, separators=(",", ":")).encode()
