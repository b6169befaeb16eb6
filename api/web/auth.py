"""Authentication and authorization: API keys, browser sessions, links, scopes, and the caller's own records.

A service without keys serves all clients as the default tenant.
"""

import contextlib
import inspect
import uuid
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from dataclasses import dataclass, replace
from typing import Annotated

from fastapi import Depends, Header, Request, Security
from fastapi.security import APIKeyCookie, APIKeyQuery, HTTPBearer
from fastapi.security.http import HTTPAuthorizationCredentials
from fastapi.security.utils import get_authorization_scheme_param
from starlette.requests import HTTPConnection
from starlette.responses import Response
from starlette.websockets import WebSocket

from api.web.dependencies import Services, ServicesDep
from api.web.errors import ApiError
from api.web.http.keys_in_use import Credential
from api.web.http.rates import client_network
from pipeline.core.problems import request_codes
from worker.store.errors import NotFound
from worker.store.model.phone_records import JoinLink, UploadingPhone
from worker.store.model.rights import DEFAULT_TENANT, Actor, Key, Link, LinkScope, Scope
from worker.store.repositories.links import LINK_PREFIX
from worker.store.tenant_records import TenantRecords

COOKIE = "multicap_session"
"""Name of the cookie of a browser's session, without its prefix."""
LINK = "link"
"""Parameter of an address with the secret of a link."""
ALL_RESULTS = "results.zip"
"""Name of all result files together, in links."""

_READING = frozenset({"GET", "HEAD", "OPTIONS"})

_bearer = HTTPBearer(auto_error=False, scheme_name="key", description="A key, `mc_...`, of `multicap keys create`.")
KEY_SUBPROTOCOL = "mc.key."
"""Start of a subprotocol of WebSockets that pages of other origins offer; their key follows."""
JOIN_SUBPROTOCOL = "mc.link."
"""Start of a subprotocol of WebSockets that phones offer; the secret of their recording's link follows."""


class _BrowserCookie(APIKeyCookie):
    async def __call__(self, request: HTTPConnection) -> str | None:
        return request.cookies.get(cookie_name(request))


_cookie = _BrowserCookie(
    name=COOKIE,
    auto_error=False,
    scheme_name="browser",
    description="Session of a browser that signed in with a key. Over TLS the name has the prefix `__Host-`.",
)
_link = APIKeyQuery(
    name=LINK,
    auto_error=False,
    scheme_name="link",
    description="Secret of a link, `mcl_...`, for `<video>`, `<a>` and `EventSource`, which send no headers.",
)


@dataclass(frozen=True, slots=True)
class Caller:
    """Caller of a request: tenant, scopes, key or link, and network."""

    tenant: str
    scopes: frozenset[Scope]
    key: Key | None  # ``None`` as long as the service has no keys
    network: str  # Network that the request comes from (``api.web.http.rates``)
    link: Link | None = None  # Link that the request brings in place of a key; ``None`` without one
    join: JoinLink | None = None  # Link of a recording, which a phone brings in place of a key
    phone: UploadingPhone | None = None  # Phone of the recording; ``None`` until it says which it is

    @property
    def owner(self) -> str:
        """Name under which requests share threads and streams.

        The tenant, the link, the recording of a phone, or the network if there are no keys.
        """
        if self.link is not None:
            return f"link {self.link.id}"
        if self.join is not None:
            return f"recording {self.join.recording_id}"
        return f"tenant {self.tenant}" if self.key else f"network {self.network}"

    @property
    def credential(self) -> Credential:
        """Key or link on whose validity the request depends."""
        if self.link is not None:
            return Credential("link", self.link.id)
        if self.join is not None:
            return Credential("join", self.join.id)
        return Credential("key", self.key.id if self.key else None)


def wrong_key(request: HTTPConnection, services: Services) -> ApiError:
    """Count a wrong key of a client; return the error to raise: 401, or 429 after too many."""
    try:
        rate_limit = services.wrong_keys.count(client_network(request))
    except ApiError as too_many:
        return too_many
    return _key_required("This key is not known, has expired or was revoked.", rate_limit)


