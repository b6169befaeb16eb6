"""More files of a finished job: formats, presets, a character, a report, overlays, blurred videos."""

from functools import partial

from fastapi import APIRouter, Response, status

from api.web.contract.description import Resource, problems
from api.web.dependencies import JobId, ServicesDep
from api.web.errors import error_item, unprocessable
from api.web.http.bodies.reading import SmallBodyRoute
from api.web.http.idempotency import IdempotentRequestDep
from api.web.jobs import queueing
from api.web.jobs.routes import ACCEPTED, accepted
from api.web.jobs.schemas import JobOut
from worker.run import tracing
from worker.run.planning import has_videos, plan_remake
from worker.store.spec import FilesAdded

router = APIRouter(prefix="/v1/jobs", tags=["jobs"], route_class=SmallBodyRoute)


@router.post(
    "/{job_id}/files",
    summary="Add files to a job",
    status_code=status.HTTP_202_ACCEPTED,
    response_model=JobOut,
    responses={**ACCEPTED, **problems(400, 404, 409, 410, 413, 415, 422, 429, 507)},
)
def add_job_files(
    job_id: JobId,
    services: ServicesDep,
    idempotent: IdempotentRequestDep,
    added: FilesAdded = FilesAdded(),  # noqa: B008 - frozen
) -> Response:
    """Add files to a job that has succeeded, without reconstructing again.

    All files follow the present edits of the capture, so an empty body brings those up to date. Report, overlay videos
    and blurred videos are made by a job of their own after the other files, see `visuals_job`. The files that are there
    can be read meanwhile.
    """
    if (earlier := idempotent.begin(added.model_dump(mode="json", exclude_unset=True))) is not None:
        return earlier
    with idempotent.working():
        records = idempotent.records
        job = records.jobs.get(job_id)
        session = records.sessions.get(job.session_id)
        spec = added.added_to(job.spec)
        limits = queueing.spec_limits(services, records, has_videos=has_videos(session))
        # The session was checked, and its errors were ignored or outweighed, when the job was queued.
        if found := queueing.check_spec(spec.model_copy(update={"force": True}), session.preflight, limits):
            raise unprocessable([error_item(problem) for problem in found])
        services.disk.require_room()
        with (
            queueing.copied_character(services, records, added.character, job_id) as moved,
            records.transaction() as work,
        ):
            plan = partial(plan_remake, session)
            remade = work.jobs.remake(job_id, plan, added, moved=moved, trace=tracing.current())
            answer = idempotent.store(work, accepted(remade))
    services.queue.publish()
    return answer.response()


RESOURCE = Resource(router=router)
