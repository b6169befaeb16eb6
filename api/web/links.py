"""Links: addresses that open something of a job without a key, for a while."""

from typing import Annotated
from urllib.parse import quote

from fastapi import APIRouter, Path, status
from pydantic import AwareDatetime, Field

from api.web.auth import ALL_RESULTS, LINK, RecordsDep
from api.web.contract.description import Resource, problems
from api.web.contract.schemas import ID, Id, RequestModel, ResponseModel
from api.web.dependencies import JobId, Services, ServicesDep, canonical_id
from api.web.errors import ErrorItem, pointer_to, unprocessable
from api.web.http.bodies.reading import SmallBodyRoute
from pipeline.core.problems.request_codes import MISSING_FIELD, OUT_OF_RANGE, UNKNOWN_FIELD
from worker.store.errors import NotFound
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


class LinkSpec(RequestModel):
    """Link to be made. Unknown fields are refused."""

    scope: Opened
    name: str | None = Field(default=None, max_length=255, examples=["person-1.bvh"])
    """Name of the result file, or `results.zip` for all; name of the camera of a video."""
    expires_in_s: float | None = Field(default=None, gt=0, allow_inf_nan=False, examples=[900.0])
    """Seconds until the link ends; by default 900, and 604,800 of the scope `job`, or the service's limit."""

    def lifetime_s(self, longest_s: float) -> float:
        """Seconds until the link ends; by default at most ``longest_s``."""
        return self.expires_in_s or min(longest_s, DEFAULT_S.get(self.scope, SHORT_S))


class LinkOut(ResponseModel):
    """Link that is valid. Its address can't be read again."""

    id: Id
    job_id: Id
    scope: Opened
    name: str | None = Field(examples=["person-1.bvh"])
    """Name of the file or of the camera; null for scopes without one."""
    created_at: AwareDatetime = Field(description="Time of the creation.")
    expires_at: AwareDatetime = Field(description="Time at which the link ends.", examples=["2026-03-01T09:45:00Z"])


class NewLinkOut(LinkOut):
    """Link that was made, with its address."""

    url: str = Field(examples=[f"/v1/jobs/{ID}/results/person-1.bvh?link=mcl_..."])
    """Path with the secret in the parameter `link`. Of the scope `job` it is the page; the addresses of the job, its
    session, its results and its motion take the same parameter."""


class LinkList(ResponseModel):
    """Valid links of a job, the newest first."""

    links: tuple[LinkOut, ...]


router = APIRouter(prefix="/v1", tags=["links"], route_class=SmallBodyRoute)

_NAMED = frozenset({LinkScope.FILE, LinkScope.VIDEO})
_DAY_S = 86_400.0


@router.post(
    "/jobs/{job_id}/links",
    summary="Make a link",
    status_code=status.HTTP_201_CREATED,
    responses=problems(400, 404, 409, 413, 415, 422, 507),
)
def create_link(job_id: JobId, spec: LinkSpec, services: ServicesDep, records: RecordsDep) -> NewLinkOut:
    """Make a link to a job, or to something of it, for browsers' requests without headers and for people without a key.

    It ends by itself, with the job, and with the key that made it. The address is shown once and not stored, so there
    is no `Idempotency-Key`: a repeated request makes another link.
    """
    job = records.jobs.get(job_id)
    _check(spec, services)
    if spec.scope is LinkScope.FILE and spec.name == ALL_RESULTS:
        records.results.downloads(job_id)
    elif spec.scope is LinkScope.FILE and spec.name is not None:
        records.results.get(job_id, spec.name)
    elif spec.scope is LinkScope.VIDEO:
        cameras = records.sessions.get(job.session_id).preflight.cameras
        if spec.name not in {camera.name for camera in cameras}:
            raise NotFound("The session has no camera of this name.")
    lifetime_s = spec.lifetime_s(services.settings.max_link_days * _DAY_S)
    link, secret = records.links.add(job_id, spec.scope, spec.name, lifetime_s)
    return NewLinkOut.from_record(link, url=_address(link, secret))


@router.get("/jobs/{job_id}/links", summary="List a job's links", responses=problems(404))
def list_links(job_id: JobId, records: RecordsDep) -> LinkList:
    """List the valid links of a job, the newest first."""
    return LinkList(links=tuple(LinkOut.from_record(link) for link in records.links.list_valid(job_id)))


@router.delete(
    "/links/{link_id}", summary="Revoke a link", status_code=status.HTTP_204_NO_CONTENT, responses=problems(404)
)
def revoke_link(
    link_id: Annotated[str, Path(description="Id of a link.", json_schema_extra={"format": "uuid"})],
    services: ServicesDep,
    records: RecordsDep,
) -> None:
    """Revoke a link at once. Requests that it has opened are ended."""
    services.disk.using_reserve(lambda: records.links.revoke(canonical_id(link_id, "link")))


def _check(spec: LinkSpec, services: Services) -> None:
    """Raise 422 with all that is wrong with a link."""
    errors = []
    if spec.name is None and spec.scope in _NAMED:
        message = f"A link of the scope {spec.scope} needs the name of what it opens."
        errors.append(ErrorItem(code=MISSING_FIELD, message=message, pointer=pointer_to("name")))
    if spec.name is not None and spec.scope not in _NAMED:
        message = f"A link of the scope {spec.scope} opens no single file."
        errors.append(ErrorItem(code=UNKNOWN_FIELD, message=message, pointer=pointer_to("name")))
    max_days = services.settings.max_link_days
    if spec.expires_in_s is not None and spec.expires_in_s > max_days * _DAY_S:
        message = f"A link of this service ends after {max_days:g} days at the latest."
        errors.append(ErrorItem(code=OUT_OF_RANGE, message=message, pointer=pointer_to("expires_in_s")))
    if errors:
        raise unprocessable(errors)


def _address(link: Link, secret: str) -> str:
    """Path that a link opens. Of the page the secret is behind the hash, which browsers do not send."""
    job, name = f"/v1/jobs/{link.job_id}", quote(link.name or "", safe="")
    path = {
        LinkScope.FILE: f"{job}/{ALL_RESULTS}" if link.name == ALL_RESULTS else f"{job}/results/{name}",
        LinkScope.VIDEO: f"/v1/sessions/{link.session_id}/videos/{name}",
        LinkScope.EVENTS: f"{job}/events",
        LinkScope.JOB: f"/#/jobs/{link.job_id}",
    }[link.scope]
    return f"{path}?{LINK}={secret}"


RESOURCE = Resource(router=router)