def _key_required(detail: str, headers: Mapping[str, str]) -> ApiError:
    return ApiError(
        request_codes.KEY_REQUIRED,
        detail,
        hint="Send Authorization: Bearer mc_..., with a key that `multicap keys create` made.",
        headers={"WWW-Authenticate": "Bearer", **headers},
    )


def _find_caller(
    request: Request,
    services: ServicesDep,
    bearer: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)],
    cookie: Annotated[str | None, Security(_cookie)],
) -> Caller:
    """Identify the caller; raise 401 without a valid key, 429 if the tenant calls too often."""
    is_reading = request.method in _READING
    return _identify(request, services, bearer.credentials if bearer else None, cookie, is_reading=is_reading)


def websocket_caller(websocket: WebSocket, services: Services) -> Caller:
    """Identify the caller who opens a WebSocket, by which things are made; errors like a route that changes something.

    Browsers send no headers of a page's own with a WebSocket, but their cookie: the service's own page needs no more.
    Pages of other origins offer a subprotocol with their key.
    """
    scheme, credentials = get_authorization_scheme_param(websocket.headers.get("authorization"))
    cookie = websocket.cookies.get(cookie_name(websocket))
    bearer = credentials if scheme.lower() == "bearer" else None
    if "authorization" not in websocket.headers:
        offered = [name for name in websocket.scope["subprotocols"] if name.startswith(KEY_SUBPROTOCOL)]
        bearer = offered[0].removeprefix(KEY_SUBPROTOCOL) if offered else None
    return _require(_identify(websocket, services, bearer, cookie, is_reading=False), Scope.WRITE)


def joining_secret(websocket: WebSocket) -> str | None:
    """Secret of a recording's link that a WebSocket brings, as a subprotocol or a bearer; ``None`` without one."""
    scheme, credentials = get_authorization_scheme_param(websocket.headers.get("authorization"))
    if scheme.lower() == "bearer" and credentials.startswith(LINK_PREFIX):
        return credentials
    offered = (name for name in websocket.scope["subprotocols"] if name.startswith(JOIN_SUBPROTOCOL))
    return next((name.removeprefix(JOIN_SUBPROTOCOL) for name in offered), None)


def joining_caller(request: HTTPConnection, services: Services, secret: str) -> Caller:
    """Identify the phone's side of a recording by the secret of its link; raise 401 if it is unknown, or 429."""
    join = services.store.join_secrets.find(secret)
    if join is None:
        raise _unknown_link(request, services)
    network = client_network(request)
    caller = Caller(join.tenant, frozenset({Scope.READ, Scope.WRITE}), None, network, join=join)
    request.state.caller = caller
    # Phones must not use up the requests of the tenant.
    request.state.rate_limit = services.rates.count(caller.owner)
    return caller


def _identify(
    request: HTTPConnection, services: Services, bearer: str | None, cookie: str | None, *, is_reading: bool
) -> Caller:
    if bearer is not None or "authorization" in request.headers:
        key = services.store.keys.find(bearer) if bearer else None
        if key is None:
            raise wrong_key(request, services)
    elif cookie is not None and (key := services.store.browser_sessions.find(cookie)) is not None:
        if not is_reading:
            _refuse_foreign_pages(request)
    elif services.store.keys.exist():
        if cookie is None:
            raise _key_required("The service asks for a key.", {})
        # The browser forgets the cookie. It is not counted as a wrong key: a browser that slept sends an old one.
        raise _key_required("The browser's session has ended.", {"Set-Cookie": deletion(request)})
    else:
        key = None
    tenant, scopes = (DEFAULT_TENANT, frozenset(Scope)) if key is None else (key.tenant, key.scopes)
    caller = Caller(tenant, scopes, key, client_network(request))
    request.state.caller = caller
    request.state.rate_limit = services.rates.count(caller.tenant)
    return caller


def _refuse_foreign_pages(request: HTTPConnection) -> None:
    """Raise 403 if another page than the service's own would change something by the browser's cookie.

    Browsers send the cookie with requests of any page. ``ForeignPageGuard`` lets allowed origins through, but pages of
    these origins must use keys, not cookies.
    """
    origin = request.headers.get("origin", "").lower().partition("://")[2]
    if origin != request.headers["host"].lower():
        raise ApiError(
            request_codes.CROSS_SITE_REQUEST, "A browser's session may be used by the service's own page only."
        )


