"""Middleware of every request: an id, a guard against foreign pages, safe headers, and an answer to failures."""

import time
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

from api.errors import ApiError, handle, problem_response
from api.metrics import RequestMetrics

_log = structlog.get_logger(__name__)

_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})
# Of tus, whose clients may have to send them as POST.
_METHODS_BY_POST = frozenset({"HEAD", "PATCH", "DELETE"})
_MAX_LOGGED_PATH = 200
SAFE_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    # Default of answers that set nothing else: caches must not keep what only a key may read.
    "Cache-Control": "no-store",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


class RequestContext:
    """Give a request its id, its answer safe headers, and the log a line; count it."""

    def __init__(self, app: ASGIApp, metrics: RequestMetrics) -> None:
        self._app = app
        self._metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id = str(uuid_utils.uuid7())
        scope.setdefault("state", {})["request_id"] = request_id
        started_s = time.monotonic()
        status = 0

        async def send_dressed(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(scope=message)
                headers["X-Request-ID"] = request_id
                headers.update(scope["state"].get("rate_limit", {}))
                for name, value in SAFE_HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        with structlog.contextvars.bound_contextvars(request_id=request_id):
            await self._app(scope, receive, send_dressed)
            seconds = time.monotonic() - started_s
            # Ids in paths, and paths that strangers make up, would be series without end.
            route = scope["route"].path if "route" in scope else "unknown"
            self._metrics.count(_known_method(scope["method"]), route, status, seconds)
            caller = scope["state"].get("caller")
            key = caller.key if caller else None
            _log.info(
                "request",
                method=scope["method"],
                path=scope["path"][:_MAX_LOGGED_PATH],
                status=status,
                seconds=round(seconds, 4),
                **({"tenant": key.tenant, "key": key.id} if key else {}),
            )


def _known_method(method: str) -> str:
    return method if method in _METHODS else "other"


class FailureAnswer:
    """Answer failures that no route foresees, such as a full disk.

    It is the innermost of all, so that these answers too get the headers that the others add.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        started = False

        async def send_noted(message: Message) -> None:
            nonlocal started
            started = True
            await send(message)

        try:
            await self._app(scope, receive, send_noted)
        except Exception as error:
            if started:  # Too late for another answer; the server cuts the connection.
                raise
            await handle(Request(scope), error)(scope, receive, send)


class SlowClientGuard:
    """Let go of clients that neither send nor take anything for long, or next to nothing on the whole.

    Each of them would keep a file, memory and a connection for as long as it likes. Streams of events are quiet for
    long, but take what comes at once.

    Parameters
    ----------
    idle_s
        How long the next piece of a body may take to come, or an answer's to be taken.
    min_bytes_per_s
        What a body must come to on average, looked at from ``idle_s`` on.
    """

    def __init__(self, app: ASGIApp, idle_s: float, min_bytes_per_s: float) -> None:
        self._app = app
        self._idle_s, self._min_bytes_per_s = idle_s, min_bytes_per_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        started_s = time.monotonic()
        num_bytes = 0
        complete = False

        async def receive_in_time() -> Message:
            nonlocal num_bytes, complete
            if complete:  # What comes now is that the client has gone.
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
    # The framework lets only such an exception through where it reads a body itself.
    return HTTPException(HTTPStatus.REQUEST_TIMEOUT, headers={"Connection": "close"})


class TusProtocol:
    """What tus asks of every request to an upload: a method by another name, and the version with every answer.

    Parameters
    ----------
    prefix
        Of the addresses of uploads.
    version
        Of the protocol.
    """

    def __init__(self, app: ASGIApp, prefix: str, version: str) -> None:
        self._app = app
        self._prefix = prefix
        self._version = version

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request."""
        if scope["type"] != "http" or not scope["path"].startswith(self._prefix):
            await self._app(scope, receive, send)
            return

        async def send_versioned(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message)["Tus-Resumable"] = self._version
            await send(message)

        # There are proxies and browsers that know no PATCH. Everything behind this sees the method that is meant; the
        # server still sees the method that came, which says how the answer is framed.
        method = Headers(scope=scope).get("x-http-method-override", "").upper()
        if scope["method"] != "POST" or method not in _METHODS_BY_POST:
            await self._app(scope, receive, send_versioned)
            return
        meant = {**scope, "method": method}
        scope["state"]["sent_as_post"] = True
        await self._app(meant, receive, send_versioned)
        scope.update({name: meant[name] for name in ("route",) if name in meant})


class HeadByGet:
    """Answer HEAD wherever GET is answered: by GET's own answer, cut off before its body.

    What would be streamed is not even begun.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve a request."""
        # An answer to POST has a body, also where HEAD is meant.
        is_head = scope["type"] == "http" and scope["method"] == "HEAD" and "sent_as_post" not in scope["state"]
        if not is_head or _is_routed(scope):
            await self._app(scope, receive, send)
            return
        with anyio.CancelScope() as answering:

            async def send_head(message: Message) -> None:
                if message["type"] == "http.response.start":
                    await send(message)
                    await send({"type": "http.response.body", "body": b""})
                    answering.cancel()
                await anyio.lowlevel.checkpoint()

            # For routes whose answer would send a client elsewhere with its method.
            scope["state"]["by_head"] = True
            # A copy: the server must see HEAD, or it waits for the body. What the route notes goes back.
            as_get = {**scope, "method": "GET"}
            await self._app(as_get, receive, send_head)
        scope.update({name: as_get[name] for name in ("route",) if name in as_get})


def _is_routed(scope: Scope) -> bool:
    """Return whether a route accepts the method of a request."""
    return any(route.matches(scope)[0] is Match.FULL for route in scope["app"].routes)


class ForeignPageGuard:
    """Refuse what a web page from elsewhere makes a browser send.

    Without keys any page could use the service through the browser of someone at this machine: directly (its ``Origin``
    says so), or by a name of its own that resolves to loopback (its ``Host`` says so).

    Parameters
    ----------
    allowed_hosts
        Names by which clients may call the service.
    allowed_origins
        Origins whose pages may.
    """

    def __init__(self, app: ASGIApp, allowed_hosts: Collection[str], allowed_origins: Collection[str]) -> None:
        self._app = app
        self._allowed_hosts = frozenset(host.lower() for host in allowed_hosts)
        self._allowed_origins = frozenset(origin.lower() for origin in allowed_origins)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve or refuse a request."""
        if scope["type"] == "http" and (error := self._refusal(Headers(scope=scope))):
            await problem_response(Request(scope), error)(scope, receive, send)
            return
        await self._app(scope, receive, send)

    def _refusal(self, headers: Headers) -> ApiError | None:
        hosts = headers.getlist("host")
        if len(hosts) != 1 or _name_of(hosts[0]) not in self._allowed_hosts:
            return ApiError(
                "host_not_allowed",
                "The service does not answer to this name.",
                hint="Call it by localhost, or add the name to MULTICAP_ALLOWED_HOSTS.",
            )
        origin = headers.get("origin", "").lower()
        foreign = "origin" in headers and origin not in self._allowed_origins
        if foreign and origin.partition("://")[2] != hosts[0].lower():
            return ApiError(
                "origin_not_allowed",
                "Pages from elsewhere may not use the service.",
                hint="If it is a page of yours, add its origin to MULTICAP_ALLOWED_ORIGINS.",
            )
        return None


def _name_of(host: str) -> str | None:
    try:
        return urlsplit(f"//{host}").hostname
    except ValueError:
        return None
