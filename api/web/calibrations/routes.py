"""Calibrations: send a file, make one from a board or from people, list, read, download, rename, delete; plan a rig."""

import base64
from typing import Annotated, Any
from urllib.parse import quote
from uuid import UUID

from fastapi import APIRouter, Query, Request, Response, status
from starlette.concurrency import run_in_threadpool

from api.web.auth import RecordsDep
from api.web.calibrations import intake, schemas
from api.web.contract.description import RETRY_AFTER, Resource, file_content, location, problems
from api.web.dependencies import CalibrationId, Cursor, Limit, Services, ServicesDep
from api.web.errors import ApiError, unprocessable
from api.web.http.bodies.reading import SmallBodyRoute
from api.web.http.conditional import ETAG, NOT_MODIFIED, IfMatch, IfNoneMatch, conditional, require_match
from api.web.http.idempotency import Answer, IdempotentRequest
from api.web.jobs.queueing import accepted
from api.web.jobs.schemas import JobOut
from api.web.sessions.preflight import InvalidFilesError
from api.web.sessions.receiving import Creation, add_creation, spool_folder
from pipeline.core.problems.request_codes import NOT_FINISHED
from worker.store.repositories.work.expiry import remove_files
from worker.store.tenant_records import TenantRecords

router = APIRouter(prefix="/v1/calibrations", tags=["calibrations"])
# A route that takes JSON; the form has its own limits.
small = APIRouter(prefix="/v1/calibrations", tags=["calibrations"], route_class=SmallBodyRoute)

# JSON comes last: generators of clients read what is declared first.
_FILE = file_content(("application/toml", "application/yaml", "application/xml", "application/zip", "application/json"))


def _add(services: Services, idempotent: IdempotentRequest, checked: intake.CheckedCalibration) -> Answer:
    """Store a calibration that is ready, or begin the job that makes the calibration."""
    content = checked.content
    if isinstance(content, intake.ReadyCalibration):
        return _add_ready(services, idempotent, checked, content)
    with intake.begun_calibration(services, idempotent.records, checked) as (work, job):
        return idempotent.store(work, accepted(job))


def _add_ready(
    services: Services,
    idempotent: IdempotentRequest,
    checked: intake.CheckedCalibration,
    ready: intake.ReadyCalibration,
) -> Answer:
    contents = ready.contents
    with idempotent.records.transaction() as work:
        work.uploads.use(checked.upload_ids)
        calibration = work.calibrations.add(
            checked.name, ready.source, contents.text, checked.spec.method, contents.report
        )
        headers = {"Location": f"/v1/calibrations/{calibration.id}"}
        answer = idempotent.store(
            work, Answer(201, headers, schemas.CalibrationOut.from_calibration(calibration).model_dump_json())
        )
    for upload_id in checked.upload_ids:
        services.uploads.remove(upload_id)
    return answer


_CREATE = """\
Send a calibration file, or have a calibration made from videos of a board, from people who walk about, or from known
points of a scene.

A file is checked and stored at once, and so is the calibration of a scene. Otherwise the answer is a job, with the same
id as the calibration. Generated clients use `createCalibrationFromFiles` and `createCalibrationFromUploads`, which do
the same with one kind of body each.
"""
add_creation(
    router,
    "",
    "createCalibration",
    Creation(intake.CALIBRATION_FORM, intake.check_calibration, _add),
    "Send or make a calibration",
    _CREATE,
    status_code=status.HTTP_201_CREATED,
    response_model=schemas.CalibrationOut,
    responses={
        201: {"headers": {"Location": location("calibration")}},
        202: {
            "description": "Job that makes the calibration, which has the same id.",
            "model": JobOut,
            "headers": {"Location": location("job"), **RETRY_AFTER},
        },
        **problems(400, 404, 408, 409, 413, 415, 422, 507),
    },
)


@router.get("", summary="List calibrations", responses=problems(422))
def list_calibrations(records: RecordsDep, limit: Limit = 50, cursor: Cursor = None) -> schemas.CalibrationPage:
    """List calibrations, the newest first."""
    found = records.calibrations.page(limit=limit, after=str(cursor) if cursor else None)
    next_cursor = found[-1].id if len(found) == limit else None
    return schemas.CalibrationPage(
        calibrations=tuple(schemas.CalibrationOut.from_calibration(calibration) for calibration in found),
        next_cursor=next_cursor,
    )


