"""Middleware: request ids, log lines, safe headers, HEAD, tus, slow clients, foreign pages, unforeseen failures."""

import time
from abc import ABC, abstractmethod
from collections.abc import Collection
from http import HTTPStatus
from urllib.parse import urlsplit

import anyio
import anyio.lowlevel
import structlog
import uuid_utils
from fastapi import HTTPException
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import Request
from starlette.routing import Match
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from api.web.errors import ApiError, handle, problem_response
from api.web.metrics import RequestMetrics
from pipeline.core.problems.request_codes import HOST_NOT_ALLOWED, ORIGIN_NOT_ALLOWED

_log = structlog.get_logger(__name__)

_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
# Methods of tus that a client may send as POST.
_METHODS_BY_POST = frozenset({"HEAD", "PATCH", "DELETE"})
_MAX_LOGGED_PATH = 200
SAFE_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self'; "
        "media-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    # Default of responses that set no other value: caches must not keep what only a key may read.
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class HttpMiddleware(ABC):
    """Middleware of HTTP requests; other scopes, such as the lifespan, pass through it."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request."""
        if scope["type"] == "http":
            await self._serve(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    @abstractmethod
    async def _serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve an HTTP request."""


class RequestContext(HttpMiddleware):
    """Give each request an id, safe response headers and a log line, and count it in the metrics."""

    def __init__(self, app: ASGIApp, metrics: RequestMetrics) -> None:
        super().__init__(app)
        self._metrics = metrics

    async def _serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        request_id = str(uuid_utils.uuid7())
        scope.setdefault("state", {})["request_id"] = request_id
        started_s = time.monotonic()
        status = 0

        def is_by_link() -> bool:
            caller = scope["state"].get("caller")
            return caller is not None and caller.link is not None

        async def send_with_headers(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(scope=message)
                headers["X-Request-ID"] = request_id
                headers.update(scope["state"].get("rate_limit", {}))
                if is_by_link():
                    # Pages of other origins may show what their link opens; the link is no right of the browser's.
                    headers["Cross-Origin-Resource-Policy"] = "cross-origin"
                for name, value in SAFE_HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        with structlog.contextvars.bound_contextvars(request_id=request_id):
            await self._app(scope, receive, send_with_headers)
            seconds = time.monotonic() - started_s
            # The path template bounds the number of time series: paths contain ids, or are made up by clients.
            route = scope["route"].path if "route" in scope else "unknown"
            self._metrics.count(_known_method(scope["method"]), route, status, seconds)
            caller = scope["state"].get("caller")
            key = caller.key if caller else None
            _log.info(
                "request",
                method=scope["method"],
                # Without the query, which may have the secret of a link.
                path=scope["path"][:_MAX_LOGGED_PATH],
                status=status,
                seconds=round(seconds, 4),
                **({"tenant": key.tenant, "key": key.id} if key else {}),
                **({"tenant": caller.tenant, "link": caller.link.id} if caller and caller.link else {}),
            )


def _known_method(method: str) -> str:
    return method if method in _METHODS else "other"


class FailureResponse(HttpMiddleware):
    """Answer exceptions that no route handles, such as a full disk.

    This is the innermost middleware, so that its responses get the headers that the others add.
    """

    async def _serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        started = False

        async def send_and_record(message: Message) -> None:
            nonlocal started
            started = True
            await send(message)

        try:
            await self._app(scope, receive, send_and_record)
        except Exception as error:
            if started:  # Too late for another response; the server closes the connection.
                raise
            await handle(Request(scope), error)(scope, receive, send)


class SlowClientGuard(HttpMiddleware):
    """End requests of clients that neither send nor receive for too long, or send too slowly on average.

    Such a client would occupy a file, memory and a connection without end. Event streams are quiet for long times, but
    their clients receive each event at once. ``idle_s`` is the longest time until the next piece of a body arrives, or
    of the response is received; ``min_bytes_per_s`` is the smallest average rate of a body, checked from then on.
    """

    def __init__(self, app: ASGIApp, idle_s: float, min_bytes_per_s: float) -> None:
        super().__init__(app)
        self._idle_s, self._min_bytes_per_s = idle_s, min_bytes_per_s

    async def _serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        started_s = time.monotonic()
        num_bytes = 0
        complete = False

        async def receive_in_time() -> Message:
            nonlocal num_bytes, complete
            if complete:  # The only message after the body is the client's disconnection.
                return await receive()
            try:
                with anyio.fail_after(self._idle_s):
                    message = await receive()
            except TimeoutError:
                raise _too_slow() from None
            num_bytes += len(message.get("body", b""))
            complete = not message.get("more_body", False)
            elapsed_s = time.monotonic() - started_s
            if not complete and elapsed_s > self._idle_s and num_bytes < elapsed_s * self._min_bytes_per_s:
                raise _too_slow()
            return message

        async def send_in_time(message: Message) -> None:
            with anyio.fail_after(self._idle_s):
                await send(message)

        await self._app(scope, receive_in_time, send_in_time)


def _too_slow() -> HTTPException:
    # The framework passes on no other exception from a body that it reads itself.
    return HTTPException(HTTPStatus.REQUEST_TIMEOUT, headers={"Connection": "close"})


class TusProtocol(HttpMiddleware):
    """Rules of tus for all requests to uploads: overridden methods, and the version in every response.

    A HEAD that fails by the service's fault is 423: clients that meet 5xx there (tus-js-client) forget the upload and
    send the whole file again, while they ask again after 423.

    ``prefix`` begins the paths of uploads.
    """

    def __init__(self, app: ASGIApp, prefix: str, version: str) -> None:
        super().__init__(app)
        self._prefix = prefix
        self._version = version

    async def _serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        if not scope["path"].startswith(self._prefix):
            await self._app(scope, receive, send)
            return
        override = Headers(scope=scope).get("x-http-method-override", "").upper()
        method = override if scope["method"] == "POST" else scope["method"]

        async def send_versioned(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message)["Tus-Resumable"] = self._version
                if method == "HEAD" and message["status"] >= HTTPStatus.INTERNAL_SERVER_ERROR:
                    message = {**message, "status": HTTPStatus.LOCKED}
            await send(message)

        # Some proxies and browsers can't send PATCH. Inner middleware and routes see the overriding method. The server
        # still sees POST, which decides how the response is framed.
        if scope["method"] != "POST" or method not in _METHODS_BY_POST:
            await self._app(scope, receive, send_versioned)
            return
        overridden = {**scope, "method": method}
        scope["state"]["sent_as_post"] = True
        await self._app(overridden, receive, send_versioned)
        scope.update({name: overridden[name] for name in ("route",) if name in overridden})


class HeadByGet(HttpMiddleware):
    """Answer HEAD wherever GET is answered: with the headers of the response to GET, without its body.

    The body of a streamed response is never started.
    """

    async def _serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        # A request that was sent as POST gets a body, even if it overrides the method with HEAD.
        is_head = scope["method"] == "HEAD" and "sent_as_post" not in scope["state"]
        if not is_head or any(route.matches(scope)[0] is Match.FULL for route in scope["app"].routes):
            await self._app(scope, receive, send)
            return
        with anyio.CancelScope() as answering:

            async def send_head(message: Message) -> None:
                if message["type"] == "http.response.start":
                    await send(message)
                    await send({"type": "http.response.body", "body": b""})
                    answering.cancel()
                await anyio.lowlevel.checkpoint()

            # For routes that redirect: the client would repeat the redirected request with HEAD.
            scope["state"]["by_head"] = True
            # A copy, because the server must see HEAD, or it waits for the body. The matched route is copied back.
            as_get = {**scope, "method": "GET"}
            await self._app(as_get, receive, send_head)
        scope.update({name: as_get[name] for name in ("route",) if name in as_get})


class ForeignPageGuard(HttpMiddleware):
    """Refuse requests that a web page of another origin makes a browser send.

    Without keys, any page could use the service through the browser of a person at this machine: directly, which
    ``Origin`` shows, or by a name that resolves to loopback, which ``Host`` shows. Clients may call the service by
    ``allowed_hosts``, and pages of ``allowed_origins`` may call it.
    """

    def __init__(self, app: ASGIApp, allowed_hosts: Collection[str], allowed_origins: Collection[str]) -> None:
        super().__init__(app)
        self._allowed_hosts = frozenset(host.lower() for host in allowed_hosts)
        self._allowed_origins = frozenset(origin.lower() for origin in allowed_origins)

    async def _serve(self, scope: Scope, receive: Receive, send: Send) -> None:
        if error := self.refusal(Headers(scope=scope)):
            await problem_response(Request(scope), error)(scope, receive, send)
            return
        await self._app(scope, receive, send)

    def refusal(self, headers: Headers) -> ApiError | None:
        """Error of a request with these headers; ``None`` if it is allowed."""
        hosts = headers.getlist("host")
        if len(hosts) != 1 or _host_name(hosts[0]) not in self._allowed_hosts:
            return ApiError(
                HOST_NOT_ALLOWED,
                "The request's Host is not a name of the service.",
                hint="Call the service by localhost, or add the name to MULTICAP_ALLOWED_HOSTS.",
            )
        origin = headers.get("origin", "").lower()
        foreign = "origin" in headers and origin not in self._allowed_origins
        if foreign and origin.partition("://")[2] != hosts[0].lower():
            return ApiError(
                ORIGIN_NOT_ALLOWED,
                "Pages of other origins may not use the service.",
                hint="If it is your page, add its origin to MULTICAP_ALLOWED_ORIGINS.",
            )
        return None


def _host_name(host: str) -> str | None:
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None