def _require(caller: Caller, scope: Scope) -> Caller:
    if scope not in caller.scopes:
        raise ApiError(
            request_codes.SCOPE_MISSING, f"The key lacks the scope {scope}.", hint="Ask for a key that has it."
        )
    return caller


def _require_method(request: Request, caller: Caller) -> Caller:
    return _require(caller, Scope.READ if request.method in _READING else Scope.WRITE)


async def _authorize(request: Request, caller: Annotated[Caller, Depends(_find_caller)]) -> Caller:
    """Return the caller if its key allows the request's method."""
    return _require_method(request, caller)


_Find = Callable[..., Caller | Coroutine[None, None, Caller]]


def _in_turn(find: _Find) -> Callable[..., AsyncIterator[Caller]]:
    """Dependency with the caller of ``find``, whose turn it is for as long as the route works.

    Routes that are ``async`` wait for their clients and take no turn: their work has shares of its own.
    """

    async def in_turn(
        request: Request, services: ServicesDep, caller: Annotated[Caller, Depends(find)]
    ) -> AsyncIterator[Caller]:
        waits_for_client = inspect.iscoroutinefunction(request.scope["endpoint"])
        async with contextlib.nullcontext() if waits_for_client else services.turns.turn(caller.owner):
            yield caller

    return in_turn


def _tenant_records(find: _Find) -> Callable[..., Coroutine[None, None, TenantRecords]]:
    in_turn = _in_turn(find)

    async def records(
        request: Request, services: ServicesDep, caller: Annotated[Caller, Depends(in_turn, scope="function")]
    ) -> TenantRecords:
        return _records(request, services, caller)

    return records


def _records(request: Request, services: Services, caller: Caller) -> TenantRecords:
    actor = Actor(caller.key.id if caller.key else None, request.state.request_id)
    return services.store.tenant(caller.tenant, services.quotas, actor, caller.phone)


_any_in_turn = _in_turn(_find_caller)


async def _authorize_admin(caller: Annotated[Caller, Depends(_any_in_turn, scope="function")]) -> Caller:
    return _require(caller, Scope.ADMIN)


def _find_viewer(
    request: Request,
    services: ServicesDep,
    bearer: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)],
    cookie: Annotated[str | None, Security(_cookie)],
    secret: Annotated[str | None, Security(_link)],
) -> Caller:
    """Identify the caller of a route that links may open. With a link, its rights alone count."""
    if secret is None:
        return _require_method(request, _find_caller(request, services, bearer, cookie))
    link = services.store.link_secrets.find(secret)
    if link is None:
        raise _unknown_link(request, services)
    caller = Caller(link.tenant, frozenset({Scope.READ}), None, client_network(request), link)
    request.state.caller = caller
    # Strangers must not use up the requests of the tenant.
    request.state.rate_limit = services.rates.count(caller.owner)
    return caller


def _unknown_link(request: HTTPConnection, services: Services) -> ApiError:
    """Count a wrong link like a wrong key; return the error to raise."""
    error = wrong_key(request, services)
    if error.status != 401:
        return error
    hint = "Ask for a new link."
    return ApiError(
        request_codes.LINK_UNKNOWN,
        "This link is not known, has ended or was revoked.",
        hint=hint,
        headers=error.headers,
    )


def _find_uploader(
    request: Request,
    services: ServicesDep,
    bearer: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)],
    cookie: Annotated[str | None, Security(_cookie)],
    multicap_phone: Annotated[
        str | None, Header(max_length=64, description="Id of a recording's phone, beside the secret of its link.")
    ] = None,
) -> Caller:
    """Identify the caller of a route of uploads: by a key, or as the phone of a recording."""
    if bearer is None or not bearer.credentials.startswith(LINK_PREFIX):
        return _require_method(request, _find_caller(request, services, bearer, cookie))
    caller = joining_caller(request, services, bearer.credentials)
    if caller.join is None or multicap_phone is None:
        raise ApiError(
            request_codes.HEADER_INVALID, "A phone of a recording sends its id in the header Multicap-Phone."
        )
    settings, recording_id = services.settings, caller.join.recording_id
    number = services.store.recordings.phone_number(recording_id, multicap_phone)
    phone = UploadingPhone(recording_id, number, settings.max_recording_uploads, settings.max_recording_bytes)
    request.state.caller = replace(caller, phone=phone)
    return request.state.caller


