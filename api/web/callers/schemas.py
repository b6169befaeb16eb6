"""Bodies about callers."""

from typing import Self

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from api.web.contract.schemas import ResponseModel
from worker.store.database.quotas import Quotas
from worker.store.model.rights import Scope, Usage


class QuotaOut(ResponseModel):
    """Usage and limit of a quota."""

    used: int = Field(description="Present usage of the tenant.")
    limit: int | None = Field(description="Largest allowed usage; null without a limit.")


class QuotasOut(ResponseModel):
    """Quotas of a tenant."""

    sessions: QuotaOut = Field(description="Number of sessions.")
    unfinished_jobs: QuotaOut = Field(description="Number of jobs that wait or run.")
    stored_bytes: QuotaOut = Field(
        description="Size of all sessions with everything made from them; uploads count with their announced size."
    )
    uploads: QuotaOut = Field(description="Number of uploads that no session uses yet.")

    @classmethod
    def of(cls, usage: Usage, quotas: Quotas) -> Self:
        """Build the response from a tenant's usage and quotas."""
        return cls(
            **{name: QuotaOut(used=getattr(usage, name), limit=getattr(quotas, name)) for name in cls.model_fields}
        )


class CallerOut(ResponseModel):
    """Caller of a request: its tenant, key and quotas."""

    tenant: str = Field(description="Tenant whose sessions and jobs the caller sees.")
    name: str | None = Field(
        description="Name of the key; null for a service without keys, in which every caller has all scopes."
    )
    scopes: tuple[Scope, ...] = Field(description="Scopes of the key.")
    expires_at: AwareDatetime | None = Field(description="Time at which the key expires; null if it does not.")
    quotas: QuotasOut = Field(description="Usage and quotas of the tenant.")


class BrowserSession(BaseModel):
    """Key with which a browser signs in."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    key: str = Field(max_length=200, description="API key, `mc_...`.")