@router.get("/plan", summary="Plan a rig", responses=problems(404, 409, 422))
async def plan_rig(
    request: Request,
    services: ServicesDep,
    records: RecordsDep,
    length_m: Annotated[float, Query(ge=1, le=100, description="Side of the floor along X.")],
    width_m: Annotated[float, Query(ge=1, le=100, description="Side of the floor along Y.")],
    cameras: Annotated[int, Query(ge=2, le=128, description="Number of cameras, evenly along the walls.")] = 4,
    height_m: Annotated[float, Query(ge=0.1, le=50, description="Height of the cameras.")] = 2.5,
    field_deg: Annotated[float, Query(ge=10, le=150, description="Horizontal field of view of the cameras.")] = 70.0,
    people: Annotated[int, Query(ge=1, le=100, description="Number of people in the room.")] = 1,
    calibration_id: Annotated[
        UUID | None, Query(description="Calibration of cameras that stand already; the room's middle is its origin.")
    ] = None,
) -> schemas.RigPlan:
    """Plan a rig: which part of a room it covers, how many cameras see a joint, and the expected error by place."""
    text = None
    if calibration_id is not None:
        _, text = await run_in_threadpool(_stored, records, str(calibration_id))
    arguments = {
        "room_m": (length_m, width_m),
        "cameras": cameras,
        "height_m": height_m,
        "field_deg": field_deg,
        "size_px": (1920, 1080),
        "people": people,
    }
    return schemas.RigPlan.model_validate(await _on_request(request, services, "plan", arguments, text))


@router.get(
    "/{calibration_id}",
    summary="Read a calibration",
    response_model=schemas.CalibrationOut,
    responses={200: {"headers": ETAG}, **NOT_MODIFIED, **problems(404)},
)
def get_calibration(calibration_id: CalibrationId, records: RecordsDep, if_none_match: IfNoneMatch = None) -> Response:
    """Read a calibration: its state, its cameras and its report."""
    return conditional(schemas.CalibrationOut.from_calibration(records.calibrations.get(calibration_id)), if_none_match)


@router.get(
    "/{calibration_id}/file",
    summary="Download a calibration",
    response_class=Response,
    responses={
        200: {
            "description": "Calibration in the format.",
            "content": _FILE,
            "headers": {"Content-Disposition": {"description": "Name of the file.", "schema": {"type": "string"}}},
        },
        **problems(404, 409, 422),
    },
)
async def get_calibration_file(
    request: Request,
    calibration_id: CalibrationId,
    services: ServicesDep,
    records: RecordsDep,
    file_format: Annotated[schemas.Format, Query(alias="format", description="Format of the file.")] = "multicap",
) -> Response:
    """Download a calibration for Multicap or another program, in the unit and the axes of the program."""
    name, text = await run_in_threadpool(_stored, records, calibration_id)
    content = text.encode()
    if file_format != "multicap":
        answer = await _on_request(request, services, "file", {"to": file_format}, text)
        content = base64.b64decode(answer["content"])
    ending, media_type = schemas.MEDIA_TYPES[file_format]
    quoted = quote(f"{name}.{ending}", safe="")
    headers = {"Cache-Control": "private, no-cache", "Content-Disposition": f"attachment; filename*=utf-8''{quoted}"}
    return Response(content, headers=headers, media_type=media_type)


def _stored(records: TenantRecords, calibration_id: str) -> tuple[str, str]:
    """Name and text of a calibration."""
    calibration = records.calibrations.get(calibration_id)
    if calibration.text is None:
        raise ApiError(NOT_FINISHED, "The calibration is not made yet.", hint="Wait for its job.")
    return calibration.name, calibration.text


async def _on_request(
    request: Request, services: Services, task: str, arguments: dict[str, Any], text: str | None
) -> dict[str, Any]:
    """Do a task in a child process, which gets the text of a calibration as a file."""
    async with spool_folder(services.settings.spool_dir) as folder:
        path = folder / "calibration.json"
        if text is not None:
            await run_in_threadpool(path.write_text, text, "utf-8")
        arguments = {**arguments, "calibration": None if text is None else str(path)}
        owner = request.state.caller.owner
        try:
            return await services.checks.run(owner, services.preflight.calibration_task, task, arguments, folder)
        except InvalidFilesError as invalid:
            raise unprocessable(list(invalid.errors)) from None


@small.patch(
    "/{calibration_id}",
    summary="Rename a calibration",
    response_model=schemas.CalibrationOut,
    responses={200: {"headers": ETAG}, **problems(400, 404, 412, 413, 415, 422)},
)
def rename_calibration(
    calibration_id: CalibrationId, changes: schemas.CalibrationChanges, records: RecordsDep, if_match: IfMatch = None
) -> Response:
    """Rename a calibration. With `If-Match`, only an unchanged one."""
    with records.transaction() as work:
        if if_match is not None:
            require_match(schemas.CalibrationOut.from_calibration(work.calibrations.get(calibration_id)), if_match)
        calibration = work.calibrations.rename(calibration_id, changes.name)
    return conditional(schemas.CalibrationOut.from_calibration(calibration), None)


@router.delete(
    "/{calibration_id}",
    summary="Delete a calibration",
    status_code=status.HTTP_204_NO_CONTENT,
    responses=problems(404, 409),
)
def delete_calibration(calibration_id: CalibrationId, services: ServicesDep, records: RecordsDep) -> None:
    """Delete a calibration, with the job that made it and the videos that were sent for it.

    Sessions that use the calibration keep a copy.
    """
    services.disk.using_reserve(lambda: records.calibrations.delete(calibration_id))
    services.disk.using_reserve(lambda: remove_files(services.store.removals, services.artifacts))


CREATION = Resource(router=router, forms=(intake.CALIBRATION_FORM,))
RESOURCE = Resource(router=small)
