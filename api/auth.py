"""Callers of requests: by a key, by a browser that has shown a key, or anybody while the service has no keys."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request, Security
from fastapi.security import APIKeyCookie, HTTPBearer
from fastapi.security.http import HTTPAuthorizationCredentials

from api.dependencies import Services, ServicesDep
from api.errors import ApiError
from api.http.clients import client_network
from worker.jobs.database.tables import DEFAULT_TENANT
from worker.jobs.model import Actor, Key, Scope
from worker.jobs.tenant_records import TenantRecords

COOKIE = "multicap_session"

_READING = frozenset({"GET", "HEAD", "OPTIONS"})

_bearer = HTTPBearer(auto_error=False, scheme_name="key", description="A key, `mc_...`, of `multicap keys create`.")
_cookie = APIKeyCookie(
    name=COOKIE, auto_error=False, scheme_name="browser", description="Of a browser that has shown a key."
)


@dataclass(frozen=True, slots=True)
class Caller:
    """Caller of a request: address, tenant and scopes. ``key`` is ``None`` as long as the service has no keys."""

    tenant: str
    scopes: frozenset[Scope]
    key: Key | None
    network: str

    @property
    def owner(self) -> str:
        """Name under which requests share scarce resources: the tenant, or without keys the network of the client."""
        return f"tenant {self.tenant}" if self.key else f"network {self.network}"


def wrong_key(request: Request, services: Services) -> ApiError:
    """Count a wrong key of a client, and return the answer to it: 401, or 429 after too many."""
    try:
        rate_limit = services.wrong_keys.count(client_network(request))
    except ApiError as too_many:
        return too_many
    return _key_required("This key is not known, has expired or was revoked.", rate_limit)


def _key_required(detail: str, headers: Mapping[str, str]) -> ApiError:
    return ApiError(
        "key_required",
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
    """Find the caller of a request; 401 if the key is missing or wrong, 429 after too many requests."""
    if "authorization" in request.headers:
        key = services.store.keys.find(bearer.credentials) if bearer else None
        if key is None:
            raise wrong_key(request, services)
    elif cookie is not None and (key := services.store.browser_sessions.find(cookie)) is not None:
        _refuse_foreign_pages(request)
    elif services.store.keys.exist():
        raise wrong_key(request, services) if cookie is not None else _key_required("The service asks for a key.", {})
    else:
        key = None
    tenant, scopes = (DEFAULT_TENANT, frozenset(Scope)) if key is None else (key.tenant, key.scopes)
    caller = Caller(tenant, scopes, key, client_network(request))
    request.state.caller = caller
    request.state.rate_limit = services.rates.count(caller.tenant)
    return caller


def _refuse_foreign_pages(request: Request) -> None:
    """Refuse changes by a cookie from pages other than our own: browsers send it with the requests of any page.

    ``ForeignPageGuard`` has compared ``Origin`` with the pages that are allowed; these use keys, not cookies.
    """
    if request.method in _READING:
        return
    origin = request.headers.get("origin", "").lower().partition("://")[2]
    if origin != request.headers["host"].lower():
        raise ApiError("cross_site_request", "A browser's session may be used by the service's own page only.")


def _require(caller: Caller, scope: Scope) -> Caller:
    if scope not in caller.scopes:
        raise ApiError("scope_missing", f"The key lacks the scope {scope}.", hint="Ask for a key that has it.")
    return caller


def _authorize(request: Request, caller: Annotated[Caller, Depends(_find_caller)]) -> Caller:
    """Caller of a request that the key allows; 403 if a scope is missing."""
    return _require(caller, Scope.READ if request.method in _READING else Scope.WRITE)


def _authorize_admin(caller: Annotated[Caller, Depends(_find_caller)]) -> Caller:
    return _require(caller, Scope.ADMIN)


def _records_of(
    request: Request, services: ServicesDep, caller: Annotated[Caller, Depends(_authorize)]
) -> TenantRecords:
    actor = Actor(caller.key.id if caller.key else None, request.state.request_id)
    return services.store.of(caller.tenant, services.quotas, actor)


AnyCallerDep = Annotated[Caller, Depends(_find_caller)]
AdminDep = Annotated[Caller, Depends(_authorize_admin)]
# Records of the caller's tenant. Routes of clients reach sessions and jobs in no other way.
RecordsDep = Annotated[TenantRecords, Depends(_records_of)]
