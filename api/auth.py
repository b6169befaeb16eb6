"""Who calls: by a key, by a browser that has shown one, or anybody as long as there are no keys."""

from dataclasses import dataclass
from typing import Annotated

from fastapi import Depends, Request, Security
from fastapi.security import APIKeyCookie, HTTPBearer
from fastapi.security.http import HTTPAuthorizationCredentials

from api.dependencies import ServicesDep
from api.errors import ApiError
from worker.jobs.model import Actor, Key, Scope
from worker.jobs.records import Records
from worker.jobs.tables import DEFAULT_TENANT

COOKIE = "multicap_session"

_READING = frozenset({"GET", "HEAD", "OPTIONS"})

_bearer = HTTPBearer(auto_error=False, scheme_name="key", description="A key, `mc_...`, of `multicap keys create`.")
_cookie = APIKeyCookie(
    name=COOKIE, auto_error=False, scheme_name="browser", description="Of a browser that has shown a key."
)


@dataclass(frozen=True, slots=True)
class Caller:
    """Who calls, and what they may do. ``key`` is ``None`` as long as there are no keys at all."""

    tenant: str
    scopes: frozenset[Scope]
    key: Key | None


def _unknown(detail: str) -> ApiError:
    return ApiError(
        401,
        "key_required",
        detail,
        hint="Send Authorization: Bearer mc_..., with a key that `multicap keys create` made.",
        headers={"WWW-Authenticate": "Bearer"},
    )


def _find_caller(
    request: Request,
    services: ServicesDep,
    bearer: Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)],
    cookie: Annotated[str | None, Security(_cookie)],
) -> Caller:
    """Find out who calls; 401 if that can't be known, 429 if they call too often."""
    if "authorization" in request.headers:
        key = services.store.find_key(bearer.credentials) if bearer else None
        if key is None:
            raise _unknown("This key is not known, has expired or was revoked.")
    elif cookie is not None and (key := services.store.find_browser_session(cookie)) is not None:
        _refuse_foreign_pages(request)
    elif services.store.has_keys():
        raise _unknown("The service asks for a key.")
    else:
        key = None
    caller = Caller(DEFAULT_TENANT, frozenset(Scope), None) if key is None else Caller(key.tenant, key.scopes, key)
    request.state.caller = caller
    request.state.rate_limit = services.rates.count(caller.tenant)
    return caller


def _refuse_foreign_pages(request: Request) -> None:
    """A cookie comes along with whatever a page has a browser send; only our own page may change anything by it.

    ``ForeignPageGuard`` has compared ``Origin`` with the pages that are allowed; these use keys, not cookies.
    """
    if request.method in _READING:
        return
    origin = request.headers.get("origin", "").lower().partition("://")[2]
    if origin != request.headers["host"].lower():
        raise ApiError(403, "cross_site_request", "A browser's session may be used by the service's own page only.")


def _require(caller: Caller, scope: Scope) -> Caller:
    if scope not in caller.scopes:
        raise ApiError(403, "scope_missing", f"The key lacks the scope {scope}.", hint="Ask for a key that has it.")
    return caller


def _authorize(request: Request, caller: Annotated[Caller, Depends(_find_caller)]) -> Caller:
    """Who calls, if their key allows such a request."""
    return _require(caller, Scope.READ if request.method in _READING else Scope.WRITE)


def _authorize_admin(caller: Annotated[Caller, Depends(_find_caller)]) -> Caller:
    return _require(caller, Scope.ADMIN)


def _records_of(request: Request, services: ServicesDep, caller: Annotated[Caller, Depends(_authorize)]) -> Records:
    actor = Actor(caller.key.id if caller.key else None, request.state.request_id)
    return services.store.of(caller.tenant, services.quotas, actor)


AnyCallerDep = Annotated[Caller, Depends(_find_caller)]
AdminDep = Annotated[Caller, Depends(_authorize_admin)]
# The caller's own sessions and jobs: routes of clients have no other way to them.
RecordsDep = Annotated[Records, Depends(_records_of)]