class Viewing:
    """Dependency of a route that links may open: records of the caller's tenant.

    Links of ``scope`` open it, beside those to look at the whole job.
    """

    def __init__(self, scope: LinkScope) -> None:
        self._scope = scope

    async def __call__(
        self,
        request: Request,
        services: ServicesDep,
        caller: Annotated[Caller, Depends(_in_turn(_find_viewer), scope="function")],
    ) -> TenantRecords:
        """Return the records; raise 404 for everything that the caller's link does not open."""
        if caller.link is not None and not self._is_opened(caller.link, request.path_params):
            raise NotFound("The link does not open this.")
        return _records(request, services, caller)

    def _is_opened(self, link: Link, path: Mapping[str, str]) -> bool:
        ids = {"job_id": link.job_id, "session_id": link.session_id}
        named = {name: value for name, value in path.items() if name in ids}
        if not named or any(_canonical(value) != ids[name] for name, value in named.items()):
            return False
        if link.scope is LinkScope.JOB:
            return True
        name = path.get("camera", path.get("name", ALL_RESULTS))
        return link.scope is self._scope and (link.name is None or link.name == name)


def _canonical(value: str) -> str | None:
    try:
        return str(uuid.UUID(value))
    except ValueError:
        return None


ViewerDep = Annotated[Caller, Depends(_find_viewer)]
JobViewDep = Annotated[TenantRecords, Depends(Viewing(LinkScope.JOB))]
FileViewDep = Annotated[TenantRecords, Depends(Viewing(LinkScope.FILE))]
VideoViewDep = Annotated[TenantRecords, Depends(Viewing(LinkScope.VIDEO))]
EventsViewDep = Annotated[TenantRecords, Depends(Viewing(LinkScope.EVENTS))]
AnyCallerDep = Annotated[Caller, Depends(_any_in_turn, scope="function")]
CallerDep = Annotated[Caller, Depends(_in_turn(_authorize), scope="function")]
AdminDep = Annotated[Caller, Depends(_authorize_admin)]
# TenantRecords of the caller's tenant: routes have no other access to sessions and jobs.
RecordsDep = Annotated[TenantRecords, Depends(_tenant_records(_authorize))]
# Of a phone of a recording the uploads that it sent, and nothing else.
UploadsDep = Annotated[TenantRecords, Depends(_tenant_records(_find_uploader))]


def cookie_name(connection: HTTPConnection) -> str:
    """Name of the cookie on this connection.

    Over TLS the prefix makes browsers refuse a cookie that another host of the domain has set, or that came over an
    unencrypted connection; without TLS they refuse the prefix.
    """
    return f"__Host-{COOKIE}" if _is_encrypted(connection) else COOKIE


def _is_encrypted(connection: HTTPConnection) -> bool:
    return connection.url.scheme in {"https", "wss"}


def set_cookie(connection: HTTPConnection, response: Response, secret: str, lifetime_s: int) -> None:
    """Let a browser keep the secret of its session."""
    name, is_secure = cookie_name(connection), _is_encrypted(connection)
    response.set_cookie(name, secret, max_age=lifetime_s, httponly=True, samesite="strict", secure=is_secure)


def delete_cookie(connection: HTTPConnection, response: Response) -> None:
    """Let a browser forget its session."""
    is_secure = _is_encrypted(connection)
    response.delete_cookie(cookie_name(connection), httponly=True, samesite="strict", secure=is_secure)


def deletion(connection: HTTPConnection) -> str:
    """Value of ``Set-Cookie`` that deletes the cookie of this connection."""
    response = Response()
    delete_cookie(connection, response)
    return response.headers["set-cookie"]
