"""Links: addresses that open something of a job without a key, for a while."""

from typing import Annotated
from urllib.parse import quote

from fastapi import APIRouter, Body, Path, status

from api.web.auth import ALL_RESULTS, LINK, RecordsDep
from api.web.contract.description import Resource, answer, problems
from api.web.contract.schemas import fields_of
from api.web.dependencies import JobId, Services, ServicesDep, canonical_id
from api.web.errors import ErrorItem, pointer_to, unprocessable
from api.web.http.bodies.reading import SmallBodyRoute
from api.web.links import examples
from api.web.links.schemas import LinkList, LinkOut, LinkSpec, NewLinkOut
from pipeline.core.problems.requests import MISSING_FIELD, OUT_OF_RANGE, UNKNOWN_FIELD
from worker.store.errors import NotFound
from worker.store.model.rights import Link, LinkScope
from worker.store.tenant_records import TenantRecords

router = APIRouter(prefix="/v1", tags=["links"], route_class=SmallBodyRoute)

_NAMED = frozenset({LinkScope.FILE, LinkScope.VIDEO})
_DAY_S = 86_400.0


@router.post(
    "/jobs/{job_id}/links",
    operation_id="createLink",
    summary="Make a link",
    status_code=status.HTTP_201_CREATED,
    responses={201: answer("NewLink"), **problems(400, 404, 409, 413, 415, 422, 507)},
)
def create_link(
    job_id: JobId,
    spec: Annotated[LinkSpec, Body(openapi_examples={"default": {"value": examples.SPEC}})],
    services: ServicesDep,
    records: RecordsDep,
) -> NewLinkOut:
    """Make a link to a job, or to something of it, for browsers' requests without headers and for people without a key.

    It ends by itself, with the job, and with the key that made it. The address is shown once and not stored, so there
    is no `Idempotency-Key`: a repeated request makes another link.
    """
    job = records.jobs.get(job_id)
    _check(spec, services)
    _require_opened(records, job_id, job.session_id, spec)
    lifetime_s = spec.lifetime_s(services.settings.max_link_days * _DAY_S)
    link, secret = records.links.add(job_id, spec.scope, spec.name, lifetime_s)
    return NewLinkOut.with_address(link, _address(link, secret))


@router.get(
    "/jobs/{job_id}/links",
    operation_id="listLinks",
    summary="List a job's links",
    responses={200: answer("LinkList"), **problems(404)},
)
def list_links(job_id: JobId, records: RecordsDep) -> LinkList:
    """List the valid links of a job, the newest first."""
    return LinkList(links=tuple(LinkOut(**fields_of(link, LinkOut)) for link in records.links.list_valid(job_id)))


@router.delete(
    "/links/{link_id}",
    operation_id="revokeLink",
    summary="Revoke a link",
    status_code=status.HTTP_204_NO_CONTENT,
    responses=problems(404),
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


def _require_opened(records: TenantRecords, job_id: str, session_id: str, spec: LinkSpec) -> None:
    """Raise the problem of what the link would open."""
    if spec.scope is LinkScope.FILE and spec.name == ALL_RESULTS:
        records.results.downloads(job_id)
    elif spec.scope is LinkScope.FILE and spec.name is not None:
        records.results.get(job_id, spec.name)
    elif spec.scope is LinkScope.VIDEO:
        cameras = records.sessions.get(session_id).preflight.cameras
        if spec.name not in {camera.name for camera in cameras}:
            raise NotFound("The session has no camera of this name.")


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


RESOURCE = Resource(router=router, answers=examples.ANSWERS)
