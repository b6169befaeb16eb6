"""Routes of the caller: its tenant and quotas, and signing a browser in and out."""

from typing import Annotated

from fastapi import APIRouter, Body, Request, Response, status

from api.web.auth import AnyCallerDep, wrong_key
from api.web.callers import examples
from api.web.callers.schemas import BrowserSession, CallerOut, QuotasOut
from api.web.contract.description import Resource, answer, problems
from api.web.dependencies import ServicesDep
from api.web.http.bodies.reading import SmallBodyRoute
from api.web.http.browser_cookie import cookie_name, delete_cookie, set_cookie

router = APIRouter(prefix="/v1", tags=["callers"], route_class=SmallBodyRoute)

_LIFETIME_S = 12 * 3600


@router.get(
    "/caller",
    operation_id="getCaller",
    summary="Read the caller and its quotas",
    responses={200: answer("Caller"), **problems(401, 429)},
)
def get_caller(caller: AnyCallerDep, services: ServicesDep) -> CallerOut:
    """Read the name, the scopes and the expiry of the caller's key, and the tenant's usage and quotas."""
    key = caller.key
    return CallerOut(
        tenant=caller.tenant,
        name=key.name if key else None,
        scopes=tuple(sorted(caller.scopes)),
        expires_at=key.expires_at if key else None,
        quotas=QuotasOut.of(services.store.tenant(caller.tenant).usage(), services.quotas),
    )


@router.post(
    "/browser-session",
    operation_id="openBrowserSession",
    summary="Sign a browser in",
    status_code=status.HTTP_204_NO_CONTENT,
    responses={
        204: {"headers": {"Set-Cookie": {"description": "Session of this browser.", "schema": {"type": "string"}}}},
        **problems(400, 401, 413, 415, 422, 429, 507),
    },
)
def open_browser_session(
    shown: Annotated[BrowserSession, Body(openapi_examples={"default": {"value": {"key": "mc_..."}}})],
    request: Request,
    response: Response,
    services: ServicesDep,
) -> None:
    """Sign a browser in with a key, for 12 hours.

    Pages need a cookie, because they can't add a key to the requests of event streams and downloads.
    """
    key = services.store.keys.find(shown.key)
    if key is None:
        raise wrong_key(request, services)
    request.state.rate_limit = services.rates.count(key.tenant)
    request_id = request.state.request_id
    secret = services.disk.using_reserve(lambda: services.store.browser_sessions.open(key, _LIFETIME_S, request_id))
    set_cookie(request, response, secret, _LIFETIME_S)


@router.delete(
    "/browser-session",
    operation_id="closeBrowserSession",
    summary="Sign a browser out",
    status_code=status.HTTP_204_NO_CONTENT,
    responses=problems(507),
)
def close_browser_session(request: Request, response: Response, services: ServicesDep) -> None:
    """Sign this browser out, and delete its session."""
    if (secret := request.cookies.get(cookie_name(request))) is not None:
        services.disk.using_reserve(lambda: services.store.browser_sessions.close(secret))
    delete_cookie(request, response)


RESOURCE = Resource(router=router, is_open=True, answers=examples.ANSWERS)
