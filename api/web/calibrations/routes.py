"""Calibrations: send a file, make one from a board or from people, list, read, download, rename, delete."""

from typing import Annotated
from urllib.parse import quote

from fastapi import APIRouter, Query, Response, status

from api.web.auth import RecordsDep
from api.web.calibrations import intake
from api.web.calibrations.schemas import (
    MEDIA_TYPES,
    CalibrationChanges,
    CalibrationOut,
    CalibrationPage,
    Format,
)
from api.web.contract.description import RETRY_AFTER, Resource, file_content, location, problems
from api.web.dependencies import CalibrationId, Cursor, Limit, Services, ServicesDep
from api.web.errors import ApiError
from api.web.http.bodies.reading import SmallBodyRoute
from api.web.http.conditional import ETAG, NOT_MODIFIED, IfMatch, IfNoneMatch, conditional, require_match
from api.web.http.idempotency import Answer, IdempotentRequest
from api.web.jobs.schemas import JobOut
from api.web.sessions.receiving import Creation, Texts, add_creation
from pipeline.core.problems.request_codes import NOT_FINISHED, NOT_FOUND
from worker.store.files.unneeded import remove_files

router = APIRouter(prefix="/v1/calibrations", tags=["calibrations"])
# A route that takes JSON; the form has its own limits.
small = APIRouter(prefix="/v1/calibrations", tags=["calibrations"], route_class=SmallBodyRoute)

# JSON comes last: generators of clients read what is declared first.
_FILE = file_content(("application/toml", "application/yaml", "application/json"))


def _add(services: Services, idempotent: IdempotentRequest, checked: intake.CheckedCalibration) -> Answer:
    """Store a calibration that is ready, or begin the job that makes the calibration."""
    content = checked.content
    if isinstance(content, intake.ReadyCalibration):
        return _add_ready(services, idempotent, checked, content)
    with intake.begun_calibration(services, idempotent.records, checked) as (work, job):
        return idempotent.store(work, intake.accepted(job))


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
            checked.name, ready.source, contents.files, checked.spec.method, contents.report
        )
        headers = {"Location": f"/v1/calibrations/{calibration.id}"}
        answer = idempotent.store(
            work, Answer(201, headers, CalibrationOut.from_calibration(calibration).model_dump_json())
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
    (
        Texts(
            "Send or make a calibration",
            _CREATE,
        ),
        Texts(
            "Send or make a calibration from files",
            "Send or make a calibration by a form with files; otherwise as `createCalibration`.",
        ),
        Texts(
            "Send or make a calibration from uploads",
            "Send or make a calibration by JSON that names uploads, or a session; otherwise as `createCalibration`.",
        ),
    ),
    status_code=status.HTTP_201_CREATED,
    response_model=CalibrationOut,
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


@router.get(
    "",
    operation_id="listCalibrations",
    summary="List calibrations",
    responses=problems(422),
)
def list_calibrations(records: RecordsDep, limit: Limit = 50, cursor: Cursor = None) -> CalibrationPage:
    """List calibrations, the newest first."""
    found = records.calibrations.page(limit=limit, after=str(cursor) if cursor else None)
    next_cursor = found[-1].id if len(found) == limit else None
    return CalibrationPage(
        calibrations=tuple(CalibrationOut.from_calibration(calibration) for calibration in found),
        next_cursor=next_cursor,
    )


@router.get(
    "/{calibration_id}",
    operation_id="getCalibration",
    summary="Read a calibration",
    response_model=CalibrationOut,
    responses={200: {"headers": ETAG}, **NOT_MODIFIED, **problems(404)},
)
def get_calibration(calibration_id: CalibrationId, records: RecordsDep, if_none_match: IfNoneMatch = None) -> Response:
    """Read a calibration: its state, its cameras and its report."""
    return conditional(CalibrationOut.from_calibration(records.calibrations.get(calibration_id)), if_none_match)


@router.get(
    "/{calibration_id}/file",
    operation_id="getCalibrationFile",
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
def get_calibration_file(
    calibration_id: CalibrationId,
    records: RecordsDep,
    file_format: Annotated[Format, Query(alias="format", description="Format of the file.")] = "multicap",
) -> Response:
    """Download a calibration, in metres: Multicap's JSON, anipose's or Caliscope's TOML, or OpenCV's YAML."""
    calibration = records.calibrations.get(calibration_id)
    if calibration.files is None:
        raise ApiError(NOT_FINISHED, "The calibration is not made yet.", hint="Wait for its job.")
    if file_format not in calibration.files:
        raise ApiError(NOT_FOUND, f"The format {file_format} can't hold this calibration.")
    ending, media_type = MEDIA_TYPES[file_format]
    name = quote(f"{calibration.name}.{ending}", safe="")
    headers = {"Cache-Control": "private, no-cache", "Content-Disposition": f"attachment; filename*=utf-8''{name}"}
    return Response(calibration.files[file_format], headers=headers, media_type=media_type)


@small.patch(
    "/{calibration_id}",
    operation_id="renameCalibration",
    summary="Rename a calibration",
    response_model=CalibrationOut,
    responses={200: {"headers": ETAG}, **problems(400, 404, 412, 413, 415, 422)},
)
def rename_calibration(
    calibration_id: CalibrationId,
    changes: CalibrationChanges,
    records: RecordsDep,
    if_match: IfMatch = None,
) -> Response:
    """Rename a calibration. With `If-Match`, only an unchanged one."""
    with records.transaction() as work:
        if if_match is not None:
            require_match(CalibrationOut.from_calibration(work.calibrations.get(calibration_id)), if_match)
        calibration = work.calibrations.rename(calibration_id, changes.name)
    return conditional(CalibrationOut.from_calibration(calibration), None)


@router.delete(
    "/{calibration_id}",
    operation_id="deleteCalibration",
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
