"""Recordings by phones: open, list, read and end them, make links for phones, and make sessions of takes."""

import io
from typing import Annotated

import segno
from fastapi import APIRouter, Path, Request, Response, status
from starlette.concurrency import run_in_threadpool

from api.web.auth import RecordsDep
from api.web.contract.description import Resource, location, problems
from api.web.dependencies import Cursor, Limit, RecordingId, Services, ServicesDep
from api.web.errors import ErrorItem, pointer_to, unprocessable
from api.web.http.bodies.reading import SmallBodyRoute
from api.web.http.idempotency import IdempotentRequestDep
from api.web.jobs.schemas import JobOut
from api.web.recordings import schemas
from api.web.recordings.intake import server_s
from api.web.recordings.taking import made_calibration, made_session, used_take
from api.web.sessions.receiving import spool_folder
from pipeline.core.problems.request_codes import MISSING_FIELD, OUT_OF_RANGE, UNKNOWN_FIELD
from worker.store.model.phone_records import RecordingSession

router = APIRouter(prefix="/v1/recordings", tags=["recordings"], route_class=SmallBodyRoute)

_HOUR_S, _DAY_S = 3600.0, 86_400.0
TakeNumber = Annotated[int, Path(ge=1, le=100_000, description="Number of a take.")]


@router.post(
    "",
    summary="Open a recording",
    status_code=status.HTTP_201_CREATED,
    responses={201: {"headers": {"Location": location("recording")}}, **problems(400, 409, 413, 415, 422, 507)},
)
def open_recording(
    spec: schemas.RecordingSpec, request: Request, response: Response, services: ServicesDep, records: RecordsDep
) -> schemas.NewRecordingOut:
    """Open a recording: a room in which browsers of phones record takes together.

    The secret of the link is shown once and not stored, so there is no `Idempotency-Key`: a repeated request opens
    another recording.
    """
    services.disk.require_room()
    longest_s = services.settings.max_recording_hours * _HOUR_S
    if spec.expires_in_s is not None and spec.expires_in_s > longest_s:
        message = f"A recording of this service ends after {longest_s / _HOUR_S:g} hours at the latest."
        raise unprocessable([ErrorItem(code=OUT_OF_RANGE, message=message, pointer=pointer_to("expires_in_s"))])
    recording, secret = records.recordings.add(spec.name, spec.expires_in_s or min(longest_s, _DAY_S))
    response.headers["Location"] = f"/v1/recordings/{recording.id}"
    return _new(request, services, recording, secret)


@router.get("", summary="List recordings", responses=problems(422))
def list_recordings(records: RecordsDep, limit: Limit = 50, cursor: Cursor = None) -> schemas.RecordingPage:
    """List recordings that have not ended, the newest first."""
    found, now_s = records.recordings.page(limit=limit, after=str(cursor) if cursor else None), server_s()
    next_cursor = found[-1].id if len(found) == limit else None
    return schemas.RecordingPage(
        recordings=tuple(schemas.RecordingOut.from_recording(recording, now_s) for recording in found),
        next_cursor=next_cursor,
    )


@router.get("/{recording_id}", summary="Read a recording", responses=problems(404))
def get_recording(recording_id: RecordingId, records: RecordsDep) -> schemas.RecordingOut:
    """Read a recording: its phones, and its takes with the clips of the phones."""
    return schemas.RecordingOut.from_recording(records.recordings.get(recording_id), server_s())


@router.post(
    "/{recording_id}/join",
    summary="Make another link for phones",
    status_code=status.HTTP_201_CREATED,
    responses=problems(404, 507),
)
def renew_recording_link(
    recording_id: RecordingId, request: Request, services: ServicesDep, records: RecordsDep
) -> schemas.NewRecordingOut:
    """Make another link by which phones join. The one before ends, and phones that joined by it are disconnected."""
    recording, secret = services.disk.using_reserve(lambda: records.recordings.renew_link(recording_id))
    return _new(request, services, recording, secret)


