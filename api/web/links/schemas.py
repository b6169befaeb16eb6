"""Bodies of links."""

from typing import Annotated, Self

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field

from api.web.contract.schemas import Id, ResponseModel, fields_of
from worker.store.model.rights import Link, LinkScope

DEFAULT_S = {LinkScope.JOB: 7 * 86_400.0}
"""Lifetimes of links without `expires_in_s`, by scope."""
SHORT_S = 15 * 60.0
"""Lifetime of links of the other scopes."""

Opened = Annotated[
    LinkScope,
    Field(
        description="What the link opens: `file`, one result file; `video`, the video of one camera; `events`, the "
        "event stream; `job`, all of these and everything else that a viewer of the job reads."
    ),
]


class LinkSpec(BaseModel):
    """Link to be made. Unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    scope: Opened
    name: str | None = Field(
        default=None,
        max_length=255,
        description="Name of the result file, or `results.zip` for all; name of the camera of a video.",
    )
    expires_in_s: float | None = Field(
        default=None,
        gt=0,
        allow_inf_nan=False,
        description="Seconds until the link ends; by default 900, and 604,800 of the scope `job`, or the service's "
        "limit.",
    )

    def lifetime_s(self, longest_s: float) -> float:
        """Seconds until the link ends; by default at most ``longest_s``."""
        return self.expires_in_s or min(longest_s, DEFAULT_S.get(self.scope, SHORT_S))


class LinkOut(ResponseModel):
    """Link that is valid. Its address can't be read again."""

    id: Id
    job_id: Id
    scope: Opened
    name: str | None = Field(description="Name of the file or of the camera; null for scopes without one.")
    created_at: AwareDatetime = Field(description="Time of the creation.")
    expires_at: AwareDatetime = Field(description="Time at which the link ends.")


class NewLinkOut(LinkOut):
    """Link that was made, with its address."""

    url: str = Field(
        description="Path with the secret in the parameter `link`. Of the scope `job` it is the page; the addresses of "
        "the job, its session, its results and its motion take the same parameter."
    )

    @classmethod
    def with_address(cls, link: Link, url: str) -> Self:
        """Build the response from a link and its address."""
        return cls(url=url, **fields_of(link, LinkOut))


class LinkList(ResponseModel):
    """Valid links of a job, the newest first."""

    links: tuple[LinkOut, ...]
