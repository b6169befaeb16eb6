"""Routes of the caller: its tenant and quotas, and signing a browser in and out."""

from typing import Self

from fastapi import APIRouter, Request, Response, status
from pydantic import AwareDatetime, Field

from api.web.auth import AnyCallerDep, cookie_name, delete_cookie, set_cookie, wrong_key
from api.web.contract.description import Resource, problems
from api.web.contract.schemas import RequestModel, ResponseModel
from api.web.dependencies import ServicesDep
from api.web.http.bodies.reading import SmallBodyRoute
from worker.store.database.quotas import Quotas
from worker.store.model.rights import Scope, Usage


class QuotaOut(ResponseModel):
    """Usage and limit of a quota."""

    used: int = Field(description="Present usage of the tenant.", examples=[12])
    limit: int | None = Field(description="Largest allowed usage; null without a limit.", examples=[100])


class QuotasOut(ResponseModel):
    """Quotas of a tenant."""

    sessions: QuotaOut = Field(description="Number of sessions.")
    unfinished_jobs: QuotaOut = Field(description="Number of jobs that wait or run.")
    stored_bytes: QuotaOut = Field(examples=[{"used": 52_428_800_000, "limit": 1_000_000_000_000}])
    """Size of all sessions with everything made from them; uploads count with their announced size."""
    uploads: QuotaOut = Field(description="Number of uploads that no session uses yet.")

    @classmethod
    def from_usage(cls, usage: Usage, quotas: Quotas) -> Self:
        """Build the response from a tenant's usage and quotas."""
        return cls(
            **{name: QuotaOut(used=getattr(usage, name), limit=getattr(quotas, name)) for name in cls.model_fields}
        )


class CallerOut(ResponseModel):
    """Caller of a request: its tenant, key and quotas."""

    tenant: str = Field(description="Tenant whose sessions and jobs the caller sees.", examples=["studio-a"])
    name: str | None = Field(examples=["portal"])
    """Name of the key; null for a service without keys, in which every caller has all scopes."""
    scopes: tuple[Scope, ...] = Field(description="Scopes of the key.", examples=[["read", "write"]])
    expires_at: AwareDatetime | None = Field(description="Time at which the key expires; null if it does not.")
    quotas: QuotasOut = Field(description="Usage and quotas of the tenant.")


class BrowserSession(RequestModel):
    """Key with which a browser signs in."""

    key: str = Field(max_length=200, description="API key, `mc_...`.", examples=["mc_..."])


router = APIRouter(prefix="/v1", tags=["callers"], route_class=SmallBodyRoute)

_LIFETIME_S = 12 * 3600


@router.get("/caller", summary="Read the caller and its quotas", responses=problems(401, 429))
def get_caller(caller: AnyCallerDep, services: ServicesDep) -> CallerOut:
    """Read the name, the scopes and the expiry of the caller's key, and the tenant's usage and quotas."""
    key = caller.key
    return CallerOut(
        tenant=caller.tenant,
        name=key.name if key else None,
        scopes=tuple(sorted(caller.scopes)),
        expires_at=key.expires_at if key else None,
        quotas=QuotasOut.from_usage(services.store.tenant(caller.tenant).usage(), services.quotas),
    )


@router.post(
    "/browser-session",
    summary="Sign a browser in",
    status_code=status.HTTP_204_NO_CONTENT,
    responses={
        204: {"headers": {"Set-Cookie": {"description": "Session of this browser.", "schema": {"type": "string"}}}},
        **problems(400, 401, 413, 415, 422, 429, 507),
    },
)
def open_browser_session(shown: BrowserSession, request: Request, response: Response, services: ServicesDep) -> None:
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
    "/browser-session", summary="Sign a browser out", status_code=status.HTTP_204_NO_CONTENT, responses=problems(507)
)
def close_browser_session(request: Request, response: Response, services: ServicesDep) -> None:
    """Sign this browser out, and delete its session."""
    if (secret := request.cookies.get(cookie_name(request))) is not None:
        services.disk.using_reserve(lambda: services.store.browser_sessions.close(secret))
    delete_cookie(request, response)


RESOURCE = Resource(router=router, is_open=True)