@router.delete(
    "/{recording_id}", summary="End a recording", status_code=status.HTTP_204_NO_CONTENT, responses=problems(404)
)
def delete_recording(recording_id: RecordingId, services: ServicesDep, records: RecordsDep) -> None:
    """End a recording, with its link and with uploads of its phones that no session took. Sessions stay."""
    services.disk.using_reserve(lambda: records.recordings.delete(recording_id))


@router.post(
    "/{recording_id}/takes/{take}/session",
    summary="Make a session of a take",
    status_code=status.HTTP_201_CREATED,
    response_model=schemas.TakeSessionOut,
    responses={
        201: {"headers": {"Location": location("session")}},
        **problems(400, 404, 409, 410, 413, 415, 421, 422, 507),
    },
)
async def create_take_session(
    recording_id: RecordingId,
    take: TakeNumber,
    spec: schemas.TakeSessionSpec,
    request: Request,
    services: ServicesDep,
    idempotent: IdempotentRequestDep,
) -> Response:
    """Make a session of the clips that phones have sent of a take, and reconstruct it if the spec has a job.

    Cameras have the names of the phones, and the starts of their clips as declared offsets with their uncertainty. Of
    a take from which a calibration was made the footage is copied.
    """
    if (earlier := await run_in_threadpool(idempotent.begin, spec.model_dump(mode="json"))) is not None:
        return earlier
    async with idempotent.held():
        recording = await run_in_threadpool(idempotent.records.recordings.get, recording_id)
        used = used_take(recording, take, server_s())
        async with spool_folder(services.settings.spool_dir) as folder:
            made = await made_session(request, services, idempotent, recording, used, spec, folder)
    return made.response()


@router.post(
    "/{recording_id}/takes/{take}/calibration",
    summary="Calibrate the phones from a take",
    status_code=status.HTTP_202_ACCEPTED,
    response_model=JobOut,
    responses={202: {"headers": {"Location": location("job")}}, **problems(400, 404, 409, 413, 415, 421, 422, 507)},
)
async def create_take_calibration(
    recording_id: RecordingId,
    take: TakeNumber,
    spec: schemas.TakeCalibrationSpec,
    request: Request,
    services: ServicesDep,
    idempotent: IdempotentRequestDep,
) -> Response:
    """Make a calibration of the phones from people of known stature, or from a board, in a take.

    The answer is the job, with the same id as the calibration.
    """
    if (spec.board is None) == (not spec.stature_m):
        code, pointer = (MISSING_FIELD, "stature_m") if spec.board is None else (UNKNOWN_FIELD, "board")
        message = "A calibration is made either from people, with stature_m, or from a board."
        raise unprocessable([ErrorItem(code=code, message=message, pointer=pointer_to(pointer))])
    if (earlier := await run_in_threadpool(idempotent.begin, spec.model_dump(mode="json"))) is not None:
        return earlier
    async with idempotent.held():
        recording = await run_in_threadpool(idempotent.records.recordings.get, recording_id)
        used = used_take(recording, take, server_s())
        async with spool_folder(services.settings.spool_dir) as folder:
            made = await made_calibration(request, services, idempotent, recording, used, spec, folder)
    return made.response()


def _new(request: Request, services: Services, recording: RecordingSession, secret: str) -> schemas.NewRecordingOut:
    """Build the response from a recording and the secret of its link, which the page reads behind the hash."""
    origin = services.settings.public_url or f"{request.url.scheme}://{request.headers['host']}"
    url = f"{origin}/record#join={recording.id}.{secret}"
    svg = io.BytesIO()
    segno.make(url, error="m", micro=False).save(svg, "svg", scale=4, border=4, light="#fff", xmldecl=False, nl=False)
    join = schemas.JoinOut(url=url, secret=secret, qr_svg=svg.getvalue().decode(), expires_at=recording.expires_at)
    return schemas.NewRecordingOut.from_recording(recording, server_s(), join=join)


RESOURCE = Resource(router=router)
