"""Videos of sessions, for players: as they were sent, if browsers play them, else their proxies; and thumbnails."""

from dataclasses import replace
from typing import Annotated

from fastapi import APIRouter, Path, Request, Response, status

from api.web.auth import RecordsDep, VideoViewDep
from api.web.contract.description import Resource, file_content, problems
from api.web.dependencies import ServicesDep, SessionId
from api.web.downloads import ConditionsDep, Download, file_responses, send_file
from api.web.errors import VIDEOS_DELETED_HINT, ApiError
from pipeline.capture.preflight_record import PreflightCamera, thumbnail_name
from pipeline.core.options.job_choices import blurred_name, proxy_name
from pipeline.core.problems.request_codes import NOT_FINISHED, VIDEOS_DELETED
from worker.run.planning import has_videos
from worker.store.errors import NotFound
from worker.store.files.file_keys import thumbnail_key
from worker.store.model.job_records import Result
from worker.store.model.session_records import Session
from worker.store.repositories.work.expiry import remove_files
from worker.store.tenant_records import TenantRecords

router = APIRouter(prefix="/v1/sessions/{session_id}", tags=["sessions"])

_VIDEO = file_content(["video/mp4", "video/webm"])
Camera = Annotated[
    str, Path(description="Name of a camera of the session.", openapi_examples={"camera": {"value": "cam_0"}})
]


@router.get(
    "/videos/{camera}",
    summary="Watch a session's video",
    response_class=Response,
    responses={**file_responses(_VIDEO), **problems(404, 409, 410, 416)},
)
def get_session_video(
    session_id: SessionId,
    camera: Camera,
    request: Request,
    services: ServicesDep,
    records: VideoViewDep,
    conditions: ConditionsDep,
) -> Response:
    """Watch the video of a camera, or a range of the file, as players ask for it.

    The video is the file that was sent, if browsers play it. Else it is a proxy: a small copy at the true times of the
    frames, without sound, which is made behind the session's first reconstruction.

    Of a session that `shows_blurred` it is a small copy with blurred heads that the newest job with `blur_faces` has
    made, and never the file that was sent. Frames that this job left out are black.
    """
    capture = records.sessions.capture(session_id)
    session, cameras = capture.session, capture.session.preflight.cameras
    number = next((number for number, known in enumerate(cameras) if known.name == camera), None)
    if number is None:
        raise NotFound("The session has no camera of this name.")
    media_type = cameras[number].media_type
    if session.videos_deleted_at is not None and not capture.blurred:
        raise deleted()
    if capture.is_blurred:
        file = _blurred(records, session, number)
    else:
        file = _proxy(records, session, number) if media_type is None else _sent(session, cameras[number], media_type)
    return send_file(request, services, file, conditions)


@router.delete(
    "/videos", summary="Delete a session's videos", status_code=status.HTTP_204_NO_CONTENT, responses=problems(404, 409)
)
def delete_session_videos(session_id: SessionId, services: ServicesDep, records: RecordsDep) -> None:
    """Delete the videos of a session for good, with their thumbnails and proxies; results of its jobs stay.

    Edits of people, and further jobs that detect nothing new, need no videos. All else answers `videos_deleted` from
    then on. A job of the session has to have succeeded, and none may be at work. To delete videos twice is no error.
    """
    services.disk.using_reserve(lambda: records.sessions.delete_videos(session_id))
    services.disk.using_reserve(lambda: remove_files(services.store.removals, services.artifacts))


_JPEG = file_content(["image/jpeg"])
Number = Annotated[int, Path(ge=0, le=255, description="Place of the picture in `thumbnails` of the camera.")]


@router.get(
    "/thumbnails/{camera}/{number}",
    summary="Look at a picture of a session's video",
    response_class=Response,
    responses={**file_responses(_JPEG), **problems(404, 410, 416, 422)},
)
def get_session_thumbnail(
    session_id: SessionId,
    camera: Camera,
    number: Number,
    request: Request,
    services: ServicesDep,
    records: VideoViewDep,
    conditions: ConditionsDep,
) -> Response:
    """Look at a small copy of a picture of a camera, at most 320 pixels wide and high, at which the check looked.

    Of a session with a job that has `blur_faces`, there are none.
    """
    capture = records.sessions.capture(session_id)
    if capture.is_blurred:
        raise NotFound("A job of this capture blurs faces, and the pictures of its check are not blurred.")
    if capture.session.videos_deleted_at is not None:
        raise deleted()
    cameras = capture.session.preflight.cameras
    place = next((place for place, known in enumerate(cameras) if known.name == camera), None)
    if place is None:
        raise NotFound("The session has no camera of this name.")
    if number >= len(cameras[place].thumbnails):
        raise NotFound("The camera has no such picture.")
    thumbnail, name = cameras[place].thumbnails[number], thumbnail_name(place, number)
    file = Download(
        name=f"{camera}-{number}.jpg",
        media_type="image/jpeg",
        key=thumbnail_key(session_id, name),
        num_bytes=thumbnail.num_bytes,
        sha256=thumbnail.sha256,
        disposition="inline",
        remedy="Send the capture again.",
    )
    return send_file(request, services, file, conditions)


def deleted() -> ApiError:
    """Error for pictures of videos that were deleted."""
    return ApiError(VIDEOS_DELETED, "The videos of this capture were deleted.", status=410, hint=VIDEOS_DELETED_HINT)


def _blurred(records: TenantRecords, session: Session, number: int) -> Download:
    """Blurred video of a camera, by its number in the session."""
    return _copy(
        session,
        number,
        records.results.blurred(session.id, blurred_name(number)),
        "A job of this capture blurs faces, and the blurred video of this camera is not there.",
        hint="Read the session until the camera has a video_url. If no job with blur_faces succeeds, start another.",
        remedy="Start another job with blur_faces.",
    )


def _proxy(records: TenantRecords, session: Session, number: int) -> Download:
    """Proxy of the video of a camera, by its number in the session."""
    return _copy(
        session,
        number,
        records.results.proxy(session.id, proxy_name(number)),
        "Browsers can't play the video of this camera, and a copy that they play is not made yet.",
        hint="Read the session until the camera has a video_url; its proxies_job says how far it is.",
        remedy="Retry the capture's proxies_job, or send the session again.",
    )


def _copy(session: Session, number: int, copy: Result | None, message: str, *, hint: str, remedy: str) -> Download:
    """Copy of the video of a camera for players; raises ``ApiError`` with the message and the hint without one."""
    if not has_videos(session):
        raise NotFound("The capture has no videos.")
    if copy is None:
        raise ApiError(NOT_FINISHED, message, hint=hint)
    file = session.preflight.cameras[number].file
    return replace(
        Download.from_result(copy, f"{file.rpartition('.')[0] or file}.mp4"), disposition="inline", remedy=remedy
    )


def _sent(session: Session, camera: PreflightCamera, media_type: str) -> Download:
    """Video of a camera as it was sent."""
    file = next(file for file in session.files if file.name == camera.file)
    # To compare gigabytes before the first picture would take longer than a person waits.
    return Download(
        name=file.name,
        media_type=media_type,
        key=file.key,
        num_bytes=file.num_bytes,
        sha256=file.sha256,
        disposition="inline",
        is_compared=False,
        remedy="Send the capture again.",
    )


RESOURCE = Resource(router=router)
